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
from typing import Any, Final, Literal

# Half the 95 % interval of a normal distribution over its standard deviation: the level of every claim, by convention.
Z95: Final = 1.959964
Mark = Literal["fitted", "measured", "convention"]
_CALIBRATED = "`benchmarks.calibrate_diagnosis fit`, seeds 1 to 999"
_BY_HAND = "answers to development campaigns, seeds 1 to 999, by hand"
_INTACT = "what development campaigns without an effect, seeds 1 to 999, leave"
_CLASS = "usual class of such instruments, one standard deviation"


def _number(value: Any, mark: Mark, source: str) -> Any:
    said = {"mark": mark, "source": source}
    if isinstance(value, dict):
        return field(default_factory=lambda: MappingProxyType(value), metadata=said)
    return field(default=value, metadata=said)


@dataclass(frozen=True, kw_only=True, slots=True)
class Weights:
    """From log evidences to probabilities.

    Attributes
    ----------
    temperature : float
        Divides log evidences where the noise is as modelled.
    quiet : float
        Whitened misfit over features that an intact machine leaves on a quiet bench.
    pair_gain : float
        Log odds of two effects against the stronger one alone, per e-fold of the log evidence that the second adds.
    pair_least, pair_share : float
        That log evidence at which they are even: the first plus the second times the root of the log evidence of
        the stronger effect alone, because the form of a strong effect misses more.
    open_gain, open_share : float
        Log odds of "unknown" against the best claim per e-fold of the share of the gap that this leaves, and the
        share at which they are even.
    left_by_an_intact_machine : float
        Times `quiet`: what is left below that is no share of the gap.
    acts_share : float
        Of a signature's energy: an effect acts in the equations that hold that much.
    prior_no_gap, prior_parameters, prior_unknown : float
        The rest belongs to the effects, evenly.
    """

    temperature: float = _number(3.0, "fitted", f"{_CALIBRATED}; set above its fit, to claim less")
    quiet: float = _number(0.15, "fitted", _BY_HAND)
    pair_gain: float = _number(1.4, "fitted", _CALIBRATED)
    pair_least: float = _number(11.0, "fitted", _CALIBRATED)
    pair_share: float = _number(0.7, "fitted", _CALIBRATED)
    open_gain: float = _number(2.6, "fitted", _CALIBRATED)
    open_share: float = _number(0.47, "fitted", _CALIBRATED)
    left_by_an_intact_machine: float = _number(1.7, "fitted", _BY_HAND)
    acts_share: float = _number(0.01, "convention", "a hundredth is what filters and tracking mix into other equations")
    prior_no_gap: float = _number(0.45, "fitted", f"{_CALIBRATED}; moved: a parameter 5 sigma off is called so")
    prior_parameters: float = _number(0.15, "fitted", "as prior_no_gap")
    prior_unknown: float = _number(0.06, "fitted", _CALIBRATED)


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
    """

    correlation_factor: float = _number(1.5, "fitted", _BY_HAND)
    quiet_share: float = _number(1.25, "fitted", _BY_HAND)
    wide: float = _number(5.0, "convention", "re-tuning by five stated standard deviations is still the same machine")
    memory_strokes: float = _number(3.0, "convention", "as `OffStroke.near_harmonic`")
    least_trials: int = _number(3, "convention", "two may agree by chance")


@dataclass(frozen=True, kw_only=True, slots=True)
class Forms:
    """How far nature's form may be from the catalogue's, and when that is looked at.

    Attributes
    ----------
    shares : tuple of float
        Standard deviation of each part of the smooth factor on a signature, as a share of it: all are tried.
    steady_share : float
        Of an effect that does not depend on time, the part that does.
    harmonic_factor : float
        Each harmonic may also be larger and turned on its own, as another filter or a sharper corner would have it.
    screen_share : float
        Share that the first effect of a pair may miss while the second one is screened.
    n_formed, n_first, n_pairs : int
        Effects, firsts of a pair and pairs that are weighed with what their forms may miss.
    worth_forming : float
        Log evidence of a second effect below which its form does not matter.
    least_amplitude : float
        Of the typical size: less is background, not a cause.
    most_std : float
        Relative standard uncertainty of a magnitude that is right to a factor of two; no form leaves more.
    size_temperature : float
        Divides what the features say of the size of an effect: no form is nature's, and sizes miss more by that than
        causes.
    """

    shares: tuple[float, ...] = _number((0.0, 0.03, 0.1, 0.25), "convention", "none, and three sizes a factor 3 apart")
    steady_share: float = _number(0.1, "fitted", _BY_HAND)
    harmonic_factor: float = _number(1.5, "fitted", _BY_HAND)
    screen_share: float = _number(0.05, "convention", "between the two smaller ones of the shares that are tried")
    n_formed: int = _number(12, "convention", "time: each costs 0.1 s")
    n_first: int = _number(5, "convention", "time: each costs a pass over the catalogue")
    n_pairs: int = _number(8, "convention", "time: each costs 0.2 s")
    worth_forming: float = _number(6.0, "convention", "time: below, no pair reaches even odds (`Weights.pair_least`)")
    least_amplitude: float = _number(0.15, "convention", "three standard deviations of the background of 5 %")
    most_std: float = _number(0.5, "convention", "its 95 % interval reaches from just above 0 to nearly twice of it")
    size_temperature: float = _number(6.0, "fitted", _BY_HAND)


@dataclass(frozen=True, kw_only=True, slots=True)
class Strokes:
    """How single strokes count beside mean strokes.

    Attributes
    ----------
    weight : float
        Strokes are independent and their spectrum is fitted: one nat of theirs counts as that many of whitened
        features. The same alone, beside another effect and for a wave in time: else a second name would make the
        strokes speak louder.
    price : float
        Taken off a trend for which strokes speak: with a dozen pieces of wood luck looks like one.
    against : float
        Log evidence of the strokes below which they speak against an effect.
    depth_std : float
        Relative standard uncertainty of a wave's depth: the wood's wave is no sine.
    block : int
        Strokes that are averaged for a trend; what a wood remembers for longer is fitted as memory of the blocks.
    free_std, little_std : float
        Standard deviation of the powers of speed and feed with which the hardness goes: where another effect of the
        cut or of a sensor may act, and where none does.
    """

    weight: float = _number(4.0, "fitted", _BY_HAND)
    price: float = _number(7.0, "fitted", _BY_HAND)
    against: float = _number(-1.0, "convention", "odds of e to one against")
    depth_std: float = _number(0.5, "convention", "a factor of two, as `Forms.most_std`")
    block: int = _number(20, "convention", "about 1.5 s; beyond it half of a wood's memory is gone")
    free_std: float = _number(0.5, "convention", "the speed exponents and edge forces that occur, as a power")
    little_std: float = _number(0.03, "convention", "background effects, 5 % of its typical size, as a power")


@dataclass(frozen=True, kw_only=True, slots=True)
class Sensors:
    """What sensors and tracking leave that no repetition shows: priors of nuisances, floors of the noise.

    Attributes
    ----------
    std : mapping of str to float
        Of gains (relative), offsets and the angle's zero, in the unit of the name.
    battery_rel_std : mapping of str to float
        Of the battery's numbers, for which the configuration states none.
    floor : mapping of str to (float, float)
        By equation: standard deviation of a feature in the unit of its equation, and its growth with each harmonic or,
        for the mechanical equation, with its square (the smoothing of the tracked speed costs the more of the
        acceleration).
    mean_voltage_floor_v : float
        Of the mean of the electrical equation, at whatever current.
    force_share, force_harmonic : float
        Share of its peak to which a load cell is linear, and the harmonic at which that halves: it is smooth.
    start_up_floor : mapping of str to float
        At the first motion, where the tracked speed is least certain, in the unit of the equation.
    start_up_decay_s : float
        Time in which that halves.
    zero_std_n : float
        Of the force's zero where its wander is read, and of its drift in 1000 s.
    """

    std: Mapping[str, float] = _number(
        {
            "motor_current_gain": 0.01, "motor_current_offset_a": 0.03, "force_gain": 0.01, "force_offset_n": 1.0,
            "battery_current_gain": 0.01, "battery_current_offset_a": 0.03, "battery_voltage_gain": 0.003,
            "battery_voltage_offset_v": 0.01, "angle_zero_rad": 0.005,
        }, "convention", _CLASS,
    )  # fmt: skip
    battery_rel_std: Mapping[str, float] = _number(
        {"internal_resistance_ohm": 0.1, "nominal_voltage_v": 0.005, "capacity_ah": 0.05}, "convention",
        "spread of new packs of one type",
    )  # fmt: skip
    floor: Mapping[str, tuple[float, float]] = _number(
        {
            "electrical": (0.002, 2e-4), "mechanical": (2e-4, 2e-4), "cutting": (0.06, 0.0), "supply": (1e-3, 0.0),
            "converter": (1.5e-3, 0.0),
        }, "measured", _INTACT,
    )  # fmt: skip
    mean_voltage_floor_v: float = _number(0.005, "convention", "0.05 % of 10 V")
    force_share: float = _number(1e-3, "convention", "linearity of a load cell: a thousandth of the peak")
    force_harmonic: float = _number(4.0, "convention", "a bend of the characteristic is smooth over the stroke")
    start_up_floor: Mapping[str, float] = _number(
        {"electrical": 0.25, "supply": 0.004, "converter": 0.02, "mechanical": 0.01, "cutting": 3.0},
        "measured",
        _INTACT,
    )
    start_up_decay_s: float = _number(0.006, "measured", _INTACT)
    zero_std_n: float = _number(5.0, "convention", "free: far beyond the drift of a load cell")


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
    """

    stock_std_n_s_per_m: float = _number(1000.0, "convention", "free: three times a hard wood")
    stock_log_std: float = _number(3.0, "convention", "free: a factor of twenty")
    piece_std: float = _number(0.045, "measured", "repeats in wood differ by 4 to 5 %")
    piece_degrees: float = _number(2.0, "convention", "worth one operating point with three trials")


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

    offset_share: float = _number(0.02, "convention", "zero of a force or current sensor of class 2")
    floor_share: float = _number(0.005, "convention", "a sensor of class 0.5")
    form_share: float = _number(0.2, "convention", "assumed: how far guides keep to a friction law")
    form_harmonic: float = _number(4.0, "convention", "assumed, as form_share")
    standstill_share: float = _number(0.2, "convention", "above presliding at every usual stroke")


