"""What trials have in common that does not follow the stroke: lines between its harmonics, and bursts of interference.

Scatter is no gap; a line is one. A supply that ripples has one frequency in every trial, a rotor out of balance one
number of cycles a stroke, and interference strikes several channels now and then, in air as under load.
None of the catalogue does that, so what is found here is evidence for "unknown". What the wood does is left out: a wave
of the grain keeps its length on the feed path, and is looked for in `stroke_series`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.units import BATTERY_CURRENT, CHANNEL_BY_NAME, ELECTRICAL, FORCE, MOTOR_CURRENT
from sawbench.diagnosis.inference.commutation import is_commutation, is_switching
from sawbench.diagnosis.inference.features import HARMONICS
from sawbench.diagnosis.inference.off_stroke import MAINS_HZ, MULTIPLES, OffStroke
from sawbench.diagnosis.inference.peaks import Peak
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.slow_wave import FREQUENCIES_HZ
from sawbench.diagnosis.inference.strikes import foreign_bursts
from sawbench.modeling.effects.grain_variation import EFFECT as GRAIN
from sawbench.modeling.effects.strokes import StrokeWave

_NUMBERS: Final = SETTINGS.off_stroke
assert isinstance(GRAIN.strokes, StrokeWave)
_MOST_WAVES_PER_M: Final = GRAIN.strokes.waves_per_m[1]

Lock = Literal["time", "stroke"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Line:
    """A line at one frequency at any stroke rate, in one channel.

    Attributes
    ----------
    channel : str
    frequency_hz, amplitude : float
        Median over the trials that show it; the amplitude in the unit of the channel.
    hides : bool
        It is no line of its own, but may stand beside a harmonic of the stroke: the amplitude is of all that is there.
    """

    channel: str
    frequency_hz: float
    amplitude: float
    hides: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """Something that does not follow the stroke and is no scatter.

    Attributes
    ----------
    log_evidence : float
        Against scatter, nats; at most `settings.OffStroke.most_per_trial` a trial.
    text : str
        What it is and where, for the report.
    channel : str
        That shows it most.
    lines_hz : tuple of float
        Frequencies of a line: one, or one for every stroke rate that it goes with; none of bursts.
    equation : str
        Of the report, where it is known in which it acts.
    """

    log_evidence: float
    text: str
    channel: str
    lines_hz: tuple[float, ...] = ()
    equation: str = ""


def off_stroke_findings(trials: Sequence[OffStroke], turns_a_stroke: float | None = None) -> list[Finding]:
    """Weigh what the trials have in common.

    Parameters
    ----------
    trials : sequence of OffStroke
    turns_a_stroke : float, optional
        Of the motor, whose commutator has lines of its own.

    Returns
    -------
    list of Finding
        Those that hold in most of the trials.
    """
    return [*_common_lines(trials, turns_a_stroke), *_common_slow_waves(trials), *_common_bursts(trials)]


def _common_lines(trials: Sequence[OffStroke], turns_a_stroke: float | None) -> Iterator[Finding]:
    idle, loaded = [t for t in trials if t.is_idle], [t for t in trials if not t.is_idle]
    of_sensors = fixed_lines(trials)
    locks: tuple[Lock, ...] = ("stroke", "time")
    for lock in locks:
        for name in sorted({name for t in trials for _, name in t.peaks}):
            for group in (trials, idle, loaded):
                ordinary: list[Peak] = []
                line = common_line(group, lock, name)
                while line and is_commutation(
                    trials, name, line, is_over_time=lock == "time", turns_a_stroke=turns_a_stroke
                ):
                    ordinary += [peak for _, peak in line]
                    line = common_line(group, lock, name, besides=ordinary)
                if not line or (lock == "stroke" and _is_any_of(of_sensors, name, line)):
                    continue
                if _is_not_the_wood(line, lock) and _is_no_pickup(trials, group, lock, name, line):
                    yield _line_finding(group, lock, name, line)
                    break


def common_line(
    group: Sequence[OffStroke], lock: Lock, name: str, besides: Sequence[Peak] = ()
) -> list[tuple[OffStroke, Peak]]:
    """Peaks of one channel at the same place in most trials of a group, with their trials; else none.

    `besides` are peaks of other lines.
    """
    best: list[tuple[OffStroke, Peak]] = []
    strong = [p for t in group for p in t.peaks.get((lock, name), ()) if p.power > _NUMBERS.least_power]
    for candidate in strong:
        if any(abs(candidate.place - other.place) < _tolerance(candidate, other) for other in besides):
            continue
        same = _at(group, lock, name, candidate)
        if sum(np.log(p.power) for _, p in same) > sum(np.log(p.power) for _, p in best):
            best = same
    is_rare = not best or len(best) < _enough(group, lock, max((p for _, p in best), key=lambda p: p.power))
    return [] if is_rare or _share_of(best) < _NUMBERS.least_share else best


def _share_of(line: Sequence[tuple[OffStroke, Peak]]) -> float:
    """Of what does not follow the stroke: in all of the trials, or in air, where there is no wood that scatters."""
    in_air = [peak.share for trial, peak in line if trial.is_idle]
    return float(max(np.median([peak.share for _, peak in line]), np.median(in_air) if in_air else 0.0))


def enough_trials(n_trials: int, fewest: int = SETTINGS.noise.least_trials) -> float:
    """How many of `n_trials` make what they show the machine's: most of them, and never fewer than `fewest`."""
    return max(_NUMBERS.in_most * n_trials, fewest)


