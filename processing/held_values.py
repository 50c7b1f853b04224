"""Samples of a slow instrument that a table repeats until the next one: only their first appearance is a measurement.

A table with one time axis writes a 500 Hz channel into rows of 4 kHz by holding each value for eight rows. Taken as
samples, the held values are late by half a period of the slow channel on average, as if its clock were.
"""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Alignment, Floats

_LEAST_UPDATES = 20
_LEAST_EQUAL = 0.4
# Fewer rows a period are no repeats: 5 of 3 is the least that a share of 0.4 leaves.
_LEAST_ROWS = 1.5
# An update shows up to a row late; one more for rows that are missing or jitter, but no more than tells periods apart.
_LATE_ROWS, _LATE_SHARE = 1.5, 0.3
# Nearly all updates come at multiples of one period, and most of them at the period itself.
_REGULAR_SHARE = 0.98
_SINGLE_SHARE = 0.5

# What is less late than that is not late: amplifiers and filters of every bench are.
_ORDINARY_S = 1e-4


def without_repeats(time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Keep one sample of each period in which a value was held.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)

    Returns
    -------
    time_s, values : ndarray, shape (m,)
        The same arrays where values are not held for a regular number of rows. An update came between its row and the
        one before: its time is put in the middle, with the uncertainty of `alignment_of_rows`.

    Examples
    --------
    >>> t = np.arange(400) / 4000
    >>> late, held = without_repeats(t, np.repeat(np.sin(np.arange(50)), 8))
    >>> len(held), late[:3].tolist()
    (50, [0.0, 0.001875, 0.003875])
    """
    updates = np.flatnonzero(np.diff(values) != 0.0) + 1
    if len(updates) < _LEAST_UPDATES or len(updates) > (1.0 - _LEAST_EQUAL) * len(values):
        return time_s, values
    row_s, at_s = float(np.median(np.diff(time_s))), time_s[updates]
    gap_s = np.diff(at_s)
    periods = np.maximum(np.round(gap_s / np.median(gap_s)), 1.0)
    period_s = float(gap_s.sum() / periods.sum())
    if period_s < _LEAST_ROWS * row_s:
        return time_s, values
    is_regular = np.abs(gap_s - periods * period_s) <= min(_LATE_ROWS * row_s, _LATE_SHARE * period_s)
    if is_regular.mean() < _REGULAR_SHARE or np.mean(periods == 1.0) < _SINGLE_SHARE:
        return time_s, values
    # A value that an update does not change is a sample too: every period has one.
    first = at_s[0] - period_s * np.arange((at_s[0] - time_s[0]) // period_s, 0.0, -1.0)
    inside = [a + (b - a) / n * np.arange(n) for a, b, n in zip(at_s[:-1], at_s[1:], periods, strict=True)]
    last = np.arange(at_s[-1], time_s[-1], period_s)
    rows = np.unique(np.searchsorted(time_s, np.concatenate([first, *inside, last]) - 0.5 * row_s))
    return 0.5 * (time_s[rows] + time_s[np.maximum(rows - 1, 0)]), values[rows]


def alignment_of_rows(time_s: Floats, kept_s: Floats | None = None) -> Alignment:
    """How well the times of a table's channel are known where nothing states it, no better than instruments are.

    To a row in each trial: rows that do not run with the instrument see its values late by another part of a row every
    time. And to as long as a value is held in all trials alike: a table may hold it from its time on, or around it.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Of the rows.
    kept_s : ndarray, shape (m,), optional
        Of the values that are left without repeats.
    """
    row_s = float(np.median(np.diff(time_s)))
    held_s = row_s if kept_s is None else float(np.median(np.diff(kept_s)))
    return Alignment(
        std_s=max(row_s / np.sqrt(12.0), _ORDINARY_S), latency_s=max(held_s, np.sqrt(12.0) * _ORDINARY_S)
    )
