"""The machines that can be modelled, in one table, and the one that a configuration describes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from sawbench.bench.errors import ConfigError
from sawbench.modeling.effects.effect import Part
from sawbench.modeling.machines.machine import Machine
from sawbench.modeling.residuals import EQUATIONS

if TYPE_CHECKING:
    from sawbench.bench.config import BatteryConfig, BenchConfig, LinearAxisConfig, PlantConfig

_SAW: Final[frozenset[Part]] = frozenset(
    ("motor", "gear", "crank", "guide", "joint", "drive", "load", "blade", "converter", "battery", "carriage",
     "load_cell", "drive_sensor", "clocks")
)  # fmt: skip
_BATTERY_PARAMETERS: Final = ("internal_resistance_ohm", "nominal_voltage_v", "capacity_ah")

JIGSAW: Final = Machine(
    name="jigsaw",
    title="battery jigsaw with a Scotch yoke",
    frame="crank",
    parts=frozenset((*_SAW, "scotch_yoke")),
    states=("crank angle", "crank speed", "motor current", "charge used"),
    inputs=("displacement_mm", "force_n", "motor_current_a", "battery_voltage_v", "battery_current_a"),
    equations=EQUATIONS,
    parameters=(
        "resistance_ohm", "inductance_h", "back_emf_constant_v_s_per_rad", "torque_constant_n_m_per_a",
        "motor_damping_n_m_s_per_rad", "rotor_inertia_kg_m2", "yoke_inertia_kg_m2", "reciprocating_mass_kg",
        "crank_radius_m", *_BATTERY_PARAMETERS,
    ),
)  # fmt: skip
SLIDER_CRANK_SAW: Final = replace(
    JIGSAW,
    name="slider_crank_saw",
    title="battery saw with a slider-crank mechanism",
    parts=frozenset((*_SAW, "slider_crank")),
)
LINEAR_AXIS: Final = Machine(
    name="linear_axis",
    title="reciprocating mass on a guide",
    frame="linear_axis",
    parts=frozenset(
        ("drive", "linear_drive", "moving_mass", "guide", "joint", "load", "load_cell", "drive_sensor", "clocks")
    ),
    states=("position", "velocity"),
    inputs=("displacement_mm", "motor_current_a", "force_n"),
    equations=("mechanical",),
    parameters=("moving_mass_kg", "viscous_damping_n_s_per_m", "force_constant_n_per_a"),
)
MACHINES: Final = (JIGSAW, SLIDER_CRANK_SAW, LINEAR_AXIS)


def machine_of(config: BenchConfig, *, path: str = "") -> Machine:
    """Compose the machine that a configuration describes.

    Parameters
    ----------
    config : BenchConfig
    path : str
        Of its file, for the error.

    Raises
    ------
    ConfigError
        If it does not describe a machine.
    """
    if config.linear_axis is not None:
        return axis_of(config.linear_axis)
    if config.plant is None:
        raise ConfigError(
            "does not describe a machine", where=path, remedy="give it a [plant] table (a saw) or a [linear_axis] table"
        )
    return saw_of(config.plant, config.battery)


def saw_of(plant: PlantConfig, battery: BatteryConfig | None) -> Machine:
    """Compose a saw by its mechanism; without a `[battery]` table it runs on a supply that nobody described."""
    saw = SLIDER_CRANK_SAW if plant.mechanism == "slider_crank" else JIGSAW
    if battery is not None:
        return saw
    return replace(
        saw,
        parts=saw.parts - {"battery"},
        equations=tuple(e for e in saw.equations if e != "supply"),
        parameters=tuple(name for name in saw.parameters if name not in _BATTERY_PARAMETERS),
    )


def axis_of(config: LinearAxisConfig) -> Machine:
    """Compose a linear axis; a load that no channel measures is no part of it."""
    is_loaded, is_current = config.load_channel is not None, config.force_constant_n_per_a is not None
    lacking: set[Part] = set() if is_loaded else {"load", "load_cell"}
    return replace(
        LINEAR_AXIS,
        parts=LINEAR_AXIS.parts - lacking,
        inputs=("displacement_mm", config.drive_channel, *([config.load_channel] if config.load_channel else [])),
        parameters=LINEAR_AXIS.parameters if is_current else LINEAR_AXIS.parameters[:2],
    )
