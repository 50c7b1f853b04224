"""Lay every stroke over one turn of the crank: mean, spread and count per bin.

Each bin takes one value from each cycle, interpolated between neighbouring samples. Where there are over 400 samples
a stroke and 128 bins, linearly: every eighth bin centre is found on the time axis, a parabola leads through those
between, they serve every channel sampled at those times, and the sums stay in the first-level cache. Else through four
points, every bin centre found (the error of the first harmonic is then below 1e-4 down to 30 samples a stroke).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import floor

import numpy as np
from numba import njit
from numpy.typing import NDArray
from sawbench.bench.folded import FoldedCycle
from sawbench.bench.recording import Floats

_LINEAR_FROM_SAMPLES = 400
_LINEAR_FROM_BINS = 128  # with fewer, a parabola over eight of them does not follow the speed within a stroke
_CHANNELS_AT_ONCE = 2  # more evict each other from the first-level cache
_CYCLES_AT_ONCE = 2048  # of few samples each: keeps the memory small
_STRIDE = 8  # bins from one exact position to the next; a parabola leads through those between


@dataclass(frozen=True, kw_only=True, slots=True)
class Cycles:
    """Complete strokes without gaps.

    Attributes
    ----------
    index : ndarray of int, shape (m,)
        Turn number of each cycle: it lasts from angle 2 pi index to 2 pi (index + 1).
    start_s, end_s : ndarray, shape (m,), s
    """

    index: NDArray[np.int64]
    start_s: Floats
    end_s: Floats

    @property
    def period_s(self) -> Floats:
        """Duration of each cycle, s."""
        return self.end_s - self.start_s


def find_cycles(time_s: Floats, angle_rad: Floats, windows: Sequence[tuple[float, float]]) -> Cycles:
    """Complete turns of the crank inside the windows, from smallest displacement to smallest displacement.

    Parameters
    ----------
    time_s, angle_rad : ndarray, shape (n,)
        Never decreasing angle.
    windows : sequence of (start_s, end_s)
        Running, without gaps.

    Examples
    --------
    >>> t = np.linspace(0, 1, 1001)
    >>> find_cycles(t, 2 * np.pi * 5 * t, [(0.1, 0.5), (0.51, 1.0)]).index.tolist()
    [1, 3, 4]
    """
    first, last = np.ceil(angle_rad[0] / (2 * np.pi) - 1e-9), np.floor(angle_rad[-1] / (2 * np.pi) + 1e-9)
    turns = np.arange(int(first), int(last) + 1)
    if len(turns) < 2:
        return Cycles(index=np.empty(0, np.int64), start_s=np.empty(0), end_s=np.empty(0))
    rising = angle_rad + 1e-12 * np.arange(len(angle_rad))
    crossing = np.interp(2 * np.pi * turns, rising, time_s)
    start, end = crossing[:-1], crossing[1:]
    slack = 1e-9
    is_inside = np.zeros(len(start), dtype=bool)
    for low, high in windows:
        is_inside |= (start >= low - slack) & (end <= high + slack)
    return Cycles(index=turns[:-1][is_inside], start_s=start[is_inside], end_s=end[is_inside])


@njit(cache=True, nogil=True, error_model="numpy")
def _find(axis, goal, guess):
    """Index and part of a sample at which the increasing `axis` takes `goal`; `guess` is an index near it.

    A step of Newton's nearly always lands on the index, so that the loops after it seldom mislead the processor.
    """
    last = len(axis) - 2
    k = min(max(guess, 0), last)
    rise = axis[k + 1] - axis[k]
    if rise > 0.0:
        k = min(max(k + int(min(max(floor((goal - axis[k]) / rise), -64.0), 64.0)), 0), last)
    steps = 0
    while axis[k] > goal and k > 0 and steps < 64:
        k -= 1
        steps += 1
    while axis[k + 1] <= goal and k < last and steps < 64:
        k += 1
        steps += 1
    if steps == 64:
        low, high = 0, last
        while low < high:
            middle = (low + high + 1) // 2
            low, high = (middle, high) if axis[middle] <= goal else (low, middle - 1)
        k = low
    rise = axis[k + 1] - axis[k]
    part = (goal - axis[k]) / rise if rise > 0.0 else 0.0
    return k, min(max(part, 0.0), 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _locate(angle, turns_rad, within_rad, out):
    """Fractional indices in `angle` of `turns_rad` + `within_rad`, shape of `out`.

    Each search starts as many samples further as the one before went.
    """
    k = stride = 0
    for row in range(len(turns_rad)):
        for column in range(len(within_rad)):
            before = k
            k, part = _find(angle, turns_rad[row] + within_rad[column], k + stride)
            stride = k - before
            out[row, column] = k + part


@njit(cache=True, nogil=True, error_model="numpy")
def _locate_in_time(angle_time, angle, time, turns_rad, within_rad, out):
    """As `_locate`, fractional indices in `time`, where the angle is given at times of its own."""
    j = k = stride = 0
    for row in range(len(turns_rad)):
        for column in range(len(within_rad)):
            j, part = _find(angle, turns_rad[row] + within_rad[column], j)
            before = k
            k, part = _find(time, angle_time[j] + part * (angle_time[j + 1] - angle_time[j]), k + stride)
            stride = k - before
            out[row, column] = k + part


@njit(cache=True, nogil=True)
def _spread(knots, last, index, part):
    """Positions of all bins from those of every `_STRIDE`-th: a parabola from knot to knot."""
    n = len(knots)
    for j in range(n - 1):
        step = (knots[j + 1] - knots[j]) / _STRIDE
        left = knots[j - 1] - 2.0 * knots[j] + knots[j + 1] if j > 0 else 0.0
        right = knots[j] - 2.0 * knots[j + 1] + knots[j + 2] if j < n - 2 else left
        bend = 0.25 * ((left if j > 0 else right) + right) / _STRIDE**2
        for i in range(min(_STRIDE, len(index) - j * _STRIDE)):
            position = min(knots[j] + i * (step - bend * (_STRIDE - i)), last)
            k = int(position)
            index[j * _STRIDE + i] = np.uint64(k)
            part[j * _STRIDE + i] = position - k


def _knots(angle_time_s: Floats, angle_rad: Floats, time_s: Floats, turns: NDArray[np.int64], n_bins: int) -> Floats:
    """Fractional sample positions of every `_STRIDE`-th bin centre of every turn, shape (turns, knots)."""
    n_knots = -(-n_bins // _STRIDE) + 1
    within = (0.5 + _STRIDE * np.arange(n_knots)) / n_bins
    knots = np.empty((len(turns), n_knots))
    turns_rad, within_rad = 2.0 * np.pi * turns, 2.0 * np.pi * within
    if angle_time_s is time_s:
        _locate(angle_rad, turns_rad, within_rad, knots)
    else:
        _locate_in_time(angle_time_s, angle_rad, time_s, turns_rad, within_rad, knots)
    return knots


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _fold_linear(knots, values, centre, total, square):
    """Add up `values` (channels x samples) over the cycles of `knots`, about a `centre` per channel."""
    n_bins = total.shape[1]
    index, part = np.empty(n_bins, np.uint64), np.empty(n_bins)
    last, one = values.shape[1] - 1.000001, np.uint64(1)
    for row in range(len(knots)):
        _spread(knots[row], last, index, part)
        for c in range(len(values)):
            of, middle, sums, squares = values[c], centre[c], total[c], square[c]
            for b in range(n_bins):
                k = index[b]
                low = of[k]
                d = low + part[b] * (of[k + one] - low) - middle
                sums[b] += d
                squares[b] += d * d


def _fold_cubic(at: Floats, values: Floats, centre: Floats, total: Floats, square: Floats) -> None:
    """As `_fold_linear`, through four points, for few samples a stroke; `at` is the position of every bin centre."""
    for c in range(len(values)):
        d = _cubic(at, values[c]) - centre[c]
        total[c] += d.sum(axis=0)
        square[c] += (d * d).sum(axis=0)


def _cubic(at: Floats, values: Floats) -> Floats:
    """Value at fractional sample positions: the cubic through the four samples around each, shape of `at`."""
    k = np.clip(at.astype(np.int64), 1, max(len(values) - 3, 1))
    u = at - k
    a, b, c, d = (values[np.clip(k + i, 0, len(values) - 1)] for i in (-1, 0, 1, 2))
    slope = -a / 3.0 - 0.5 * b + c - d / 6.0
    return b + u * (slope + u * (0.5 * (a + c) - b + u * ((d - a) / 6.0 + 0.5 * (b - c))))


def _positions(
    angle_time_s: Floats, angle_rad: Floats, time_s: Floats, turns: NDArray[np.int64], at_rad: Floats
) -> Floats:
    """Fractional sample positions of angles within every turn, shape (turns, angles)."""
    goals = (2.0 * np.pi * turns[:, None] + at_rad).ravel()
    at = np.interp(np.interp(goals, angle_rad, angle_time_s), time_s, np.arange(len(time_s)))
    return at.reshape(len(turns), len(at_rad))


def fold_channels(
    angle_time_s: Floats,
    angle_rad: Floats,
    time_s: Floats,
    values: Floats,
    turns: NDArray[np.int64],
    *,
    n_bins: int = 256,
    n_threads: int = 1,
) -> tuple[Floats, Floats]:
    """Mean and standard deviation over the cycles, for channels sampled at the same times.

    Parameters
    ----------
    angle_time_s, angle_rad : ndarray, shape (n,)
        Crank angle, never decreasing. Pass the same object for `angle_time_s` and `time_s` where they are
        one.
    time_s : ndarray, shape (m,), s
    values : ndarray, shape (channels, m)
    turns : ndarray of int, shape (k,)
        Increasing turn numbers, as `Cycles.index`.
    n_bins, n_threads : int

    Returns
    -------
    mean, std : ndarray, shape (channels, n_bins)
        `std` is that of the cycles (divisor k - 1; 0 for one cycle), at bin centres (b + 1/2) 2 pi / n_bins.

    Examples
    --------
    >>> t = np.arange(0, 1, 1e-4)
    >>> angle = 2 * np.pi * 10 * t
    >>> mean, std = fold_channels(t, angle, t, np.cos(angle)[None], np.arange(9), n_bins=8)
    >>> bool(abs(mean[0, 0] - np.cos(np.pi / 8)) < 1e-5)
    True
    """
    n_cycles = len(turns)
    ends_rad = 2.0 * np.pi * np.array([turns[0], turns[-1] + 1])
    span = np.searchsorted(time_s, np.interp(ends_rad, angle_rad, angle_time_s))
    n_samples = (span[1] - span[0]) / max(int(turns[-1] - turns[0]) + 1, 1)
    is_linear = n_samples >= _LINEAR_FROM_SAMPLES and n_bins >= _LINEAR_FROM_BINS
    values = np.ascontiguousarray(values)
    centre = values[:, span[0] : max(span[1], span[0] + 1) : max((span[1] - span[0]) // 1000, 1)].mean(axis=1)

    def sums(chosen: NDArray[np.int64]) -> Floats:
        total, square = both = np.zeros((2, len(values), n_bins))
        if not is_linear:
            for few in np.array_split(chosen, -(-len(chosen) // _CYCLES_AT_ONCE)):
                at = _positions(angle_time_s, angle_rad, time_s, few, bin_centres(n_bins))
                _fold_cubic(at, values, centre, total, square)
            return both
        knots = _knots(angle_time_s, angle_rad, time_s, chosen, n_bins)
        for c in range(0, len(values), _CHANNELS_AT_ONCE):
            some = slice(c, c + _CHANNELS_AT_ONCE)
            _fold_linear(knots, values[some], centre[some], total[some], square[some])
        return both

    shares = np.array_split(turns, min(n_threads, n_cycles))
    if len(shares) == 1:
        total, square = sums(turns)
    else:
        with ThreadPoolExecutor(len(shares)) as pool:
            total, square = np.sum(list(pool.map(sums, shares)), axis=0)
    shift = total / n_cycles
    return centre[:, None] + shift, np.sqrt(np.maximum(square - n_cycles * shift**2, 0.0) / max(n_cycles - 1, 1))


def resample_cycles(
    angle_time_s: Floats,
    angle_rad: Floats,
    time_s: Floats,
    values: Floats,
    turns: NDArray[np.int64],
    at_rad: Floats,
) -> Floats:
    """One channel at given crank angles, cycle by cycle.

    Parameters
    ----------
    angle_time_s, angle_rad : ndarray, shape (n,)
    time_s, values : ndarray, shape (m,)
    turns : ndarray of int, shape (k,)
    at_rad : ndarray, shape (b,), rad
        0..2 pi.

    Returns
    -------
    ndarray, shape (k, b)
    """
    return _cubic(_positions(angle_time_s, angle_rad, time_s, turns, at_rad), values)


def bin_centres(n_bins: int) -> Floats:
    """Middles of the bins of a turn, rad, shape (n_bins,)."""
    return np.asarray((np.arange(n_bins) + 0.5) * (2 * np.pi / n_bins), dtype=np.float64)


def fold_signals(
    angle_time_s: Floats,
    angle_rad: Floats,
    signals: Mapping[str, tuple[str, Floats, Floats]],
    cycles: Mapping[str, Cycles],
    *,
    n_bins: int,
    n_threads: int = 1,
) -> dict[str, FoldedCycle]:
    """Fold channels of any rate; those with equal sample times and cycles share the index.

    Parameters
    ----------
    angle_time_s, angle_rad : ndarray, shape (n,)
    signals : mapping of channel to (unit, time_s, values)
    cycles : mapping of channel to Cycles
        Channels without a cycle are left out of the result.
    n_bins, n_threads : int
    """
    groups: list[list[str]] = []
    for name in signals:
        for group in groups:
            is_same = np.array_equal(signals[group[0]][1], signals[name][1])
            if is_same and np.array_equal(cycles[group[0]].index, cycles[name].index):
                group.append(name)
                break
        else:
            groups.append([name])
    folded = {}
    for group in groups:
        turns = cycles[group[0]].index
        if not len(turns):
            continue
        time = signals[group[0]][1]
        time = angle_time_s if np.array_equal(time, angle_time_s) else time
        stacked = np.stack([signals[name][2] for name in group])
        mean, std = fold_channels(angle_time_s, angle_rad, time, stacked, turns, n_bins=n_bins, n_threads=n_threads)
        for row, name in enumerate(group):
            folded[name] = FoldedCycle(
                channel=name,
                unit=signals[name][0],
                angle_rad=bin_centres(n_bins),
                mean=mean[row],
                std=std[row],
                count=np.full(n_bins, len(turns), dtype=np.int64),
                n_cycles=len(turns),
            )
    return folded
