"""Samples of a slow instrument in a table whose last digit hides them: it draws lines between them, or holds them.

Where a row changes a value by less than the last digit, no single corner of a line is seen. All of them together are:
the second differences are larger near corners, which come with one period. And where the period is known from other
recordings only its phase is looked for: an idle run, which changes a battery's current by a few digits, shows no more.
"""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats

# Rows that lines of that period must round to, of all: half a digit off is what rounding does.
_ROUNDED, _MOST_ROWS = 0.51, 0.95
# Of the last digit: misses that are closer are alike.
_ALIKE = 1e-6
# Phases a row that are tried, on so many periods.
_PHASES, _TRIED_PERIODS = 2, 200
# Rows that a period is looked for in, those on either side of which a value is compared, and the least of a period.
_LOOKED_AT, _LAGS, _LEAST_ROWS = 32_768, (1, 4, 16), 3.0
# Lines of each spectrum that are tried, how much above the others they are, and how finely it is drawn.
_LINES, _ABOVE, _PADDED = 3, 8.0, 8
# Periods in the rows, at the least.
_LEAST_PERIODS = 50
# Variance of what rounding misses, of the digit squared, and by how much more samples that are early or late may miss.
_VARIANCE, _LATE = 1.0 / 12.0, 1.1
# Half a period later, lines miss more than by chance, by so many standard deviations; and from one sample to the next
# the value changes by more than one digit.
_SURELY, _LEAST_STEP = 10.0, 1.0


def is_hidden_by(values: Floats, digit: float) -> bool:
    """Whether most rows are straight to within the last digit, as they are between samples and without noise."""
    bends = np.abs(np.diff(values[:_LOOKED_AT], 2))
    return bool(digit > 0.0 and len(bends) > 0 and np.median(bends) < (1.0 + _ALIKE) * digit)


def hidden_period(time_s: Floats, values: Floats, digit: float) -> float | None:
    """Period of the corners of the lines that a table draws, by their second differences.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Rows of the table.
    digit : float
        What the rows are multiples of.

    Returns
    -------
    float or None
        None where lines of no period round to the rows, and where they would do so with other corners as well. What the
        machine does once a stroke has a period too: a clock is what has the same one at another stroke rate.

    Examples
    --------
    >>> t = np.arange(8000) / 2000
    >>> rows = np.round(np.interp(t, t[7::20], np.sin(40 * t[7::20])), 2)
    >>> round(hidden_period(t, rows, 0.01), 5)
    0.01

    In steps of a tenth corners bend a row by less than a tenth of a step: too little to tell.

    >>> hidden_period(t, np.round(rows, 1), 0.1) is None
    True
    """
    middle = max(0, (len(values) - _LOOKED_AT) // 2)
    time_s, values = time_s[middle : middle + _LOOKED_AT], values[middle : middle + _LOOKED_AT]
    row_s, n = float(np.median(np.diff(time_s))), len(values)
    best: tuple[float, float, float, float, Floats] | None = None
    for rows, at in _likely_corners(values):
        start_s, period_s = float(time_s[0]) + row_s * at, row_s * rows
        _, own, drawn = _lines(time_s, values, start_s, period_s)
        missed = float(np.var(values - drawn))
        # Half as long a period fits no worse, with twice as many corners.
        cost = n * np.log(max(missed, _ALIKE * digit**2)) + n / rows * np.log(n)
        if best is None or cost < best[0]:
            best = cost, missed, start_s, period_s, own
    if best is None:
        return None
    _, missed, start_s, period_s, own = best
    other = float(np.var(values - _lines(time_s, values, start_s + 0.5 * period_s, period_s)[2]))
    by_chance = np.sqrt(8.0 * row_s / (n * period_s))
    is_sure = other > missed * (1.0 + _SURELY * by_chance)
    is_seen = np.sqrt(np.mean(np.diff(own) ** 2)) > _LEAST_STEP * digit
    return period_s if missed < _LATE * _VARIANCE * digit**2 and is_sure and is_seen else None


def _likely_corners(values: Floats) -> list[tuple[float, float]]:
    """Periods that second differences have, and one corner of each, in rows."""
    found = []
    for lag in _LAGS:
        if len(values) - 2 * lag <= _LEAST_PERIODS * _LEAST_ROWS + 2:
            break
        bend = np.abs(values[2 * lag :] - 2.0 * values[lag:-lag] + values[: -2 * lag])
        bend = bend - bend.mean()
        n = 1 << (_PADDED * len(bend)).bit_length()
        size = np.abs(np.fft.rfft(bend, n))
        first, last = int(np.ceil(_LEAST_PERIODS * n / len(bend))), int(n / _LEAST_ROWS)
        usual = _ABOVE * np.median(size[first:last])
        is_line = (size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:]) & (size[1:-1] > usual)
        lines = 1 + np.flatnonzero(is_line)
        lines = lines[(lines >= first) & (lines < last)]
        for line in lines[np.argsort(size[lines])[-_LINES:]]:
            before, at, after = size[line - 1 : line + 2]
            per_row = (line + 0.5 * (before - after) / (before - 2.0 * at + after)) / n
            turned = np.angle(np.exp(-2j * np.pi * per_row * np.arange(len(bend))) @ bend)
            found.append((float(1.0 / per_row), float(lag - turned / (2.0 * np.pi * per_row))))
    return found


