"""The numbers on which the diagnosis rests and that no equation gives, each with where it comes from.

`fitted` numbers were chosen for what they do to the answers on development campaigns; each is held by a principle that
half of it and twice of it break (`python -m tests.rigs.principles` prints them). `measured` ones were read off data,
`convention` ones are a choice that a reader may make otherwise. Grids, tolerances and sizes of arrays stay beside the
functions that use them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from types import MappingProxyType
from typing import Any, Final

from sawbench.diagnosis.inference.answer_settings import Closing, Ladder, Learning, Planning, Report
from sawbench.diagnosis.inference.marked_number import BY_HAND, CLASS, INTACT, Mark, marked
from sawbench.diagnosis.inference.trial_settings import OffStroke, Reading, Screening

# Half the 95 % interval of a normal distribution over its standard deviation: the level of every claim, by convention.
Z95: Final = 1.959964


@dataclass(frozen=True, kw_only=True, slots=True)
class Weights:
    """From log evidences to probabilities. None is fitted: they are prior odds and what a reader would ask.

    Attributes
    ----------
    quiet : float
        Whitened misfit over features that an intact machine leaves on a quiet bench.
    floor_left, floor_gap : float
        Whitened misfit over features that is added to what is left and to what is explained, so that the odds of
        "unknown" in a gap that nobody could measure are one to ten.
    least_added : float
        Of the evidence at which a second effect is even: what a second effect adds counts as no less.
    gained_by_none : float
        Log evidence that the likeliest effect has in mean strokes where the machine has none, nats.
    acts_share : float
        Of a signature's energy: an effect acts in the equations that hold that much.
    prior_no_gap, prior_parameters, prior_unknown : float
        The rest belongs to the effects, evenly.
    """

    quiet: float = marked(0.15, "measured", INTACT)
    floor_left: float = marked(0.02, "convention", "an eighth of `quiet`: hidden by what an intact machine leaves")
    floor_gap: float = marked(0.2, "convention", "a gap as small as `quiet` is hardly a gap")
    least_added: float = marked(1e-3, "convention", "keeps a logarithm finite where nothing is added")
    gained_by_none: float = marked(8.0, "measured", "22 of 30 intact campaigns of five simulators: less")
    acts_share: float = marked(0.01, "convention", "a hundredth is what filters and tracking mix into other equations")
    prior_no_gap: float = marked(1.0 / 3.0, "convention", "one machine in three is as its model says")
    prior_parameters: float = marked(1.0 / 6.0, "convention", "half as many as without a gap")
    prior_unknown: float = marked(1.0 / 12.0, "convention", "of six causes one is in no catalogue")


@dataclass(frozen=True, kw_only=True, slots=True)
class Noise:
    """What the features scatter by.

    Attributes
    ----------
    correlation_factor : float
        Scatter of the units is correlated from block to block: the variance of a block's mean is that much larger.
    quiet_share : float
        Times what the scatter predicts: what an intact machine leaves on this bench.
    wide : float
        Factor on the prior of the plant's numbers where they are re-tuned freely.
    memory_strokes : float
        A stroke's mean is remembered for that many: what drifts slowly is the same in neighbouring bins of a start.
    least_trials : int
        From which something is said of a campaign as a whole.
    least_units, least_blocks : int
        Of a trial: units that give the scatter of single strokes about a straight line, and time blocks that give what
        blocks scatter more than that.
    """

    correlation_factor: float = marked(1.5, "fitted", BY_HAND)
    quiet_share: float = marked(
        1.25, "convention", "the scatter of blocks is known to a tenth; two of these, rounded up"
    )
    wide: float = marked(5.0, "convention", "re-tuning by five stated standard deviations is still the same machine")
    memory_strokes: float = marked(3.0, "convention", "as `OffStroke.near_harmonic`")
    least_trials: int = marked(3, "convention", "two may agree by chance")
    least_units: int = marked(3, "convention", "a straight line takes two")
    least_blocks: int = marked(4, "convention", "two more than a straight line takes")


@dataclass(frozen=True, kw_only=True, slots=True)
class Forms:
    """How far nature's form may be from the catalogue's, and when that is looked at.

    Attributes
    ----------
    shares : tuple of float
        Standard deviation of each part of the smooth factor on a signature, as a share of it: all are tried.
    harmonic_factor : float
        Each harmonic may also be larger and turned on its own, as another filter or a sharper corner would cause.
    screen_share : float
        Share that the first effect of a pair may miss while the second one is screened.
    n_formed, n_first, n_pairs : int
        Effects, firsts of a pair and pairs that are weighed with what their forms may miss.
    worth_forming : float
        Log evidence of a second effect below which its form does not matter.
    least_amplitude, background_amplitude : float
        Of the typical size: less is no cause, and usually background.
    bent_displacement_rad : float
        Typical swing of a displacement sensor that is bent.
    most_std : float
        Relative standard uncertainty of a magnitude that is right to a factor of two; no form leaves more.
    size_temperature : float
        Divides what the features say of the size of an effect: no form is nature's, and sizes miss more by that than
        causes.
    """

    shares: tuple[float, ...] = marked((0.0, 0.03, 0.1, 0.25), "convention", "none, and three sizes a factor 3 apart")
    harmonic_factor: float = marked(1.5, "fitted", BY_HAND)
    screen_share: float = marked(0.05, "convention", "between the two smaller ones of the shares that are tried")
    n_formed: int = marked(12, "convention", "time: each costs 0.1 s")
    n_first: int = marked(5, "convention", "time: each costs a pass over the catalogue")
    n_pairs: int = marked(8, "convention", "time: each costs 0.2 s")
    worth_forming: float = marked(3.0, "convention", "time: below, none of thirty further effects is likely")
    bent_displacement_rad: float = marked(0.03, "convention", "twelve times what an ordinary sensor may have")
    least_amplitude: float = marked(0.15, "convention", "three standard deviations of the background of 5 %")
    background_amplitude: float = marked(1.0 / 3.0, "convention", "half a decade below what is typical")
    most_std: float = marked(0.5, "convention", "its 95 % interval reaches from just above 0 to nearly twice of it")
    size_temperature: float = marked(6.0, "convention", "two and a half standard errors of least squares: forms differ")


@dataclass(frozen=True, kw_only=True, slots=True)
class Strokes:
    """How single strokes count beside mean strokes.

    Attributes
    ----------
    against : float
        Log evidence of the strokes below which they speak against an effect.
    least_strokes, of_wave : int
        That a trial must have for its single strokes to be looked at, and for a wave to be looked for in them.
    least_read : float
        Share of them of which there must be samples.
    depth_std : float
        Relative standard uncertainty of a wave's depth: the wood's wave is no sine.
    block : int
        Strokes that are averaged for a trend; what a wood remembers for longer is fitted as memory of the blocks.
    course_std : float
        Log of the hardness by which a course that all trials share is expected to change it.
    looks : int
        What "unknown" may look like: no particular form, three beyond the catalogue, off the stroke, in strokes.
    free_std, little_std : float
        Standard deviation of the powers of speed and feed with which the hardness goes: where another effect of the
        cut or of a sensor may act, and where none does.
    """

    against: float = marked(-1.0, "convention", "odds of e to one against")
    least_strokes: int = marked(12, "convention", "two blocks, whose scatter hardly depends on single strokes")
    of_wave: int = marked(24, "convention", "two seconds, some waves of a wood")
    least_read: float = marked(0.8, "convention", "what lies between the others is a small part of a wave")
    depth_std: float = marked(0.5, "convention", "a factor of two, as `Forms.most_std`")
    block: int = marked(20, "convention", "about 1.5 s; beyond it half of a wood's memory is gone")
    course_std: float = marked(0.15, "convention", "three times what pieces of a wood differ by")
    looks: int = marked(6, "convention", "a count")
    free_std: float = marked(0.5, "convention", "the speed exponents and edge forces that occur, as a power")
    little_std: float = marked(0.03, "convention", "background effects, 5 % of its typical size, as a power")


@dataclass(frozen=True, kw_only=True, slots=True)
class Sensors:
    """What sensors and tracking leave that no repetition shows: priors of nuisances, floors of the noise.

    Attributes
    ----------
    std : mapping of str to float
        Of gains (relative), offsets and the angle's zero, in the unit of the name.
    displacement_gain : float
        Relative standard uncertainty of the gain of a displacement sensor: of the crank radius that a stroke measures.
    crosstalk : float
        Share of one channel over what it usually reaches that another reads, over what that usually reaches: standard
        deviation.
    current_zero_share : float
        Of the usual motor current: standard deviation of the zero of a current sensor, where that is more.
    battery_rel_std : mapping of str to float
        Of the battery's numbers, for which the configuration states none.
    battery_curve : mapping of str to float
        Of the nominal voltage: by what the open-circuit voltage goes otherwise with the charge used, per charge and per
        square of it, and what a full battery has in surplus.
    floor : mapping of str to (float, float)
        By equation: standard deviation of a feature in the unit of its equation, and its growth with each harmonic or,
        for the mechanical equation, with its square (the smoothing of the tracked speed costs the more of the
        acceleration). On a saw that carries the load of `load.OAK`; in proportion to it where that is more.
    mean_voltage_share : mapping of str to float
        By equation: of the battery's voltage, standard deviation of the mean at whatever current. That of the motor is
        the standard uncertainty of the duty.
    linearity_share, linearity_harmonic : float
        Share of the range in use to which a sensor is linear, and the harmonic at which that halves: it is smooth.
    drift_times_s : tuple of float
        Time constants with which a gain, or the zero of a current, changes while its amplifier warms up: over the
        campaign by as much as it is uncertain.
    start_up_floor : mapping of str to float
        At the first motion, where the tracked speed is least certain, in the unit of the equation; on a saw with the
        load of `load.OAK`, as `floor`.
    start_up_decay_s : float
        Time in which that halves.
    zero_std_n : float
        Of the force's zero where its wander is read, and of its drift in 1000 s.
    bend_std_rad : float
        Of the angle that a displacement sensor reads between the ends of the stroke: of its first and second harmonic,
        and of each further one k, times k.
    vibration_share : float
        Of the inertia force of the reciprocating mass: what the load cell may read of it.
    """

    std: Mapping[str, float] = marked(
        {
            "motor_current_gain": 0.01, "motor_current_offset_a": 0.03, "force_gain": 0.01, "force_offset_n": 1.0,
            "battery_current_gain": 0.01, "battery_current_offset_a": 0.03, "battery_voltage_gain": 0.003,
            "battery_voltage_offset_v": 0.01, "angle_zero_rad": 0.005,
        }, "convention", CLASS,
    )  # fmt: skip
    displacement_gain: float = marked(0.01, "convention", CLASS)
    crosstalk: float = marked(5e-4, "convention", "-66 dB; data sheets of multiplexed converters state -60 to -90 dB")
    current_zero_share: float = marked(
        0.01, "convention", "Hall sensors: 0.3 % of a range that is three times the usual current"
    )
    battery_rel_std: Mapping[str, float] = marked(
        {"internal_resistance_ohm": 0.1, "nominal_voltage_v": 0.005, "capacity_ah": 0.05}, "convention",
        "spread of new packs of one type",
    )  # fmt: skip
    battery_curve: Mapping[str, float] = marked(
        {
            "open_circuit_voltage_slope_v": 0.65, "open_circuit_voltage_bend_v": 0.64,
            "open_circuit_voltage_surplus_1_v": 0.008, "open_circuit_voltage_surplus_2_v": 0.012,
            "open_circuit_voltage_surplus_3_v": 0.043, "open_circuit_voltage_surplus_4_v": 0.12,
        }, "measured",
        "python -m benchmarks.battery_curve: LG M50 cells at 0 to 45 degC, 0.1C to 2C",
    )  # fmt: skip
    floor: Mapping[str, tuple[float, float]] = marked(
        {
            "electrical": (0.002, 2e-4), "mechanical": (2e-4, 2e-4), "cutting": (0.06, 0.0), "supply": (1e-3, 0.0),
            "converter": (1.5e-3, 0.0),
        }, "measured", INTACT,
    )  # fmt: skip
    mean_voltage_share: Mapping[str, float] = marked(
        {"electrical": 1e-3, "supply": 1e-3}, "convention",
        "a duty in steps of 1/256, off by half of one at most; cells that rest for minutes come back to 4 mV of 4 V",
    )  # fmt: skip
    linearity_share: float = marked(1e-3, "convention", "linearity of load cells and current sensors: a thousandth")
    linearity_harmonic: float = marked(4.0, "convention", "a bend of the characteristic is smooth over the stroke")
    drift_times_s: tuple[float, ...] = marked(
        (600.0, 3600.0), "convention", "warm-up times of amplifiers: 10 min to 1 h"
    )
    start_up_floor: Mapping[str, float] = marked(
        {"electrical": 0.25, "supply": 0.004, "converter": 0.02, "mechanical": 0.01, "cutting": 3.0},
        "measured",
        INTACT,
    )
    start_up_decay_s: float = marked(0.006, "measured", INTACT)
    zero_std_n: float = marked(5.0, "convention", "free: far beyond the drift of a load cell")
    bend_std_rad: float = marked(
        0.0025, "convention", "inductive sensors are sold as straight to 0.25 % of their range: two standard deviations"
    )
    vibration_share: float = marked(0.05, "convention", "as of other things that every machine has, `BACKGROUND_SHARE`")


@dataclass(frozen=True, kw_only=True, slots=True)
class Workpieces:
    """How hard stocks and pieces of them are.

    Attributes
    ----------
    stock_std_n_s_per_m : float
        Of the cutting coefficient of a stock.
    stock_log_std : float
        The same of its logarithm, where single strokes are compared.
    piece_std : float
        Relative, from one piece of a stock to the next, where a campaign has no repeats.
    piece_degrees : float
        Degrees of freedom that this counts beside repeats.
    reversal_rad : float
        So near a dead centre the force of the cut may be anything.
    """

    stock_std_n_s_per_m: float = marked(1000.0, "convention", "free: three times a hard wood")
    stock_log_std: float = marked(3.0, "convention", "free: a factor of twenty")
    piece_std: float = marked(0.045, "measured", "repeats in wood differ by 4 to 5 %")
    piece_degrees: float = marked(2.0, "convention", "worth one operating point with three trials")
    reversal_rad: float = marked(0.05, "convention", "3 degrees: there the blade travels less than 0.1 % of its stroke")


@dataclass(frozen=True, kw_only=True, slots=True)
class Axis:
    """What a linear axis leaves, in shares of the force scale where nothing else is said.

    Attributes
    ----------
    offset_share : float
        Standard deviation of a zero.
    floor_share : float
        What the model of a real axis misses anyway, where the configuration states no `model_floor_n`.
    form_share, form_harmonic : float
        Of the gap: nature's form of what is missing differs that much from any that is listed, most below that
        harmonic: friction of real guides changes with place, warmth and lubrication.
    standstill_share : float
        Of the cycle's top speed: near a reversal friction is what holds the axis, anything up to breakaway, and
        nothing is concluded.
    """

    offset_share: float = marked(0.02, "convention", "zero of a force or current sensor of class 2")
    floor_share: float = marked(0.005, "convention", "a sensor of class 0.5")
    form_share: float = marked(0.2, "convention", "assumed: how far guides keep to a friction law")
    form_harmonic: float = marked(4.0, "convention", "assumed, as form_share")
    standstill_share: float = marked(0.2, "convention", "above presliding at every usual stroke")


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """All of them, by topic."""

    weights: Weights = field(default_factory=Weights)
    noise: Noise = field(default_factory=Noise)
    forms: Forms = field(default_factory=Forms)
    strokes: Strokes = field(default_factory=Strokes)
    sensors: Sensors = field(default_factory=Sensors)
    workpieces: Workpieces = field(default_factory=Workpieces)
    axis: Axis = field(default_factory=Axis)
    screening: Screening = field(default_factory=Screening)
    reading: Reading = field(default_factory=Reading)
    off_stroke: OffStroke = field(default_factory=OffStroke)
    learning: Learning = field(default_factory=Learning)
    ladder: Ladder = field(default_factory=Ladder)
    report: Report = field(default_factory=Report)
    closing: Closing = field(default_factory=Closing)
    planning: Planning = field(default_factory=Planning)

    def moved(self, name: str, factor: float) -> Settings:
        """Return the same settings with one number multiplied.

        Parameters
        ----------
        name : str
            "topic.number".
        factor : float

        Examples
        --------
        >>> SETTINGS.moved("noise.wide", 2.0).noise.wide
        10.0
        """
        topic, number = name.split(".")
        part = getattr(self, topic)
        return replace(self, **{topic: replace(part, **{number: _times(getattr(part, number), factor)})})


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, Mapping):
        return MappingProxyType({name: _times(one, factor) for name, one in value.items()})
    return tuple(_times(one, factor) for one in value) if isinstance(value, tuple) else factor * value


SETTINGS = Settings()


def marks() -> Iterator[tuple[str, Mark, str]]:
    """Name ("topic.number"), mark and source of every number."""
    for topic in fields(Settings):
        part = getattr(SETTINGS, topic.name)
        assert is_dataclass(part)
        for number in fields(part):
            yield f"{topic.name}.{number.name}", number.metadata["mark"], number.metadata["source"]