def _enough(group: Sequence[OffStroke], lock: Lock, line: Peak) -> float:
    """Most of the trials in which the line does not fall on a harmonic of the stroke."""
    orders = [line.place / t.rate_hz if lock == "time" else line.place for t in group]
    open_to_it = sum(abs(x - round(x)) > 1.5 * t.near_harmonic for x, t in zip(orders, group, strict=True))
    return enough_trials(open_to_it)


def _at(group: Sequence[OffStroke], lock: Lock, name: str, wanted: Peak) -> list[tuple[OffStroke, Peak]]:
    found = []
    for trial in group:
        near = [p for p in trial.peaks.get((lock, name), ()) if abs(p.place - wanted.place) < _tolerance(p, wanted)]
        if near:
            found.append((trial, max(near, key=lambda p: p.power)))
    return found


def _tolerance(one: Peak, other: Peak) -> float:
    return max(_NUMBERS.same_place * other.place, 1.5 * max(one.width, other.width))


def _is_not_the_wood(line: Sequence[tuple[OffStroke, Peak]], lock: Lock) -> bool:
    """In air there is none; under load, a wave of the wood has one length on the feed path, no shorter than fine grain.

    It stands alone or beside a harmonic of the stroke. Where trials of other feed a stroke tell, the places of the line
    fit that better, or they fit a line that stays where it is.
    """
    if any(trial.is_idle for trial, _ in line):
        return True
    fed = [(trial, peak) for trial, peak in line if np.isfinite(trial.feed_a_stroke_m)]
    if len(fed) < SETTINGS.noise.least_trials:
        return False
    strokes_a_unit = np.array([1.0 / trial.rate_hz if lock == "time" else 1.0 for trial, _ in fed])
    places = np.array([peak.place for _, peak in fed])
    widths = np.array([peak.width for _, peak in fed])
    feeds_m = np.array([trial.feed_a_stroke_m for trial, _ in fed])
    stays = _misfit((places - np.median(places)) / widths)
    for beside in (np.zeros(len(fed)), np.round(strokes_a_unit * places)):
        cycles = strokes_a_unit * places - beside
        waves_per_m = float(np.median(np.abs(cycles) / feeds_m))
        of_wood = waves_per_m * feeds_m
        moves = _misfit((np.abs(cycles) - of_wood) / np.hypot(strokes_a_unit * widths, _NUMBERS.feed_error * of_wood))
        if waves_per_m <= _MOST_WAVES_PER_M and moves - stays < _NUMBERS.by_chance:
            return False
    return True


