"""`bench_config.toml`: validated, frozen, with errors that name the key.

Every table is optional in the file: `diagnose` needs `[plant]`, `[battery]` and `[cutting]`, `record` needs
`[devices.*]`. A command asks for what it needs and says so when it is missing.
"""

from __future__ import annotations

import hashlib
import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from sawbench.bench.errors import ConfigError
from sawbench.bench.toml_text import parse_toml, read_toml_text
from sawbench.bench.units import CHANNEL_BY_NAME, TIME_COLUMN, Channel
from sawbench.bench.validation_text import describe_validation

if TYPE_CHECKING:
    from sawbench.bench.processed import Frame
    from sawbench.bench.recording import Floats

# Strict: `true` is no 1.0 and "18" is no 18.0.
_STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
# No constant of a machine lies outside, in any SI unit; 0 may.
_SMALLEST, _LARGEST = 1e-15, 1e9
# Cycles of an axis may take minutes.
_SLOWEST_AXIS_HZ: Final = 0.005
# Largest relative standard uncertainty of a constant: beyond it nothing is stated.
MOST_REL_STD: Final = 10.0


def _of_a_machine(value: float) -> float:
    if value != 0 and not _SMALLEST <= abs(value) <= _LARGEST:
        raise ValueError(f"value out of range: allowed are 0 and magnitudes of {_SMALLEST:g} to {_LARGEST:g}")
    return value


Constant = Annotated[float, AfterValidator(_of_a_machine)]


class Uncertain(BaseModel):
    """A nominal value with its relative standard uncertainty (one standard deviation).

    Examples
    --------
    >>> Uncertain(nominal=0.176, rel_std=0.05).std
    0.0088
    """

    model_config = _STRICT
    nominal: Constant
    rel_std: float = Field(default=0.0, ge=0.0, le=MOST_REL_STD)

    @property
    def std(self) -> float:
        """Absolute standard uncertainty, in the unit of the nominal value."""
        return abs(self.nominal) * self.rel_std


