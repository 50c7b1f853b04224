"""Times as a clock shows them: of the day, behind a date, in seconds since 1970; and when the first of them was."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from typing import TYPE_CHECKING, Final
from zoneinfo import ZoneInfo

import numpy as np
from sawbench.bench.recording import Floats

if TYPE_CHECKING:
    import pandas as pd

_DAY_S: Final = 86400.0
HALF_OF_DAY: Final = "[AaPp][Mm]"
ZONE: Final = r"Z|UTC|GMT|[+-]\d{2}:?\d{2}"
_CLOCK: Final = re.compile(
    r"^\s*(?:(?P<date>\d[\d./-]*\d)[ T]\s*)?(?P<h>\d{1,2}):(?P<m>\d{2}):(?P<s>\d{2}(?:[.,]\d+)?)"
    rf"\s*(?P<half>{HALF_OF_DAY})?\s*(?P<zone>{ZONE})?\s*$"
)
# Year first, or the day before points: in 3/4/2026 the month may be either number.
_DATES: Final = (
    re.compile(r"^(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})$"),
    re.compile(r"^(?P<day>\d{1,2})\.(?P<month>\d{1,2})\.(?P<year>\d{4})$"),
)
_OFFSET: Final = re.compile(r"^([+-])(\d{2}):?(\d{2})$")
# September 2001 to January 2065: no instrument has run for so long, and seconds since 1904 are later.
_UNIX_S: Final = (1e9, 3e9)
_PARTS: Final = {"ms": 1e3, "us": 1e6, "ns": 1e9}


@dataclass(frozen=True, kw_only=True, slots=True)
class FirstTime:
    """When the first row of a table was, by its own clock.

    Attributes
    ----------
    of_day_s : float, optional
        Since midnight, s.
    at : datetime, optional
        Where date and time zone are known.
    has_date : bool
        With or without a time zone.
    """

    of_day_s: float | None = None
    at: datetime | None = None
    has_date: bool = False

    def after(self, other: FirstTime) -> float:
        """Time since the first row of another table, s; 0 where the two clocks cannot be compared."""
        if self.at is not None and other.at is not None:
            return (self.at - other.at).total_seconds()
        if self.of_day_s is None or other.of_day_s is None:
            return 0.0
        # Midnight may lie between them.
        return (self.of_day_s - other.of_day_s + 0.5 * _DAY_S) % _DAY_S - 0.5 * _DAY_S


def clock_times(cells: pd.Series, zone: tzinfo | None = None) -> tuple[Floats, FirstTime] | None:
    """Read times of the day, with or without a date before and a time zone behind them.

    Parameters
    ----------
    cells : Series of str, shape (n,)
    zone : tzinfo, optional
        Of dates that state none.

    Returns
    -------
    (time_s, first) or None
        Seconds since the first row, shape (n,), and when that was; None where a cell is no such time.

    Examples
    --------
    >>> import pandas as pd
    >>> time_s, first = clock_times(pd.Series(["2026-03-02 11:59:59.5 PM +01:00", "2026-03-03 12:00:00.5 AM +01:00"]))
    >>> time_s.tolist(), first.at.isoformat()
    ([0.0, 1.0], '2026-03-02T23:59:59.500000+01:00')
    """
    parts = cells.astype(str).str.extract(_CLOCK)
    if bool(parts["h"].isna().any()):
        return None
    hours, minutes, seconds = (parts[k].str.replace(",", ".").to_numpy(dtype=np.float64) for k in "hms")
    half = parts["half"].str.upper()
    hours = np.where(half.notna(), hours % 12 + 12 * (half == "PM"), hours)
    of_day_s = 3600.0 * hours + 60.0 * minutes + seconds
    days = _of_each(parts["date"], lambda date: np.nan if (day := _day(date)) is None else day.toordinal())
    if np.isnan(days).any():
        # No date, or of unknown order: a time that falls by half a day is past the next midnight.
        days = np.cumsum(np.diff(of_day_s, prepend=of_day_s[0]) < -0.5 * _DAY_S)
    ahead_s = _of_each(parts["zone"], lambda stated: _offset_s(stated) if isinstance(stated, str) else 0.0)
    first = _first(float(of_day_s[0]), parts["date"].iloc[0], parts["zone"].iloc[0], zone)
    return of_day_s - of_day_s[0] + _DAY_S * (days - days[0]) - (ahead_s - ahead_s[0]), first


def since_first(time_s: Floats, exact_s: Floats | None = None) -> tuple[Floats, FirstTime | None]:
    """Take seconds since 1970 as seconds from the first row; other times stay as they are.

    Parameters
    ----------
    time_s : ndarray, shape (n,), s
    exact_s : ndarray, shape (n,), s, optional
        Times since the first row with more digits than their difference has: 0.24 us is what is left of them otherwise.

    Returns
    -------
    time_s : ndarray, shape (n,), s
    first : FirstTime or None
        None where the times count from somewhere else.

    Examples
    --------
    >>> time_s, first = since_first(np.array([1772442000.25, 1772442000.75]))
    >>> time_s.tolist(), first.at.isoformat()
    ([0.0, 0.5], '2026-03-02T09:00:00.250000+00:00')
    """
    if not len(time_s) or not _UNIX_S[0] <= time_s[0] <= _UNIX_S[1]:
        return time_s, None
    at = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=float(time_s[0]))
    return time_s - time_s[0] if exact_s is None else exact_s, FirstTime(at=at, has_date=True)


def unit_since_1970(value: float) -> str:
    """Name the part of a second in which a value counts since 1970; "" where it does not.

    Examples
    --------
    >>> unit_since_1970(1772442000250.0), unit_since_1970(1772442000.25), unit_since_1970(3.0)
    ('ms', '', '')
    """
    low, high = _UNIX_S
    return next((unit for unit, factor in _PARTS.items() if low * factor <= value <= high * factor), "")


def zone_named(text: str) -> tzinfo:
    """Return a time zone by its offset or its name.

    Parameters
    ----------
    text : str

    Raises
    ------
    ValueError
        If it is neither.

    Examples
    --------
    >>> zone_named("+01:00").utcoffset(None)
    datetime.timedelta(seconds=3600)
    """
    offset = _OFFSET.match(text)
    if offset is not None:
        sign, hours, minutes = offset.groups()
        return timezone((-1 if sign == "-" else 1) * timedelta(hours=int(hours), minutes=int(minutes)))
    if text in ("Z", "UTC", "GMT"):
        return UTC
    try:
        return ZoneInfo(text)
    except (OSError, ValueError, KeyError):
        raise ValueError('must be an offset such as "+01:00", or a name such as "Europe/Berlin"') from None


def _first(of_day_s: float, date: object, stated: object, zone: tzinfo | None) -> FirstTime:
    if not isinstance(date, str):
        return FirstTime(of_day_s=of_day_s)
    day = _day(date)
    zone = zone_named(stated) if isinstance(stated, str) else zone
    if day is None or zone is None:
        return FirstTime(of_day_s=of_day_s, has_date=True)
    at = day.replace(tzinfo=zone) + timedelta(seconds=of_day_s)
    return FirstTime(of_day_s=of_day_s, at=at, has_date=True)


def _day(date: object) -> datetime | None:
    """Midnight of a date; None where there is none, it is no day, or its order is not known."""
    if not isinstance(date, str):
        return None
    found = next((match for match in (pattern.match(date) for pattern in _DATES) if match), None)
    try:
        return found and datetime(int(found["year"]), int(found["month"]), int(found["day"]))
    except ValueError:
        return None


def _offset_s(stated: str) -> float:
    """Time by which a stated zone is ahead of UTC, s."""
    ahead = zone_named(stated).utcoffset(None)
    return 0.0 if ahead is None else ahead.total_seconds()


def _of_each(cells: pd.Series, value: Callable[[object], float]) -> Floats:
    """A number for every cell, of which few differ."""
    codes, different = cells.factorize(use_na_sentinel=False)
    return np.array([value(cell) for cell in different], dtype=np.float64)[codes]