@dataclass(frozen=True, kw_only=True, slots=True)
class OffStroke:
    """When what does not follow the stroke is a line or a burst, and no scatter.

    Attributes
    ----------
    least_strokes : int
        Complete strokes that a trial needs.
    lowest_order : float
        Cycles a stroke below which a wave is one of the wood or of the hand: see `stroke_series`.
    near_harmonic : float
        Cycles a stroke: harmonics scatter from stroke to stroke, so no line is looked for that near to one.
    least_power, seen_power : float
        Power over the floor around a line: of the strongest of a set, and of its companions.
    foot_share : float
        A line is narrow: beside it no more than that share of its power is left.
    least_share : float
        Of the variance that does not follow the stroke: what is smaller is a matter of the sensor, not of the machine.
    same_place : float
        Relative difference of two lines that are one.
    in_most : float
        Share of the trials that could show something, in which it must stand to be common to a campaign.
    moved : float
        Times its tolerance a wave of the wood would have to move between trials of other feed a stroke.
    most_per_trial : float
        Log evidence that one trial may give, nats.
    strike : float
        Robust deviations by which a cell of the crank angle and a neighbour are off: a stray value is shorter.
    least_struck : float
        Share of the variance that strikes of a machine hold.
    least_picked_up : float
        The same of interference in air: scatter and lines give no strike at all.
    same_burst, felt : float
        Of a stroke: strikes that near are one burst; for so long the motor feels a blow.
    felt_stds : float
        Significance of the motor's answer to blows.
    """

    least_strokes: int = _number(32, "convention", "the spectrum's lines are half of near_harmonic apart")
    lowest_order: float = _number(0.25, "convention", "four strokes a wave")
    near_harmonic: float = _number(
        0.06, "convention", "half width, 1/(6 pi), of a harmonic that remembers three strokes"
    )
    least_power: float = _number(60.0, "convention", "beyond scatter: the largest of 8000 bins is about 9")
    seen_power: float = _number(20.0, "convention", "scatter reaches it once in 6 10^4 such spectra")
    foot_share: float = _number(0.1, "convention", "of a window's line nothing is left there, of a hump most is")
    least_share: float = _number(0.15, "convention", "less is hidden by the scatter itself")
    same_place: float = _number(0.003, "convention", "clocks and speeds are known to better than that")
    in_most: float = _number(0.7, "convention", "more than two of three")
    moved: float = _number(3.0, "convention", "three standard deviations")
    most_per_trial: float = _number(20.0, "convention", "no single trial names a cause: one in e^20")
    strike: float = _number(8.0, "convention", "no scatter reaches it, nor do heavy tails twice in a row")
    least_struck: float = _number(0.3, "convention", "a third of what is asynchronous")
    least_picked_up: float = _number(0.03, "convention", "ten times below what a machine is blamed for")
    same_burst: float = _number(0.15, "convention", "shorter than the cut, which is half a stroke")
    felt: float = _number(0.25, "convention", "the motor's time constant, in strokes")
    felt_stds: float = _number(4.0, "convention", "one in 3 10^4 by chance")


