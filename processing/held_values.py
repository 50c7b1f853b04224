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
# The instrument's rate is about one over the median time between updates, which is a number of rows.
_RATES = (0.7, 1.4)
# Cells of a median time in which updates are counted, and how often longer than the channel the counts are.
_CELLS, _PADDED = 8, 2
# Updates that show in the first row after a time of the instrument's agree in phase by 0.5 at the least (5 rows for 3
# periods); in 20 that come by chance one rate of a thousand does by 0.45. Most updates come a single period apart.
_LEAST_AGREED = 0.45
_LEAST_POWER = 12.0
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
    found = _periodic(at_s)
    if found is None:
        return time_s, values
    period_s, shown_s = found
    singles = np.round(np.diff(at_s) / period_s) == 1.0
    if period_s < _LEAST_ROWS * row_s or np.mean(singles) < _SINGLE_SHARE:
        return time_s, values
    # In the middle of its period a value surely stands in the table; where an update does not change it, it is one too.
    middle_s = shown_s + 0.5 * (period_s - row_s)
    first, last = (np.round((end - middle_s) / period_s) for end in (time_s[0], time_s[-1]))
    middle_s = middle_s + period_s * np.arange(first, last + 1.0)
    rows = np.clip(np.searchsorted(time_s, middle_s), 1, len(time_s) - 1)
    rows -= middle_s - time_s[rows - 1] < time_s[rows] - middle_s
    is_there = np.abs(time_s[rows] - middle_s) < 0.5 * period_s
    # An update shows half a row late on average.
    return middle_s[is_there] - 0.5 * period_s, values[rows[is_there]]


def _periodic(at_s: Floats) -> tuple[float, float] | None:
    """Period of times that come about as often as their median difference says, and where the first one should be.

    By the phases in which they agree: single ones may be missing, or late by a row. None where they do not agree.
    """
    usual_s = float(np.median(np.diff(at_s)))
    since_s = at_s - at_s[0]
    counts = np.bincount((since_s * (_CELLS / usual_s)).astype(np.int64))
    power = np.abs(np.fft.rfft(counts, _PADDED * len(counts))) ** 2 / len(at_s)
    rates = np.arange(len(power)) * _CELLS / (_PADDED * len(counts) * usual_s)
    likely = (rates > _RATES[0] / usual_s) & (rates < _RATES[1] / usual_s)
    rate_hz = float(rates[likely][np.argmax(power[likely])]) if likely.any() else 1.0 / usual_s
    for _ in range(2):
        phase = np.exp(2j * np.pi * rate_hz * since_s)
        agreed = complex(phase.mean())
        off = np.angle(phase * np.conj(agreed)) / (2.0 * np.pi)
        rate_hz -= float(np.polyfit(since_s, off, 1)[0])
    phase = np.exp(2j * np.pi * rate_hz * since_s)
    agreed = complex(phase.mean())
    if abs(agreed) < _LEAST_AGREED or abs(agreed) ** 2 * len(at_s) < _LEAST_POWER:
        return None
    return 1.0 / rate_hz, float(at_s[0] + np.angle(agreed) / (2.0 * np.pi * rate_hz))


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
