"""What each trial holds beside its strokes: lines between the harmonics, slow waves, and strikes.

All else in the diagnosis is averaged over strokes, and what is not locked to them is lost there as scatter. What
trials have in common of it is weighed in `asynchronous`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from sawbench.bench.processed import TrackedTrial
from sawbench.bench.recording import Floats, Signal
from sawbench.bench.units import CHANNEL_BY_NAME, DISPLACEMENT, FORCE, MOTOR_CURRENT
from sawbench.diagnosis.inference.peaks import Peak, Spectrum, near_harmonic, not_sharper_in, peaks_of
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.slow_wave import SlowWave, slow_wave
from sawbench.diagnosis.inference.strikes import Answer, Strikes, answer_of, resolution_of, strikes
from sawbench.diagnosis.inference.stroke_cells import (
    beside_mean_stroke,
    filled,
    is_read,
    without_lines,
    without_strokes,
)
from sawbench.modeling.state import TWO_PI

# Cycles a stroke up to which lines are looked for: a commutator has about a hundred.
_HIGHEST_ORDER = 128
MAINS_HZ, MULTIPLES = (50.0, 60.0), np.arange(1, 8)
_NUMBERS: Final = SETTINGS.off_stroke


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
    duty : float
        NaN where none is stated.
    level : dict of str to float
        Mean of each channel, without its sign.
    peaks : dict of (str, str) to tuple of Peak
        By "time" or "stroke", and channel.
    of_mains : dict of str to ndarray, shape (2, 7)
        Of each channel, amplitude of all that stands at each multiple of either mains; NaN where that is a harmonic.
    struck : dict of str to Strikes
        Of each channel: rare strokes of a cell far off all others.
    answer : Answer
        Of the motor's current to the strikes of the force.
    slow : SlowWave, optional
        Of the force while the blade returns; None where the trial is too short.
    """

    label: str
    is_idle: bool
    rate_hz: float
    near_harmonic: float
    feed_a_stroke_m: float
    duty: float
    level: dict[str, float]
    peaks: dict[tuple[str, str], tuple[Peak, ...]]
    of_mains: dict[str, Floats]
    struck: dict[str, Strikes]
    answer: Answer
    slow: SlowWave | None = None


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
    slow: SlowWave | None = None
    begins_s, ends_s = np.interp(TWO_PI * np.array([first, last]), angle.angle_rad, angle.time_s)
    rate_hz = n_strokes / float(ends_s - begins_s)
    channels = {name: s for name, s in trial.channels.items() if name in CHANNEL_BY_NAME and len(s.values) > 1}
    turned_rad = {name: np.interp(s.time_s, angle.time_s, angle.angle_rad) for name, s in channels.items()}
    found = {name: beside_mean_stroke(turned_rad[name], s.values, first, n_strokes) for name, s in channels.items()}
    beside = {name: one for name, one in found.items() if one is not None}
    angle_is_read = is_read(beside[DISPLACEMENT.name][1] if DISPLACEMENT.name in beside else None, n_strokes)
    for name, (samples, cells) in beside.items():
        left = without_strokes(filled(cells))
        at = first + (np.arange(left.size) + 0.5) / left.shape[1]
        at_s = np.interp(TWO_PI * at, angle.angle_rad, angle.time_s)
        time_s = channels[name].time_s
        sample_hz = 1.0 / float(np.median(np.diff(time_s)))
        turns, highest_hz = turned_rad[name] / TWO_PI - first, min(_HIGHEST_ORDER * rate_hz, 0.5 * sample_hz)
        over_strokes = Spectrum.of(turns, samples, n_strokes, sample_hz / rate_hz, _HIGHEST_ORDER)
        over_time = Spectrum.of(time_s - begins_s, samples, ends_s - begins_s, sample_hz, highest_hz)
        by_stroke, by_time = peaks_of(over_strokes, 1.0), peaks_of(over_time, rate_hz)
        peaks["stroke", name] = not_sharper_in(by_time, by_stroke, rate_hz)
        peaks["time", name] = not_sharper_in(by_stroke, by_time, 1.0 / rate_hz)
        of_mains[name] = np.array([over_time.amplitudes_at(hz * MULTIPLES, rate_hz) for hz in MAINS_HZ])
        resolution[name] = resolution_of(channels[name].values)
        if name == FORCE.name:
            slow = slow_wave(at_s.reshape(left.shape), without_lines(left, at_s, by_time))
        # Where samples are missing, of the channel or of the angle, what stands in a stroke was not measured.
        lefts[name] = (angle_is_read & is_read(cells, n_strokes))[:, None] * without_lines(
            left, at_s, peaks["time", name]
        )
        struck[name] = strikes(lefts[name], resolution[name], rate_hz)
    if not peaks:
        return None
    return OffStroke(
        label=trial.trial.trial_id,
        is_idle=trial.trial.is_idle,
        rate_hz=rate_hz,
        near_harmonic=near_harmonic(n_strokes),
        feed_a_stroke_m=_feed_m_s(trial) / rate_hz,
        duty=float("nan") if trial.trial.duty is None else trial.trial.duty,
        level={name: _level(channels[name], begins_s, ends_s) for name in beside},
        peaks=peaks,
        of_mains=of_mains,
        struck=struck,
        answer=answer_of(lefts.get(FORCE.name), lefts.get(MOTOR_CURRENT.name), resolution.get(FORCE.name, np.inf)),
        slow=slow,
    )


def _level(signal: Signal, begins_s: float, ends_s: float) -> float:
    inside = (signal.time_s >= begins_s) & (signal.time_s <= ends_s)
    return abs(float(np.nanmean(signal.values[inside])))


def _feed_m_s(trial: TrackedTrial) -> float:
    """NaN in air and where none is stated."""
    feed_mm_s = None if trial.trial.is_idle else trial.trial.feed_mm_s
    return float("nan") if feed_mm_s is None else 1e-3 * feed_mm_s