def _misfit(deviations: Floats) -> float:
    """Minus the log likelihood of places, in resolutions of their spectra, some of which are of something else."""
    return float(np.minimum(0.5 * deviations**2, _NUMBERS.by_chance).sum())


def _is_no_pickup(
    trials: Sequence[OffStroke], group: Sequence[OffStroke], lock: Lock, name: str,
    line: Sequence[tuple[OffStroke, Peak]],
) -> bool:  # fmt: skip
    """A fixed frequency is hum of a sensor unless two currents or voltages show it; what follows the stroke is not.

    What shakes the bench is in the force, and as far as it changes the cut in the currents too: where these show no
    more of it than a converter's switching may leave, it is no gap.

    At the mains' frequency it is hum in however many channels, for no battery has that, unless both currents show it as
    the converter relates them: a charger that stays connected. Where all trials run at nearly one speed, a fixed
    frequency stands at nearly one order of the stroke as well. Beyond the harmonics that are compared it is no gap in
    however many channels: the model has the means over the switching of a converter, which sampling may place there,
    and a little of it anywhere.
    """
    middle = max((p for _, p in line), key=lambda p: p.power)
    if lock == "time" and (middle.place > fastest_compared_hz(group) or is_switching(trials, name, line)):
        return False
    if is_mains(float(np.median([p.place if lock == "time" else p.place * trial.rate_hz for trial, p in line]))):
        return lock == "time" and name in ELECTRICAL and _is_a_current(group, middle)
    if lock == "stroke":
        return True
    lines = {n: _at(group, lock, n, middle) for n in {n for t in group for _, n in t.peaks}}
    enough = _enough(group, lock, middle)
    seen = [n for n, one in lines.items() if len(one) >= enough and not is_switching(trials, n, one)]
    return name in seen and sum(n in ELECTRICAL for n in seen) > 1


def fastest_compared_hz(trials: Sequence[OffStroke]) -> float:
    """Frequency of the highest harmonic of the stroke that is compared in any of some trials, Hz."""
    return max(HARMONICS.values()) * max(trial.rate_hz for trial in trials)


def _is_a_current(group: Sequence[OffStroke], line: Peak) -> bool:
    """Whether the battery's current at a fixed frequency is duty times that of the motor.

    Told by trials whose duty is far from 1: two cables may pick up as much.
    """
    motor, battery = (
        {t.label: p.amplitude for t, p in _at(group, "time", name, line)}
        for name in (MOTOR_CURRENT.name, BATTERY_CURRENT.name)
    )
    telling = [t for t in group if t.duty < _NUMBERS.duty_tells and t.label in motor and t.label in battery]
    apart = np.array([abs(np.log(battery[t.label] / (t.duty * motor[t.label]))) for t in telling])
    return len(telling) >= SETTINGS.noise.least_trials and bool(
        np.mean(apart < _NUMBERS.same_current) >= _NUMBERS.in_most
    )


def _is_any_of(fixed: Sequence[Line], name: str, line: Sequence[tuple[OffStroke, Peak]]) -> bool:
    """Whether a line over the stroke is one at a fixed frequency: in trials of one speed it is both."""
    return any(
        one.channel == name
        and all(abs(p.place * t.rate_hz - one.frequency_hz) < _NUMBERS.same_place * one.frequency_hz for t, p in line)
        for one in fixed
    )


