"""What does not follow the stroke: lines between its harmonics, and bursts of interference.

All else in the diagnosis is averaged over strokes, and what is not locked to them is lost there as scatter. Scatter
is no gap; a line is one. A supply that ripples has one frequency in every trial, a rotor out of balance one number
of cycles a stroke, and interference strikes several channels now and then, in air as under load.
None of the catalogue does that, so what is found here is evidence for "unknown". What the wood does is left out: a wave
of the grain keeps its length on the feed path, and is looked for in `stroke_series`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from sawbench.bench.processed import TrackedTrial
from sawbench.bench.recording import Floats
from sawbench.bench.units import (
    BATTERY_CURRENT,
    BATTERY_VOLTAGE,
    CHANNEL_BY_NAME,
    DISPLACEMENT,
    FORCE,
    MOTOR_CURRENT,
)
from sawbench.diagnosis.inference.peaks import Peak, Spectrum, near_harmonic, not_sharper_in, peaks_of
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.strikes import Answer, Strikes, answer_of, foreign_bursts, resolution_of, strikes
from sawbench.modeling.effects.grain_variation import EFFECT as GRAIN
from sawbench.modeling.effects.strokes import StrokeWave
from sawbench.modeling.state import TWO_PI
from sawbench.processing.binning import AngleGrid

_CELLS, _FEWEST_CELLS, _SAMPLES_A_CELL = 64, 16, 1.5
_MOST_EMPTY = 0.02
_MAINS_HZ, _MULTIPLES = (50.0, 60.0), np.arange(1, 8)
_NUMBERS: Final = SETTINGS.off_stroke
assert isinstance(GRAIN.strokes, StrokeWave)
_MOST_WAVES_PER_M: Final = GRAIN.strokes.waves_per_m[1]
# They follow from each other, and are read by different sensors.
_ELECTRICAL = (MOTOR_CURRENT.name, BATTERY_VOLTAGE.name, BATTERY_CURRENT.name)

Lock = Literal["time", "stroke"]


@dataclass(frozen=True, kw_only=True, slots=True)
class OffStroke:
    """What one trial holds beside its strokes.

    Attributes
    ----------
    label : str
    is_idle : bool
    rate_hz : float
        Strokes a second.
    near_harmonic : float
        Cycles a stroke: nearer to a harmonic no line can be seen.
    feed_a_stroke_m : float
        NaN in air and where no feed is stated.
    peaks : dict of (str, str) to tuple of Peak
        By "time" or "stroke", and channel.
    of_mains : dict of str to ndarray, shape (2, 7)
        Of each channel, amplitude of all that stands at each multiple of either mains; NaN where that is a harmonic.
    struck : dict of str to Strikes
        Of each channel: rare strokes of a cell far off all others.
    answer : Answer
        Of the motor's current to the strikes of the force.
    """

    label: str
    is_idle: bool
    rate_hz: float
    near_harmonic: float
    feed_a_stroke_m: float
    peaks: dict[tuple[str, str], tuple[Peak, ...]]
    of_mains: dict[str, Floats]
    struck: dict[str, Strikes]
    answer: Answer


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


def off_stroke(trial: TrackedTrial) -> OffStroke | None:
    """Look at what is left of each channel once its mean stroke is taken out.

    Parameters
    ----------
    trial : TrackedTrial
        Its settled part is looked at.

    Returns
    -------
    OffStroke or None
        None where there are too few strokes or no channel has enough samples in each.
    """
    angle, steady = trial.angle, trial.steady
    if angle is None or steady is None:
        return None
    inside = np.interp([steady.settled_s, steady.end_s], angle.time_s, angle.angle_rad) / TWO_PI
    first, last = int(np.ceil(inside[0])), int(np.floor(inside[1]))
    n_strokes = last - first
    if n_strokes < _NUMBERS.least_strokes:
        return None
    peaks: dict[tuple[str, str], tuple[Peak, ...]] = {}
    of_mains: dict[str, Floats] = {}
    struck: dict[str, Strikes] = {}
    lefts: dict[str, Floats] = {}
    resolution: dict[str, float] = {}
    begins_s, ends_s = np.interp(TWO_PI * np.array([first, last]), angle.angle_rad, angle.time_s)
    rate_hz = n_strokes / float(ends_s - begins_s)
    channels = {name: s for name, s in trial.channels.items() if name in CHANNEL_BY_NAME and len(s.values) > 1}
    cells = {
        name: _in_cells(np.interp(s.time_s, angle.time_s, angle.angle_rad), s.values, first, n_strokes)
        for name, s in channels.items()
    }
    angle_is_read = _is_read(cells.get(DISPLACEMENT.name), n_strokes)
    for name, in_cells in cells.items():
        if in_cells is None:
            continue
        left = _without_strokes(_filled(in_cells))
        n_cells = left.shape[1]
        at = first + (np.arange(left.size) + 0.5) / n_cells
        at_s = np.interp(TWO_PI * at, angle.angle_rad, angle.time_s)
        flat = left.ravel()
        even_s = np.linspace(at_s[0], at_s[-1], len(flat))
        by_stroke = peaks_of(Spectrum.of(flat, 1.0 / n_cells), 1.0)
        over_time = Spectrum.of(np.interp(even_s, at_s, flat), float(even_s[1] - even_s[0]))
        by_time = peaks_of(over_time, rate_hz)
        peaks["stroke", name] = not_sharper_in(by_time, by_stroke, rate_hz)
        peaks["time", name] = not_sharper_in(by_stroke, by_time, 1.0 / rate_hz)
        of_mains[name] = np.array([over_time.amplitudes_at(hz * _MULTIPLES, rate_hz) for hz in _MAINS_HZ])
        resolution[name] = resolution_of(channels[name].values)
        # Where samples are missing, of the channel or of the angle, what stands in a stroke was not measured.
        measured = (angle_is_read & _is_read(in_cells, n_strokes))[:, None]
        lefts[name] = measured * _without_lines(left, at_s, peaks["time", name])
        struck[name] = strikes(lefts[name], resolution[name], rate_hz)
    if not peaks:
        return None
    feed_mm_s = trial.trial.feed_mm_s
    is_fed = not trial.trial.is_idle and feed_mm_s is not None
    return OffStroke(
        label=trial.trial.trial_id,
        is_idle=trial.trial.is_idle,
        rate_hz=rate_hz,
        near_harmonic=near_harmonic(n_strokes),
        feed_a_stroke_m=1e-3 * feed_mm_s / rate_hz if is_fed and feed_mm_s is not None else float("nan"),
        peaks=peaks,
        of_mains=of_mains,
        struck=struck,
        answer=answer_of(lefts.get(FORCE.name), lefts.get(MOTOR_CURRENT.name), resolution.get(FORCE.name, np.inf)),
    )


def _in_cells(turned_rad: Floats, values: Floats, first_turn: int, n_strokes: int) -> Floats | None:
    """What samples have beyond the mean stroke in each cell of the crank angle, shape (strokes, cells).

    NaN where there is none; None where too many are empty. The mean stroke is taken off the samples, not off the means
    of cells: a few samples lie now in the first, now in the last half of a cell, and where the stroke is steep their
    means beat at orders that are not there.
    """
    per_stroke = len(turned_rad) / max(float(np.ptp(turned_rad)) / TWO_PI, 1e-9)
    n_cells = min(_CELLS, int(per_stroke / _SAMPLES_A_CELL))
    if n_cells < _FEWEST_CELLS:
        return None
    grid = AngleGrid(first_turn=first_turn, n_rows=n_strokes, n_bins=n_cells)
    placed = grid.place(turned_rad)
    cells = grid.means(placed, values)
    is_empty = np.isnan(cells)
    if np.mean(is_empty) > _MOST_EMPTY or is_empty.all(axis=0).any():
        return None
    return grid.means(placed, values - _periodic(np.nanmean(cells, axis=0), turned_rad))


def _periodic(stroke: Floats, turned_rad: Floats) -> Floats:
    """Value at some angles, by a cubic spline, of a wave that is given at the middles of even cells of the turn."""
    from scipy.ndimage import map_coordinates

    place = (turned_rad / TWO_PI % 1.0) * len(stroke) - 0.5
    return np.asarray(map_coordinates(stroke, [place], order=3, mode="grid-wrap"), dtype=np.float64)


def _filled(cells: Floats) -> Floats:
    """Interpolate empty cells."""
    flat = cells.ravel()
    known = np.flatnonzero(~np.isnan(flat))
    return np.interp(np.arange(flat.size), known, flat[known]).reshape(cells.shape)


def _is_read(cells: Floats | None, n_strokes: int) -> np.ndarray:
    """Strokes without an empty cell, in them or in those beside them; all where the channel is not there."""
    if cells is None:
        return np.ones(n_strokes, dtype=bool)
    is_broken = np.asarray(np.isnan(cells).any(axis=1))
    beside = np.zeros_like(is_broken)
    beside[1:] |= is_broken[:-1]
    beside[:-1] |= is_broken[1:]
    return ~(is_broken | beside)


def _without_strokes(cells: Floats) -> Floats:
    """Take the mean stroke and its linear trend out."""
    number = np.linspace(-1.0, 1.0, len(cells))[:, None]
    left = cells - cells.mean(axis=0)
    return left - number * (number * left).sum(axis=0) / float((number**2).sum())


def _without_lines(left: Floats, at_s: Floats, lines: Sequence[Peak]) -> Floats:
    """Take out lines at fixed frequencies: a strike is to be far off what is no line."""
    if not lines:
        return left
    phase = TWO_PI * np.outer(at_s, [line.place for line in lines])
    waves = np.hstack([np.cos(phase), np.sin(phase)])
    return left - (waves @ np.linalg.lstsq(waves, left.ravel())[0]).reshape(left.shape)


def off_stroke_findings(trials: Sequence[OffStroke]) -> list[Finding]:
    """Weigh what the trials have in common.

    Parameters
    ----------
    trials : sequence of OffStroke

    Returns
    -------
    list of Finding
        Those that hold in most of the trials.
    """
    return [*_common_lines(trials), *_common_bursts(trials)]


def _common_lines(trials: Sequence[OffStroke]) -> Iterator[Finding]:
    idle, loaded = [t for t in trials if t.is_idle], [t for t in trials if not t.is_idle]
    locks: tuple[Lock, ...] = ("stroke", "time")
    for lock in locks:
        for name in sorted({name for t in trials for _, name in t.peaks}):
            for group in (trials, idle, loaded):
                line = common_line(group, lock, name)
                if line and _is_not_the_wood(line, lock) and _is_no_pickup(group, lock, name, line):
                    yield _line_finding(group, lock, name, line)
                    break


def common_line(group: Sequence[OffStroke], lock: Lock, name: str) -> list[tuple[OffStroke, Peak]]:
    """Peaks of one channel at the same place in most trials of a group, with their trials; else none."""
    best: list[tuple[OffStroke, Peak]] = []
    for candidate in (p for t in group for p in t.peaks.get((lock, name), ()) if p.power > _NUMBERS.least_power):
        same = _at(group, lock, name, candidate)
        if sum(np.log(p.power) for _, p in same) > sum(np.log(p.power) for _, p in best):
            best = same
    is_rare = not best or len(best) < _enough(group, lock, max((p for _, p in best), key=lambda p: p.power))
    return [] if is_rare or np.median([p.share for _, p in best]) < _NUMBERS.least_share else best


def _enough(group: Sequence[OffStroke], lock: Lock, line: Peak) -> float:
    """Most of the trials in which the line does not fall on a harmonic of the stroke."""
    orders = [line.place / t.rate_hz if lock == "time" else line.place for t in group]
    open_to_it = sum(abs(x - round(x)) > 1.5 * t.near_harmonic for x, t in zip(orders, group, strict=True))
    return max(_NUMBERS.in_most * open_to_it, SETTINGS.noise.least_trials)


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
    """In air there is none; under load, a wave of the wood has one length on the feed path in most trials.

    It stands alone or beside a harmonic of the stroke, and is no shorter than the finest grain.
    """
    if any(trial.is_idle for trial, _ in line):
        return True
    fed = [(trial, peak) for trial, peak in line if np.isfinite(trial.feed_a_stroke_m)]
    if len(fed) < SETTINGS.noise.least_trials:
        return False
    strokes_a_unit = np.array([1.0 / trial.rate_hz if lock == "time" else 1.0 for trial, _ in fed])
    cycles = strokes_a_unit * [peak.place for _, peak in fed]
    tolerances = strokes_a_unit * [_tolerance(peak, peak) for _, peak in fed]
    feeds_m = np.array([trial.feed_a_stroke_m for trial, _ in fed])
    for its_cycles in (cycles, np.abs(cycles - np.round(cycles))):
        waves_per_m = float(np.median(its_cycles / feeds_m))
        is_off = np.abs(its_cycles - waves_per_m * feeds_m) > _NUMBERS.moved * tolerances
        if waves_per_m <= _MOST_WAVES_PER_M and np.mean(is_off) <= 1.0 - _NUMBERS.in_most:
            return False
    return True


def _is_no_pickup(group: Sequence[OffStroke], lock: Lock, name: str, line: Sequence[tuple[OffStroke, Peak]]) -> bool:
    """A fixed frequency is hum of a sensor unless two currents or voltages show it; what follows the stroke is not.

    At the mains' frequency it is hum in however many channels: no battery has that. Where all trials run at nearly one
    speed, a fixed frequency stands at nearly one order of the stroke as well.
    """
    if is_mains(float(np.median([p.place if lock == "time" else p.place * trial.rate_hz for trial, p in line]))):
        return False
    if lock == "stroke":
        return True
    middle = max((p for _, p in line), key=lambda p: p.power)
    channels = {n for t in group for _, n in t.peaks}
    seen = [n for n in channels if len(_at(group, lock, n, middle)) >= _enough(group, lock, middle)]
    return name in seen and sum(n in _ELECTRICAL for n in seen) > 1


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


def _common_bursts(trials: Sequence[OffStroke]) -> Iterator[Finding]:
    """In air as well: a knot in the wood strikes too. Those of one sensor alone are its own (`foreign_bursts`)."""
    struck = {t.label: [n for n, found in t.struck.items() if found.share > _NUMBERS.least_struck] for t in trials}
    hit = [t for t in trials if struck[t.label]]
    idle, hit_idle = [t for t in trials if t.is_idle], [t for t in hit if t.is_idle]
    most = max(_NUMBERS.in_most * len(trials), SETTINGS.noise.least_trials)
    if not idle or len(hit_idle) < _NUMBERS.in_most * len(idle) or len(hit) < most:
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
            if _is_no_pickup(trials, "time", name, same):
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
        for mains_hz, amplitudes in zip(_MAINS_HZ, measured.transpose(1, 2, 0), strict=True):
            hidden += _hidden_lines(name, mains_hz, at_hz, amplitudes)
    return [*lines, *hidden]


def _hidden_lines(channel: str, mains_hz: float, at_hz: Sequence[float], amplitudes: Floats) -> Iterator[Line]:
    """Multiples of one mains beside those of a channel that are lines; `amplitudes`: (multiples, trials)."""
    lines = {n: hz for hz in at_hz if (n := _multiple_of(mains_hz, hz))}
    if not lines:
        return
    exact_hz = float(np.median([hz / n for n, hz in lines.items()]))
    for n, of_trials in zip(_MULTIPLES.tolist(), amplitudes, strict=True):
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
    return any(_multiple_of(mains_hz, frequency_hz, within_hz) for mains_hz in _MAINS_HZ)


def _multiple_of(mains_hz: float, frequency_hz: float, within_hz: float = 0.0) -> int:
    """Which multiple of the mains a frequency is; 0 where it is none."""
    n = round(frequency_hz / mains_hz)
    nearest_hz = n * mains_hz
    is_near = abs(frequency_hz - nearest_hz) < max(SETTINGS.report.mains_tolerance * nearest_hz, within_hz)
    return n if n in _MULTIPLES and is_near else 0
