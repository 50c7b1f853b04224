"""Samples of a slow instrument that a table repeats until the next one: only their first appearance is a measurement.

A table with one time axis writes a 500 Hz channel into rows of 4 kHz by holding each value for eight rows. Taken as
samples, the held values are late by half a period of the slow channel on average, as if its clock were.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.recording import Alignment, Floats

_LEAST_UPDATES = 20
_LEAST_EQUAL = 0.4
# An update changes a value by more than this many of the steps that most rows make, and of the smallest one of all.
_NOISE, _DIGITS = 5.0, 1.5
# Of what updates bring, in squares: what may be gone in the middle of the period.
_STAYS = 0.25
# Fewer rows a period are no repeats: 5 of 3 is the least that a share of 0.4 leaves.
_LEAST_ROWS = 1.5
# The instrument's rate is about one over the median time between updates, which is a number of rows.
_RATES = (0.7, 1.4)
# Cells of a median time in which updates are counted, and how often longer than the channel the counts are.
_CELLS, _PADDED = 8, 2
# Share of its period by which an instrument's updates may be off its clock: of messages of a bus a standard deviation
# of 2 %, on a busy one of 10 %. Coarse steps may have such a clock too, of the machine's.
QUIET_BUS, BUSY_BUS = 0.05, 0.2
# Of the updates that no chance explains, those that come between their row and the row before by one clock: of held
# channels nearly all, of coarse steps of any other few. Most are a single period apart.
_EXPLAINED = 0.8
_SINGLE_SHARE = 0.5
_PHASES = 256
# So many periods are looked at first, then this many times as many, until all are.
_FIRST_PERIODS, _LONGER = 20_000, 8
# Rates that are tried about the likeliest one, over the length looked at: 1 is one period more or less.
_TRIED = (np.linspace(-1.0, 1.0, 21), np.linspace(-0.1, 0.1, 21))
_MOST_TRIED = 1000

# What is less late than that is not late: amplifiers and filters of every bench are.
_ORDINARY_S = 1e-4


def without_repeats(time_s: Floats, values: Floats, jitter: float = QUIET_BUS) -> tuple[Floats, Floats]:
    """Keep one sample of each period in which a value was held.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
    jitter : float
        Share of the period by which the updates may be off their clock.

    Returns
    -------
    time_s, values : ndarray, shape (m,)
        The same arrays where no clock explains when the values change. An update came between its row and the one
        before; the clock is put in the middle of what all of them leave free.

    Examples
    --------
    >>> t = np.arange(400) / 4000
    >>> late, held = without_repeats(t, np.repeat(np.sin(np.arange(50)), 8))
    >>> len(held), late[:3].round(6).tolist()
    (50, [-0.000125, 0.001875, 0.003875])
    """
    if len(values) <= _LEAST_UPDATES:
        return time_s, values
    change = np.abs(np.diff(values))
    held = _held(time_s, values, np.flatnonzero(change) + 1, jitter)
    if held is None and change.any():
        # What is picked up behind the instrument, and rounded, changes a held value from row to row as well.
        noise = max(
            _NOISE * float(np.quantile(change, 1.0 - _LEAST_EQUAL)), _DIGITS * float(change[change > 0.0].min())
        )
        updates = np.flatnonzero(change > noise) + 1
        held = _held(time_s, values, updates, jitter)
        if held is not None and not _stays(held, time_s[updates], values[updates] - values[updates - 1]):
            held = None
    return (time_s, values) if held is None else held


def _held(
    time_s: Floats, values: Floats, updates: NDArray[np.int64], jitter: float
) -> tuple[Floats, Floats] | None:  # fmt: skip
    """One sample of each period, where one clock explains in which rows the value is another; None elsewhere."""
    if len(updates) < _LEAST_UPDATES or len(updates) > (1.0 - _LEAST_EQUAL) * len(values):
        return None
    clock = clock_of(time_s[updates - 1], time_s[updates], jitter)
    if clock is None or clock[1] < _LEAST_ROWS * float(np.median(np.diff(time_s))):
        return None
    # In the middle of its period a value surely stands in the table; where an update does not change it, it is one too.
    update_s, period_s = clock
    middle_s = update_s + 0.5 * period_s
    first, last = (np.round((end - middle_s) / period_s) for end in (time_s[0], time_s[-1]))
    middle_s = middle_s + period_s * np.arange(first, last + 1.0)
    rows = np.clip(np.searchsorted(time_s, middle_s), 1, len(time_s) - 1)
    rows -= middle_s - time_s[rows - 1] < time_s[rows] - middle_s
    is_there = np.abs(time_s[rows] - middle_s) < 0.5 * period_s
    return middle_s[is_there] - 0.5 * period_s, values[rows[is_there]]


def _stays(held: tuple[Floats, Floats], at_s: Floats, step: Floats) -> bool:
    """Whether a value stays at what its updates bring, as one that is held does and one with bursts does not."""
    own_s, own = held
    middle_s = 0.5 * (own_s[1:] + own_s[:-1])
    after = np.clip(np.searchsorted(middle_s, at_s), 1, len(own) - 1)
    missed = own[after] - own[after - 1] - step
    return float(missed @ missed) < _STAYS * float(step @ step)


def clock_of(before_s: Floats, at_s: Floats, jitter: float = QUIET_BUS) -> tuple[float, float] | None:
    """Time and period of the clock that an instrument's updates keep, each of which came between two times.

    Parameters
    ----------
    before_s, at_s : ndarray, shape (n,)
    jitter : float
        Share of the period by which they may be off it.

    Returns
    -------
    (float, float) or None
        One of its times and its period, s; None where no clock explains most of the updates.
    """
    if len(at_s) < _LEAST_UPDATES:
        return None
    explained, period_s = _likeliest_period(before_s, at_s, jitter)
    singles = np.round(np.diff(at_s) / period_s) == 1.0
    if explained < _EXPLAINED or np.mean(singles) < _SINGLE_SHARE:
        return None
    return _phase(before_s, at_s, period_s, jitter), period_s


def _likeliest_period(before_s: Floats, at_s: Floats, jitter: float) -> tuple[float, float]:
    """Share of updates that the best clock explains and chance does not; its period.

    Near the likeliest period in the spectrum of the updates' times.
    """
    from scipy.fft import next_fast_len

    since_s, usual_s = at_s - at_s[0], float(np.median(np.diff(at_s)))
    n = int(np.searchsorted(since_s, _FIRST_PERIODS * usual_s))
    counts = np.bincount((since_s[:n] * (_CELLS / usual_s)).astype(np.int64))
    n_padded = next_fast_len(_PADDED * len(counts), real=True)
    power = np.abs(np.fft.rfft(counts, n_padded))
    rates = np.arange(len(power)) * _CELLS / (n_padded * usual_s)
    likely = (rates > _RATES[0] / usual_s) & (rates < _RATES[1] / usual_s)
    rate_hz = float(rates[likely][np.argmax(power[likely])]) if likely.any() else 1.0 / usual_s
    while True:
        some = slice(None, n, n // _MOST_TRIED + 1)
        for tried in _TRIED:
            near_hz = rate_hz + tried / since_s[n - 1]
            votes = np.array([_votes(before_s[some], at_s[some], 1.0 / float(one), jitter).max() for one in near_hz])
            rate_hz = float(near_hz[votes == votes.max()].mean())
        if n == len(at_s):
            by_chance = min(float(np.median(at_s - before_s)) * rate_hz + 2.0 * jitter, 1.0 - 1.0 / n)
            explained = float(_votes(before_s, at_s, 1.0 / rate_hz, jitter).max()) / n
            return (explained - by_chance) / (1.0 - by_chance), 1.0 / rate_hz
        n = min(_LONGER * n, len(at_s))


def _votes(before_s: Floats, at_s: Floats, period_s: float, jitter: float) -> NDArray[np.int64]:
    """For each phase of a clock: how many updates, each between two rows or nearly so, it explains."""
    first = _PHASES * ((before_s / period_s - jitter) % 1.0)
    length = np.minimum(_PHASES * ((at_s - before_s) / period_s + 2.0 * jitter), _PHASES)
    begun, ended = (
        np.cumsum(np.bincount(np.ceil(ends).astype(np.int64), minlength=2 * _PHASES + 2))[: 2 * _PHASES]
        for ends in (first, first + length)
    )
    return (begun - ended).reshape(2, _PHASES).sum(axis=0)


def _phase(before_s: Floats, at_s: Floats, period_s: float, jitter: float) -> float:
    """A time of the clock that explains most updates, in the middle of what those leave free, or of themselves."""
    votes = _votes(before_s, at_s, period_s, jitter)
    middle = np.exp(2j * np.pi / _PHASES * np.flatnonzero(votes == votes.max())).sum()
    time_s = float(np.angle(middle) / (2.0 * np.pi) * period_s)
    early_s, late_s = ((end_s - time_s + 0.5 * period_s) % period_s - 0.5 * period_s for end_s in (before_s, at_s))
    is_explained = (early_s <= jitter * period_s) & (late_s >= -jitter * period_s)
    if is_explained.any():
        early_s, late_s = early_s[is_explained], late_s[is_explained]
        latest_s, soonest_s = float(early_s.max()), float(late_s.min())
        time_s += 0.5 * (latest_s + soonest_s if latest_s <= soonest_s else float(np.mean(early_s + late_s)))
    return time_s


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
    return Alignment(std_s=max(row_s / np.sqrt(12.0), _ORDINARY_S), latency_s=max(held_s, np.sqrt(12.0) * _ORDINARY_S))