def samples_at_period(
    time_s: Floats, values: Floats, period_s: float, digit: float
) -> tuple[Floats, Floats] | None:  # fmt: skip
    """Samples that the rows of a table were made of, by holding each or by drawing lines between them.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        Rows of the table.
    period_s : float
        Of the instrument.
    digit : float
        What the rows are multiples of.

    Returns
    -------
    (time_s, values), each of shape (m,), or None
        None where neither steps nor lines of this period round to the rows.

    Examples
    --------
    >>> t = np.arange(2000) / 1000
    >>> rows = np.round(np.interp(t, t[7::20], np.sin(40 * t[7::20])), 1)
    >>> own_s, own = samples_at_period(t, rows, 0.02, 0.1)
    >>> len(own), bool(np.std(own - np.sin(40 * own_s)) < 0.03)
    (100, True)
    """
    some = slice(0, int(np.searchsorted(time_s, time_s[0] + _TRIED_PERIODS * period_s)))
    n_phases = int(np.ceil(_PHASES * period_s / np.median(np.diff(time_s))))
    turns = np.arange(n_phases) / n_phases
    for made in (_steps, _lines):
        starts_s = time_s[0] + period_s * turns
        missed = [np.std(values[some] - made(time_s[some], values[some], start_s, period_s)[2]) for start_s in starts_s]
        # Where several fit alike, as within a row of a step, the one in their middle.
        best = np.exp(2j * np.pi * turns[np.array(missed) <= min(missed) + _ALIKE * digit]).sum()
        start_s = float(time_s[0] + period_s * np.angle(best) / (2.0 * np.pi))
        own_s, own, rows = made(time_s, values, start_s, period_s)
        if np.mean(np.abs(values - rows) < _ROUNDED * digit) > _MOST_ROWS:
            is_within = (own_s >= time_s[0]) & (own_s <= time_s[-1])
            return own_s[is_within], own[is_within]
    return None


def _steps(time_s: Floats, values: Floats, start_s: float, period_s: float) -> tuple[Floats, Floats, Floats]:
    """Times and values of the steps that fit rows best, and the rows that they make."""
    place = np.floor((time_s - start_s) / period_s).astype(np.int64)
    place, first = place - place[0], int(place[0])
    n_rows = np.bincount(place)
    mean = np.bincount(place, values) / np.maximum(n_rows, 1)
    there = np.flatnonzero(n_rows)
    at_s = start_s + period_s * (first + there).astype(np.float64)
    return at_s, mean[there], mean[place]


def _lines(time_s: Floats, values: Floats, start_s: float, period_s: float) -> tuple[Floats, Floats, Floats]:
    """Times and values of the corners of the lines that fit rows best, and the rows that they make."""
    from scipy.linalg import solveh_banded

    place = (time_s - start_s) / period_s
    corner = np.floor(place).astype(np.int64)
    after = place - corner
    corner, first = corner - corner[0], int(corner[0])
    n = int(corner[-1]) + 2

    def at_corners(before: Floats, behind: Floats) -> Floats:
        return np.asarray(np.bincount(corner, before, n) + np.bincount(corner + 1, behind, n), dtype=np.float64)

    diagonal = at_corners((1.0 - after) ** 2, after**2)
    beside = np.bincount(corner + 1, after * (1.0 - after), n)
    # A corner that no row tells of, in a hole, is zero; it is left out.
    is_told = diagonal > 0.0
    moments = at_corners((1.0 - after) * values, after * values)
    own = np.asarray(solveh_banded(np.vstack([beside, np.where(is_told, diagonal, 1.0)]), moments))
    rows = np.asarray((1.0 - after) * own[corner] + after * own[corner + 1], dtype=np.float64)
    at_s = start_s + period_s * (first + np.flatnonzero(is_told)).astype(np.float64)
    return at_s, own[is_told], rows
