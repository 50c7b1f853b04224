"""Samples of a slow instrument that a table repeats until the next one: only their first appearance is a measurement.

A table with one time axis writes a 500 Hz channel into rows of 4 kHz by holding each value for eight rows. Taken as
samples, the held values are late by half a period of the slow channel on average, as if its clock were.
"""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Alignment, Floats

_LEAST_UPDATES = 20
_LEAST_EQUAL = 0.4
_LEAST_ROWS = 2
# Nearly all updates come at multiples of one period, and most of them at the period itself.
_REGULAR_SHARE = 0.98
_SINGLE_SHARE = 0.5


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
    gap = np.diff(updates)
    if np.median(gap) < _LEAST_ROWS:
        return time_s, values
    periods = np.maximum(np.round(gap / np.median(gap)), 1.0)
    period = float(gap.sum() / periods.sum())
    is_regular = np.abs(gap - periods * period) <= min(1.0, period / 4.0)
    if is_regular.mean() < _REGULAR_SHARE or np.mean(periods == 1.0) < _SINGLE_SHARE:
        return time_s, values
    # A value that an update does not change is a sample too: every period has one.
    first = updates[0] - period * np.arange(updates[0] // period, 0, -1)
    inside = [a + (b - a) / n * np.arange(n) for a, b, n in zip(updates[:-1], updates[1:], periods, strict=True)]
    last = np.arange(updates[-1], len(values), period)
    rows = np.round(np.concatenate([first, *inside, last])).astype(int)
    rows = rows[rows < len(values)]
    return 0.5 * (time_s[rows] + time_s[np.maximum(rows - 1, 0)]), values[rows]


def alignment_of_rows(time_s: Floats) -> Alignment:
    """How well the times of values are known that came at any time between two rows.

    Rows that run with the instrument are late alike in all trials; others are late by another part of a row in each.
    """
    row_s = float(np.median(np.diff(time_s)))
    return Alignment(std_s=row_s / np.sqrt(12.0), latency_s=row_s)
