"""A slow wave of a channel while the blade returns: a carriage that sticks and slips, for example.

Strokes of a cut differ by the wood, which no one return stroke meets: there, and in air, a load cell reads the same
from stroke to stroke but for its noise and a zero that walks. A wave at one frequency beyond both is of the machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.state import TWO_PI

FREQUENCIES_HZ: Final = np.geomspace(0.05, 25.0, 625)
# A wave that is seen once or twice is a walk; one with two strokes a period changes with every other stroke.
_FEWEST_PERIODS, _HIGHEST_ORDER = 3.0, 0.45
# Of the walk in a stroke, in variances of the noise.
_WALKS: Final = (0.0, 0.01, 0.1, 1.0, 10.0)
_FEWEST_STROKES, _MOST_STROKES = 12, 128
# Below the step of any sensor, in any unit: what rounding leaves of a reading that stands still.
_STANDS_STILL = 1e-9


@dataclass(frozen=True, kw_only=True, slots=True)
class SlowWave:
    """How well a wave at each of `FREQUENCIES_HZ` describes what one trial has beside noise and walk.

    Attributes
    ----------
    log_gain : ndarray, shape (n_frequencies,)
        Of the likelihood, less what its two amplitudes cost, nats; NaN where too few periods or strokes tell.
    amplitude : ndarray, shape (n_frequencies,)
        In the unit of the channel.
    """

    log_gain: Floats
    amplitude: Floats


def slow_wave(at_s: Floats, left: Floats) -> SlowWave | None:
    """Look for a slow wave in that half of the turn in which strokes differ least.

    Parameters
    ----------
    at_s : ndarray, shape (n_strokes, n_cells)
        Times of the cells.
    left : ndarray, shape (n_strokes, n_cells)
        What they have beside the mean stroke.

    Returns
    -------
    SlowWave or None
        None where there are too few strokes, or the reading stands still.
    """
    n_strokes, n_cells = min(len(left), _MOST_STROKES), left.shape[1]
    if n_strokes < _FEWEST_STROKES:
        return None
    # Tapered, so that hum stays out, and is no slow wave where a whole number of its periods is nearly a stroke.
    taper = np.hanning(n_cells // 2 + 2)[1:-1]
    taper /= taper.sum()
    halves = [(at_s[:n_strokes, half] @ taper, left[:n_strokes, half] @ taper) for half in _halves(n_cells)]
    time_s, value = min(halves, key=lambda half: float(half[1].var()))
    if float(np.abs(value).max()) < _STANDS_STILL:
        return None
    time_s = time_s - time_s.mean()
    lasts_s = float(np.ptp(time_s))
    within = (lasts_s * FREQUENCIES_HZ > _FEWEST_PERIODS) & (
        FREQUENCIES_HZ * lasts_s < _HIGHEST_ORDER * (n_strokes - 1)
    )
    log_gain, amplitude = np.full((2, len(FREQUENCIES_HZ)), np.nan)
    log_gain[within], amplitude[within] = _gains(time_s, value, FREQUENCIES_HZ[within])
    return SlowWave(log_gain=log_gain, amplitude=amplitude)


def _halves(n_cells: int) -> tuple[slice, slice]:
    return slice(0, n_cells // 2), slice(n_cells // 2, n_cells // 2 * 2)


def _gains(time_s: Floats, value: Floats, at_hz: Floats) -> tuple[Floats, Floats]:
    """Log gain and amplitude of a wave at each frequency, beside a line, white noise and a walk of whatever sizes."""
    n = len(value)
    phase = TWO_PI * np.outer(time_s, at_hz)
    columns = np.column_stack([np.ones(n), time_s, value, np.cos(phase), np.sin(phase)])
    apart = np.minimum(time_s[:, None], time_s) - time_s[0]
    # Of the walk and of its own white noise alike, these combinations of strokes are independent.
    walked, independent = np.linalg.eigh((n - 1) / float(np.ptp(time_s)) * apart)
    columns = independent.T @ columns
    without, beside, amplitudes = [], [], []
    for walk in _WALKS:
        std = np.sqrt(1.0 + walk * walked)
        white = columns / std[:, None]
        line, _ = np.linalg.qr(white[:, :2])
        left = white[:, 2:] - line @ (line.T @ white[:, 2:])
        wanted, cosine, sine = left[:, 0], left[:, 1 : 1 + len(at_hz)], left[:, 1 + len(at_hz) :]
        cc, ss, cs = (cosine**2).sum(axis=0), (sine**2).sum(axis=0), (cosine * sine).sum(axis=0)
        cy, sy = cosine.T @ wanted, sine.T @ wanted
        by_cosine, by_sine = (ss * cy - cs * sy) / (cc * ss - cs**2), (cc * sy - cs * cy) / (cc * ss - cs**2)
        squares, log_stds = float(wanted @ wanted), float(np.log(std).sum())
        without.append(-log_stds - 0.5 * n * np.log(squares))
        beside.append(-log_stds - 0.5 * n * np.log(squares - by_cosine * cy - by_sine * sy))
        amplitudes.append(np.hypot(by_cosine, by_sine))
    best = np.argmax(beside, axis=0)
    every = np.arange(len(at_hz))
    return np.array(beside)[best, every] - max(without) - np.log(n), np.array(amplitudes)[best, every]