def _line_finding(group: Sequence[OffStroke], lock: Lock, name: str, line: Sequence[tuple[OffStroke, Peak]]) -> Finding:
    peaks = [p for _, p in line]
    place = float(np.median([p.place for p in peaks]))
    amplitude = float(np.median([p.amplitude for p in peaks]))
    at = f"{place:.1f} Hz at any stroke rate" if lock == "time" else f"{place:.2f} cycles per stroke"
    lines_hz = {place} if lock == "time" else {place * trial.rate_hz for trial, _ in line}
    return Finding(
        log_evidence=sum(min(p.power, _NUMBERS.most_per_trial) for p in peaks),
        channel=name,
        lines_hz=tuple(sorted({round(line_hz, 1) for line_hz in lines_hz})),
        text=(
            f"{name} oscillates by {amplitude:.2g} {CHANNEL_BY_NAME[name].unit} at {at}, in {len(line)} of {len(group)}"
            " trials: no effect of the catalogue does this"
        ),
    )


def _common_slow_waves(trials: Sequence[OffStroke]) -> Iterator[Finding]:
    """A slow wave of the force at one frequency in most trials, and in air: what follows the wood is not there."""
    from scipy.ndimage import maximum_filter1d

    told = [(t, t.slow) for t in trials if t.slow is not None]
    if not told:
        return
    exact = np.nan_to_num([wave.log_gain for _, wave in told], nan=-np.inf)
    # The highest within 2 %: a carriage keeps no better time.
    gains = maximum_filter1d(exact, 5, axis=1)
    is_told = np.isfinite(gains)
    exact, gains = np.where(np.isfinite(exact), exact, 0.0), np.where(is_told, gains, 0.0)
    counted = np.minimum(gains, _NUMBERS.most_per_trial)
    in_air = counted[[t.is_idle for t, _ in told]].sum(axis=0)
    shown, n_told = (gains > 0.0).sum(axis=0), is_told.sum(axis=0)
    is_common = (shown >= _NUMBERS.in_most * n_told) & (n_told >= SETTINGS.noise.least_trials)
    is_the_machines = is_common & (in_air > _NUMBERS.by_chance)
    best = int(np.argmax(np.where(is_the_machines, exact.sum(axis=0), -np.inf)))
    log_evidence = float(counted[:, best].sum() - np.log(len(FREQUENCIES_HZ)))
    if not is_the_machines[best] or log_evidence <= 0.0:
        return
    amplitude = float(np.nanmedian([wave.amplitude[best] for _, wave in told]))
    at_hz = float(FREQUENCIES_HZ[best])
    yield Finding(
        log_evidence=log_evidence,
        channel=FORCE.name,
        lines_hz=(round(at_hz, 1),),
        text=(
            f"{FORCE.name} oscillates by {amplitude:.2g} {FORCE.unit} at {at_hz:.1f} Hz at any stroke rate"
            f" in {shown[best]} of {n_told[best]} trials, also while the blade returns and in idle runs: a carriage"
            " that sticks and slips, or something else that moves the load cell"
        ),
    )


def _common_bursts(trials: Sequence[OffStroke]) -> Iterator[Finding]:
    """In air as well: a knot in the wood strikes too. Those of one sensor alone are its own (`foreign_bursts`)."""
    struck = {t.label: [n for n, found in t.struck.items() if found.share > _NUMBERS.least_struck] for t in trials}
    hit = [t for t in trials if struck[t.label]]
    idle, hit_idle = [t for t in trials if t.is_idle], [t for t in hit if t.is_idle]
    if not idle or len(hit_idle) < _NUMBERS.in_most * len(idle) or len(hit) < enough_trials(len(trials)):
        return
    if foreign_bursts(trials):
        return
    channels = sorted({name for t in hit for name in struck[t.label]})
    yield Finding(
        log_evidence=_NUMBERS.most_per_trial * len(hit),
        channel=max(
            channels, key=lambda name: float(np.median([t.struck[name].share for t in hit if name in t.struck]))
        ),
        text=(
            f"bursts in {', '.join(channels)}, in {len(hit)} of {len(trials)} trials, also in idle runs:"
            " interference, or"
            " impacts that no effect of the catalogue causes"
        ),
    )