@dataclass(frozen=True, kw_only=True, slots=True)
class Ladder:
    """How withheld trials are predicted, and what is called closed.

    Attributes
    ----------
    least_rest : float
        Share of the noise energy below which no cause can be shown to leave less.
    least_blocks, least_groups : int
        Time blocks of a trial that give a scatter about a straight line; withheld groups that give an interval.
    farthest, farthest_sensor : float
        Re-tuned numbers stay within this many widened standard deviations: farther off it is not the same machine.
    solved_forms : int
        Forms of a cause that are solved with these bounds.
    """

    least_rest: float = _number(0.02, "convention", "a closed gap is stated to 2 %")
    least_blocks: int = _number(3, "convention", "a straight line takes two")
    least_groups: int = _number(3, "convention", "a standard error from leaving out one in turn")
    farthest: float = _number(2.0, "convention", "95 %, as every interval")
    farthest_sensor: float = _number(
        5.0, "convention", "a sensor's zero and gain are known less than a motor's constants"
    )
    solved_forms: int = _number(3, "convention", "time: each costs a bounded least-squares problem")


@dataclass(frozen=True, kw_only=True, slots=True)
class Report:
    """What the report says, and from when on.

    Attributes
    ----------
    odds : float
        Of the leading cause against one that is called indistinguishable from it.
    false_discovery_rate : float
        Of the parts of the crank angle and the spectrum that are called significant.
    grows_with : float
        Rank correlation of a gap with speed, load, time, position or feed from which it grows with it.
    shown_share : float
        Of the gap: a place with less is not named.
    shown_log_odds : float
        Log odds against no gap below which an effect of typical magnitude would probably not be named.
    settled : float
        Probability from which the next trial is to confirm, not to decide.
    worth : float
        Log odds that one more trial must be worth to be advised.
    wander_stds : float
        Significance of a zero that wanders.
    least_fault : mapping of str to float
        Below these a fault of a sensor costs nothing: share of samples missing, jitter in sample periods, spikes a
        second, wander and jumps at restarts in N.
    """

    odds: float = _number(20.0, "convention", "95 %, as every interval")
    false_discovery_rate: float = _number(0.05, "convention", "95 %")
    grows_with: float = _number(0.6, "convention", "a third of the variance of the ranks")
    shown_share: float = _number(0.02, "convention", "less than what any form leaves")
    shown_log_odds: float = _number(16.0, "convention", "odds of 200 after `Weights.temperature`")
    settled: float = _number(0.95, "convention", "95 %")
    worth: float = _number(1.0, "convention", "odds of e")
    wander_stds: float = _number(3.0, "convention", "three standard deviations")
    least_fault: Mapping[str, float] = _number(
        {"missing": 1e-3, "jitter": 0.05, "spikes_hz": 0.05, "wander_n": 0.1, "restart_n": 0.5}, "convention",
        "less than the floors of `Sensors`",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class Closing:
    """Cause after cause: how the model that holds some causes is weighed again.

    Attributes
    ----------
    most_passes : int
        Weighings of one campaign.
    least_rel_std : float
        Relative standard uncertainty, at least, of a magnitude that later causes may correct.
    least_probability : float
        Below it an alternative of a pass is not carried along.
    within_noise : float
        Share of the energy of the noise that nobody can close.
    left_on_trial : float
        Share of the gap that causes which were followed although "unknown" was likelier may leave.
    """

    most_passes: int = _number(6, "convention", "time: a pass costs as much as the first weighing")
    least_rel_std: float = _number(0.25, "convention", "a second cause moves the first by half at most")
    least_probability: float = _number(0.02, "convention", "odds of fifty to one against")
    within_noise: float = _number(0.02, "convention", "as the ladder: less cannot be shown")
    left_on_trial: float = _number(0.1, "convention", "what a right claim leaves of what can be closed")


@dataclass(frozen=True, kw_only=True, slots=True)
class Planning:
    """Which trials are proposed next.

    Attributes
    ----------
    handling_s : float
        What a trial takes beside its duration: to clamp, to zero, to look.
    rest_s : float
        Rest before a trial that is to begin with a cold machine.
    longer : float
        Duration of a long trial over the usual one of the campaign.
    least_probability : float
        Below it an answer is not separated from the others, unless there are fewer than two.
    """

    handling_s: float = _number(60.0, "convention", "a minute")
    rest_s: float = _number(900.0, "convention", "a motor's winding has cooled by then")
    longer: float = _number(3.0, "convention", "what grows with time is three times as large")
    least_probability: float = _number(0.001, "convention", "as the report lists causes")


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
    off_stroke: OffStroke = field(default_factory=OffStroke)
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
        >>> SETTINGS.moved("strokes.price", 2.0).strokes.price
        14.0
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
