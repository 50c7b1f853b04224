"""Samples of a slow instrument between which a table draws straight lines: only its corners are measurements.

A table with one time axis may write a 200 Hz channel into rows of 4 kHz by linear interpolation. Taken as samples, its
rows are a low-pass without a delay: what changes within a stroke is lost by a share that no sensor has.
"""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.processing.held_values import clock_of, without_repeats

# Rounding bends a line of three values by up to twice the last digit; rows that come off their times by a share of a
# row bend it by about as much of what a row changes.
_ROUNDED, _JITTER = 2.5, 0.15
_LEAST_STRAIGHT = 0.4
# A corner between two rows bends the line at both, and at the next one where a sample came early or late.
_MOST_BENT = 3
_LEAST_ROWS = 3.0
# Rows that are further apart than this many usual ones have a hole between them.
_HOLE_ROWS = 1.5
# Of the channel's standard deviation: what lines between the corners may miss the rows by.
_MISSED = 0.05
# Lines with their corners half a period later miss them by more, at least by this factor: a smooth signal is nearly
# straight between any corners.
_OTHERWISE = 2.0
# Where a row changes the value by less than its last digit, every fourth one may show the corners, or every sixteenth.
_EVERY = (1, 4, 16, 64)
_MOST_DIGITS = 9
# At no regular distance, so that digits which only every tenth row shows are seen.
_LOOKED_AT, _GOLDEN = 1000, 0.5 * (np.sqrt(5.0) - 1.0)


def own_samples(time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Keep the samples of the instrument, where a table holds its last one or interpolates between them.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)

    Returns
    -------
    time_s, values : ndarray, shape (m,)
        The same arrays where every row is a sample.
    """
    own_s, own = without_repeats(time_s, values)
    return (own_s, own) if len(own) < len(values) else without_interpolated_rows(time_s, values)


def without_interpolated_rows(time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Keep the samples that a table has interpolated between.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)

    Returns
    -------
    time_s, values : ndarray, shape (m,)
        The same arrays where the rows are not straight between corners that come with one clock.

    Examples
    --------
    >>> t, at = np.arange(800) / 4000, np.arange(102) / 500 - 0.0007
    >>> own_s, own = without_interpolated_rows(t, np.interp(t, at, np.sin(90 * at)))
    >>> len(own), bool(np.allclose(own, np.sin(90 * own_s), atol=1e-3))
    (100, True)
    """
    if len(values) < 3:
        return time_s, values
    digit = last_digit(values)
    for every in _EVERY:
        some_s, some = time_s[::every], values[::every]
        clock = _clock_of_corners(some_s, some, digit) if len(some) > 3 else None
        if clock is not None:
            at_s, period_s = clock
            own_s, own, missed = _lines(time_s, values, some_s, some, at_s, period_s)
            other = _lines(time_s, values, some_s, some, at_s + 0.5 * period_s, period_s)[2]
            if missed < min(_MISSED * float(np.std(values)), other / _OTHERWISE):
                return own_s, own
    return time_s, values


def _clock_of_corners(time_s: Floats, values: Floats, digit: float) -> tuple[float, float] | None:
    """Time and period of the clock that the corners keep; None where most rows are bent, or bent at any time."""
    change = np.diff(values)
    rows_s = np.diff(time_s)
    expected = change[:-1] * rows_s[1:] / rows_s[:-1]
    is_bent = np.abs(change[1:] - expected) > _ROUNDED * digit + _JITTER * np.abs(expected)
    if not 0.0 < np.mean(is_bent) < 1.0 - _LEAST_STRAIGHT:
        return None
    ends = np.diff(is_bent.astype(np.int8), prepend=0, append=0)
    first, last = np.flatnonzero(ends > 0) + 1, np.flatnonzero(ends < 0)
    is_corner = last - first < _MOST_BENT
    # One row alone is bent where the sample is in it, or beside it by less than the rounding shows.
    is_single = last == first
    before, at = (first - is_single)[is_corner], (last + is_single)[is_corner]
    clock = clock_of(time_s[before], time_s[at]) if np.mean(is_corner) > _LEAST_STRAIGHT else None
    return None if clock is None or clock[1] < _LEAST_ROWS * np.median(rows_s) else clock


def _lines(
    time_s: Floats, values: Floats, some_s: Floats, some: Floats, at_s: float, period_s: float
) -> tuple[Floats, Floats, float]:  # fmt: skip
    """Corners that some rows show at the times of a clock, and what lines between them miss all rows by."""
    first, last = (some_s[1] - at_s) / period_s, (some_s[-2] - at_s) / period_s
    own_s, own = _corners(some_s, some, at_s + period_s * np.arange(np.ceil(first), np.floor(last) + 1.0))
    within = slice(*np.searchsorted(time_s, own_s[[0, -1]]))
    return own_s, own, float(np.std(values[within] - np.interp(time_s[within], own_s, own)))


def _corners(time_s: Floats, values: Floats, at_s: Floats) -> tuple[Floats, Floats]:
    """Times between two rows, and where the lines before and after each meet: the mean of both; none in a hole."""
    rows_s = np.diff(time_s)
    slope = np.diff(values) / rows_s
    row = np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 1, len(time_s) - 3)
    is_there = rows_s[row] < _HOLE_ROWS * np.median(rows_s)
    at_s, row = at_s[is_there], row[is_there]
    before = values[row] + slope[row - 1] * (at_s - time_s[row])
    after = values[row + 1] - slope[row + 1] * (time_s[row + 1] - at_s)
    return at_s, np.asarray(0.5 * (before + after), dtype=np.float64)


def last_digit(values: Floats) -> float:
    """What all values are multiples of: a power of ten, or the larger step of a converter, which need not be one.

    0 where they have more digits than a table writes.
    """
    some = values[(len(values) * (np.arange(_LOOKED_AT) * _GOLDEN % 1.0)).astype(np.int64)]
    steps = np.diff(np.unique(some))
    for digits in range(_MOST_DIGITS + 1):
        whole = some * 10.0**digits
        if np.all(np.abs(whole - np.round(whole)) < 1e-4 * np.maximum(1.0, np.abs(whole) * 1e-8)):
            return float(max(10.0**-digits, min(steps, default=0.0)))
    return 0.0