def fixed_lines(trials: Sequence[OffStroke]) -> list[Line]:
    """Lines at a fixed frequency that one sensor picks up, in most of the trials that could show them.

    Parameters
    ----------
    trials : sequence of OffStroke

    Returns
    -------
    list of Line
        By channel, the strongest first; without what two currents or voltages share, which the machine does.
    """
    found = []
    for name in sorted({name for t in trials for _, name in t.peaks}):
        left = [p for t in trials for p in t.peaks.get(("time", name), ()) if p.power > _NUMBERS.least_power]
        while left:
            wanted = max(left, key=lambda p: p.power)
            left = [p for p in left if abs(p.place - wanted.place) >= _tolerance(p, wanted)]
            same = _at(trials, "time", name, wanted)
            if len(same) < _enough(trials, "time", wanted) or not _keeps_its_frequency(same):
                continue
            if _is_no_pickup(trials, trials, "time", name, same):
                continue
            amplitude = float(np.median([p.amplitude for _, p in same]))
            place = float(np.median([p.place for _, p in same]))
            found.append(Line(channel=name, frequency_hz=place, amplitude=amplitude))
    return found


def hum_lines(trials: Sequence[OffStroke]) -> list[Line]:
    """Hum of the mains: the lines of each channel, and what may hide at the other multiples of their mains.

    Where most trials run at nearly a fraction of a multiple, it is no line in them, and stands in the mean stroke of
    those that run at just that.

    Parameters
    ----------
    trials : sequence of OffStroke

    Returns
    -------
    list of Line
        Those that hide with all that the trials have there, the median of those in which it is no harmonic.
    """
    lines = [line for line in fixed_lines(trials) if is_mains(line.frequency_hz)]
    hidden: list[Line] = []
    for name in dict.fromkeys(line.channel for line in lines):
        measured = np.array([t.of_mains[name] for t in trials if name in t.of_mains])
        at_hz = [line.frequency_hz for line in lines if line.channel == name]
        for mains_hz, amplitudes in zip(MAINS_HZ, measured.transpose(1, 2, 0), strict=True):
            hidden += _hidden_lines(name, mains_hz, at_hz, amplitudes)
    return [*lines, *hidden]


def _hidden_lines(channel: str, mains_hz: float, at_hz: Sequence[float], amplitudes: Floats) -> Iterator[Line]:
    """Multiples of one mains beside those of a channel that are lines; `amplitudes`: (multiples, trials)."""
    lines = {n: hz for hz in at_hz if (n := _multiple_of(mains_hz, hz))}
    if not lines:
        return
    exact_hz = float(np.median([hz / n for n, hz in lines.items()]))
    for n, of_trials in zip(MULTIPLES.tolist(), amplitudes, strict=True):
        if n not in lines and np.isfinite(of_trials).any():
            yield Line(channel=channel, frequency_hz=n * exact_hz, amplitude=float(np.nanmedian(of_trials)), hides=True)


def _keeps_its_frequency(line: Sequence[tuple[OffStroke, Peak]]) -> bool:
    """Trials agree on the frequency better than on the cycles a stroke."""
    places = np.array([p.place for _, p in line])
    orders = places / np.array([t.rate_hz for t, _ in line])
    return bool(places.std() / places.mean() < orders.std() / orders.mean())


def is_mains(frequency_hz: float, within_hz: float = 0.0) -> bool:
    """Whether a frequency is that of the mains or a multiple, or closer to one than the resolution of a spectrum.

    Examples
    --------
    >>> is_mains(150.1), is_mains(57.0), is_mains(57.0, within_hz=4.0)
    (True, False, True)
    """
    return any(_multiple_of(mains_hz, frequency_hz, within_hz) for mains_hz in MAINS_HZ)


def _multiple_of(mains_hz: float, frequency_hz: float, within_hz: float = 0.0) -> int:
    """Which multiple of the mains a frequency is; 0 where it is none."""
    n = round(frequency_hz / mains_hz)
    nearest_hz = n * mains_hz
    is_near = abs(frequency_hz - nearest_hz) < max(SETTINGS.report.mains_tolerance * nearest_hz, within_hz)
    return n if n in MULTIPLES and is_near else 0