def _as_uncertain(value: Any) -> Any:
    """Accept a bare number as a value without stated uncertainty."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return {"nominal": value}
    if not isinstance(value, dict | Uncertain):
        raise ValueError("must be a number, or { nominal = ..., rel_std = ... }")
    return value


def _positive(value: Uncertain) -> Uncertain:
    if value.nominal <= 0:
        raise ValueError(f"must be greater than 0, got {value.nominal!r}")
    return value


def _not_negative(value: Uncertain) -> Uncertain:
    if value.nominal < 0:
        raise ValueError(f"must not be negative, got {value.nominal!r}")
    return value


PositiveValue = Annotated[Uncertain, BeforeValidator(_as_uncertain), AfterValidator(_positive)]
NotNegativeValue = Annotated[Uncertain, BeforeValidator(_as_uncertain), AfterValidator(_not_negative)]


class PlantConfig(BaseModel):
    """The electromechanical constants of the jigsaw, Table 3 of the paper, SI units."""

    model_config = _STRICT
    resistance_ohm: PositiveValue
    inductance_h: PositiveValue
    back_emf_constant_v_s_per_rad: PositiveValue
    torque_constant_n_m_per_a: PositiveValue
    rotor_inertia_kg_m2: PositiveValue
    yoke_inertia_kg_m2: NotNegativeValue
    reciprocating_mass_kg: NotNegativeValue
    crank_radius_m: PositiveValue
    motor_damping_n_m_s_per_rad: NotNegativeValue
    gear_ratio: Constant = Field(gt=0)
    mechanism: Literal["scotch_yoke", "slider_crank"] = "scotch_yoke"
    rod_length_m: Constant | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _rod_fits_mechanism(self) -> PlantConfig:
        if self.mechanism == "slider_crank" and (
            self.rod_length_m is None or self.rod_length_m <= self.crank_radius_m.nominal
        ):
            raise ValueError("a slider_crank needs rod_length_m, longer than crank_radius_m")
        return self


class LinearAxisConfig(BaseModel):
    """A driven mass on a guide, the plant of `diagnosis.plants.linear_axis`, SI units.

    `drive_channel` is a current (`..._a`, with `force_constant_n_per_a`) or a force (`..._n`); positive drives
    towards larger `displacement_mm`. `load_channel` is the measured force that the axis works against, positive
    where it pushes towards smaller displacement; none where the axis runs free or the load is the question.
    """

    model_config = _STRICT
    moving_mass_kg: NotNegativeValue
    viscous_damping_n_s_per_m: NotNegativeValue
    force_constant_n_per_a: PositiveValue | None = None
    drive_channel: str = "motor_current_a"
    load_channel: str | None = None
    drive_gain_rel_std: Constant = Field(default=0.01, ge=0)
    load_gain_rel_std: Constant = Field(default=0.01, ge=0)
    drive_offset_std_n: Constant | None = Field(default=None, ge=0)
    load_offset_std_n: Constant | None = Field(default=None, ge=0)
    model_floor_n: Constant | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _drive_is_force_or_current(self) -> LinearAxisConfig:
        is_current = self.drive_channel.endswith("_a")
        if not is_current and not self.drive_channel.endswith("_n"):
            raise ValueError(f"drive_channel {self.drive_channel!r} must end in _a (a current) or _n (a force)")
        if is_current != (self.force_constant_n_per_a is not None):
            raise ValueError(
                "a drive_channel in A needs force_constant_n_per_a"
                if is_current
                else "a drive_channel in N is already a force: leave out force_constant_n_per_a"
            )
        if self.load_channel is not None and not self.load_channel.endswith("_n"):
            raise ValueError(f"load_channel {self.load_channel!r} must end in _n (a force)")
        if self.load_channel == self.drive_channel:
            raise ValueError("drive_channel and load_channel are the same")
        return self


Range = Annotated[tuple[float, float], Field(strict=False)]


class OpenCircuitTable(BaseModel):
    """Open-circuit voltage over the state of charge, as a share of `nominal_voltage_v`, in place of Eq. 16."""

    model_config = _STRICT
    soc: Annotated[tuple[float, ...], Field(strict=False, min_length=3)]
    share: Annotated[tuple[float, ...], Field(strict=False, min_length=3)]

    @model_validator(mode="after")
    def _rises_to_one(self) -> OpenCircuitTable:
        if len(self.soc) != len(self.share):
            raise ValueError(f"soc has {len(self.soc)} values, share {len(self.share)}")
        for name, values in (("soc", self.soc), ("share", self.share)):
            if any(after <= before for before, after in itertools.pairwise(values)):
                raise ValueError(f"{name} must increase from value to value")
            if values[-1] != 1.0:
                raise ValueError(f"{name} must end at 1, got {values[-1]!r}")
        if self.soc[0] != 0.0 or self.share[0] < 0.0:
            raise ValueError("soc must start at 0, and share must not be negative")
        return self


class BatteryRange(BaseModel):
    """What a fitted battery rests on: where it holds, and how far it missed discharges withheld from its fit.

    `runtime_rel_std` is one standard uncertainty of a runtime, relative; `current_a` are mean battery currents.
    `std` holds one standard uncertainty of each parameter, for the reader: the runtime takes `runtime_rel_std`.
    """

    model_config = _STRICT
    variant: str = ""
    n_discharges: int = Field(default=1, ge=1)
    runtime_rel_std: float = Field(ge=0, le=1)
    current_a: Range
    soc: Range = (0.0, 1.0)
    temperature_c: Range | None = None
    cycle: Range | None = None
    std: dict[str, Constant] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _ranges_rise(self) -> BatteryRange:
        for name in ("current_a", "soc", "temperature_c", "cycle"):
            limits = getattr(self, name)
            if limits is not None and limits[0] > limits[1]:
                raise ValueError(f"{name} must rise, got {list(limits)}")
        return self


class BatteryConfig(BaseModel):
    """The battery: Eq. 16 with `beta` in [0, 1), or a table of its open-circuit voltage, behind a resistance.

    `shape_ratio` is the charge at which Eq. 16 reaches 0 V, over `capacity_ah`; 1 in the paper. `fitted` is written by
    `sawbench battery fit`.
    """

    model_config = _STRICT
    nominal_voltage_v: Constant = Field(gt=0)
    capacity_ah: Constant = Field(gt=0)
    beta: float = Field(default=0.0, ge=0, lt=1)
    shape_ratio: Constant = Field(default=1.0, gt=0)
    open_circuit: OpenCircuitTable | None = None
    internal_resistance_ohm: Constant = Field(default=0.0, ge=0)
    cutoff_soc: float = Field(default=0.2, gt=0, lt=1)
    cutoff_voltage_v: Constant | None = Field(default=None, gt=0)
    fitted: BatteryRange | None = None

    @model_validator(mode="after")
    def _one_curve(self) -> BatteryConfig:
        is_equation = bool({"beta", "shape_ratio"} & self.model_fields_set)
        if self.open_circuit is None and "beta" not in self.model_fields_set:
            raise ValueError("missing key 'beta' of Eq. 16, or a table open_circuit")
        if self.open_circuit is not None and is_equation:
            raise ValueError("has both Eq. 16 (beta, shape_ratio) and a table open_circuit: keep one")
        return self


class CuttingConfig(BaseModel):
    """Which half of the crank turn cuts (the paper contradicts itself; see docs/paper.md)."""

    model_config = _STRICT
    cutting_half: Literal["pi_to_2pi", "zero_to_pi"] = "pi_to_2pi"


class ConverterConfig(BaseModel):
    """How the motor voltage is made from the battery voltage.

    `fixed_duty`: U = duty * V_b, as a PWM stage does. `held_voltage`: the converter trims its duty so that
    U stays at `voltage_v`, the reading that reproduces the paper's runtime.
    """

    model_config = _STRICT
    mode: Literal["fixed_duty", "held_voltage"] = "fixed_duty"
    voltage_v: Constant | None = Field(default=None, gt=0)
    default_duty: float = Field(default=0.4375, gt=0, le=1)

    @model_validator(mode="after")
    def _voltage_given(self) -> ConverterConfig:
        if self.mode == "held_voltage" and self.voltage_v is None:
            raise ValueError("mode held_voltage needs voltage_v, the constant motor voltage")
        return self


# Beyond it a sensor is not misread but wrong.
_GAINS: Final = (0.5, 2.0)


class SensorConfig(BaseModel):
    """What a sensor of a saw reads: `[sensors.CHANNEL]`, gain times the true value, plus offset in the channel's unit.

    Recordings keep what was read; processing takes it back. `diagnose` estimates both, within the class of the sensor.
    """

    model_config = _STRICT
    gain: float = Field(default=1.0, ge=_GAINS[0], le=_GAINS[1])
    offset: float = 0.0

    def true(self, reading: Floats) -> Floats:
        """What was there where the sensor reads so, of any shape."""
        return (reading - self.offset) / self.gain

    def reading(self, true: Floats) -> Floats:
        """What the sensor reads of values of any shape."""
        return self.gain * true + self.offset

    def after(self, gain: float, offset: float) -> SensorConfig:
        """What it reads if the values that are taken for true here are read with a gain and an offset themselves."""
        both = min(max(self.gain * gain, _GAINS[0]), _GAINS[1])
        return SensorConfig(gain=both, offset=self.offset + self.gain * offset)


class RecordingConfig(BaseModel):
    """Where recordings go and how often they are made safe.

    `preload_n` is the force with which the spindle presses the carriage on the load cell: a warning comes before the
    cutting force lifts it off.
    """

    model_config = _STRICT
    directory: str = "recordings"
    seconds: float = Field(default=10.0, gt=0)
    flush_every_s: float = Field(default=1.0, gt=0, le=10)
    preview_rate_hz: float = Field(default=50.0, gt=0, le=100)
    second_copy: str | None = None
    preload_n: Constant | None = Field(default=None, gt=0)


class AnalysisConfig(BaseModel):
    """Settings of the processing; the defaults suit a jigsaw."""

    model_config = _STRICT
    n_bins: int = Field(default=256, ge=16, le=65536)
    min_stroke_rate_hz: float = Field(default=0.2, gt=0)
    max_stroke_rate_hz: float = Field(default=100.0, gt=0)
    force_gain_rel_std: float = Field(default=0.005, ge=0)
    current_gain_rel_std: float = Field(default=0.005, ge=0)


class ChannelConfig(BaseModel):
    """A measured quantity beyond those of `bench.units`: `[channels.NAME]`; recorded and kept, used by no model."""

    model_config = _STRICT
    unit: str = Field(min_length=1)
    range: tuple[float, float] = Field(strict=False)
    label: str = ""

    @model_validator(mode="after")
    def _range_rises(self) -> ChannelConfig:
        if self.range[0] >= self.range[1]:
            raise ValueError(f"range must rise, got {list(self.range)}")
        return self


class BenchConfig(BaseModel):
    """The whole of `bench_config.toml`.

    `devices` maps a name to a table with at least `driver`; the driver checks the rest of its table itself
    (`acquisition.devices`). `effects` maps an effect to its magnitude; the machine checks the table
    (`modeling.machines.known_effects`).
    """

    model_config = _STRICT
    plant: PlantConfig | None = None
    linear_axis: LinearAxisConfig | None = None
    battery: BatteryConfig | None = None
    cutting: CuttingConfig = CuttingConfig()
    converter: ConverterConfig = ConverterConfig()
    recording: RecordingConfig = RecordingConfig()
    analysis: AnalysisConfig = AnalysisConfig()
    channels: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")], ChannelConfig] = Field(default_factory=dict)
    devices: dict[str, dict[str, Any]] = Field(default_factory=dict)
    sensors: dict[str, SensorConfig] = Field(default_factory=dict)
    effects: dict[str, dict[str, Any]] = Field(default_factory=dict)

    @property
    def frame(self) -> Frame:
        """Whose equations the machine moves by; without a `[plant]` it is taken for a saw."""
        return "crank" if self.linear_axis is None else "linear_axis"

    @property
    def stroke_rates_hz(self) -> tuple[float, float]:
        """Allowed rates of the strokes or cycles; the lowest of an axis is its own, unless `[analysis]` states one."""
        lowest = self.analysis.min_stroke_rate_hz
        if self.frame == "linear_axis" and "min_stroke_rate_hz" not in self.analysis.model_fields_set:
            lowest = _SLOWEST_AXIS_HZ
        return lowest, self.analysis.max_stroke_rate_hz

    @property
    def further_channels(self) -> frozenset[str]:
        """Names beyond those of `bench.units`: declared in `[channels.*]`, or drive and load of an axis."""
        axis = self.linear_axis
        of_axis = () if axis is None else (axis.drive_channel, axis.load_channel)
        return frozenset(name for name in (*self.channels, *of_axis) if name) - CHANNEL_BY_NAME.keys()

    @property
    def known_channels(self) -> dict[str, Channel]:
        """Channels of `bench.units` and those that `[channels.*]` declares, by name."""
        declared = {
            name: Channel(name=name, unit=c.unit, label=c.label or name.replace("_", " "), plausible=c.range)
            for name, c in self.channels.items()
        }
        return {**CHANNEL_BY_NAME, **declared}

    @model_validator(mode="after")
    def _channels_are_further_ones(self) -> BenchConfig:
        for name in self.channels:
            if name in CHANNEL_BY_NAME or name == TIME_COLUMN:
                raise ValueError(f"channels.{name}: this is a built-in channel of sawbench; remove its table")
        return self

    @model_validator(mode="after")
    def _sensors_of_a_saw(self) -> BenchConfig:
        for name in self.sensors:
            if name not in self.known_channels:
                raise ValueError(
                    f"sensors.{name}: no channel has this name; known are {', '.join(self.known_channels)}"
                )
        if self.sensors and self.linear_axis is not None:
            raise ValueError("[sensors] is for a saw; a linear axis states the gains of its channels in [linear_axis]")
        return self

    @model_validator(mode="after")
    def _one_plant(self) -> BenchConfig:
        if self.plant is not None and self.linear_axis is not None:
            raise ValueError("has both [plant] (jigsaw) and [linear_axis]: keep the one that was measured")
        return self


class LoadedConfig(BaseModel):
    """A configuration together with the text it came from.

    Attributes
    ----------
    config : BenchConfig
    text : str
        The TOML as it was read; stored in every recording.
    path : str
    """

    model_config = ConfigDict(frozen=True)
    config: BenchConfig
    text: str
    path: str

    @property
    def sha256(self) -> str:
        """SHA-256 of the text, hexadecimal."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def plant(self) -> PlantConfig:
        """Return `[plant]` or say that it is missing."""
        if self.config.linear_axis is not None:
            raise ConfigError(
                "describes a linear axis, which this command cannot handle: it needs the [plant] table of a saw",
                where=self.path,
                remedy="`sawbench diagnose` compares a linear axis with its model; `import`, `record`, `info`,"
                " `process`, `report`, `export` and `view` accept it too",
            )
        if self.config.plant is None:
            raise _missing("plant", self.path)
        return self.config.plant

    def battery(self) -> BatteryConfig:
        """Return `[battery]` or say that it is missing."""
        if self.config.battery is None:
            raise _missing("battery", self.path)
        return self.config.battery


def _missing(table: str, path: str) -> ConfigError:
    return ConfigError(
        f"has no [{table}] table, which this command needs",
        where=path,
        remedy=f"copy [{table}] from the bench_config.toml of the package and enter your values",
    )


def load_config(path: str | Path) -> LoadedConfig:
    """Read and validate a bench configuration.

    Raises
    ------
    ConfigError
        If the file is missing, is not TOML, or holds a key or value that is not allowed. The message names
        every offending key, what was got and what is allowed.
    """
    path = Path(path)
    text = read_toml_text(path, remedy="check the path given with --config, or run in the folder of bench_config.toml")
    return parse_config(text, where=str(path))


def parse_config(text: str, *, where: str = "bench_config.toml") -> LoadedConfig:
    r"""Validate a configuration given as TOML text; see `load_config`.

    Examples
    --------
    >>> parse_config("[cutting]\ncutting_half = 'zero_to_pi'").config.cutting.cutting_half
    'zero_to_pi'
    """
    tables = parse_toml(text, where=where)
    try:
        config = BenchConfig.model_validate(tables)
    except ValidationError as error:
        raise ConfigError(describe_validation(error, BenchConfig), where=where) from error
    return LoadedConfig(config=config, text=text, path=where)
