"""Logs of CAN frames that are text: candump `.log`, and Vector `.asc` whatever its language and encoding."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import datetime
from types import MappingProxyType
from typing import TYPE_CHECKING, BinaryIO, Final, TextIO, cast

from sawbench.bench.errors import InputError

if TYPE_CHECKING:
    import can

_CANDUMP_LOG: Final = re.compile(r"\s*\(\d+\.\d+\)\s+\S+\s+[0-9A-F]+#\S*(\s+[RT])?\s*$", re.IGNORECASE)
# Stamps from zero, or since the frame before, have three digits before the point; `-x` adds three columns.
_CANDUMP_COLUMNS: Final = re.compile(
    r"\s*\((?P<time>\d{9,}\.\d+)\)\s+(?P<bus>\S+)\s+([RT]X\s+\S\s+\S\s+)?(?P<identifier>[0-9A-F]{3,8})"
    r"\s+\[(?P<length>\d+)\]\s*(?P<data>.*)"
)
_ASC_BASE: Final = re.compile(r"base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.IGNORECASE)
_ASC_DATE: Final = re.compile(r"(?:date|begin\s+triggerblock)\b(.*)", re.IGNORECASE)
_ASC_EVENT: Final = re.compile(r"\s*(\d+\.\d+)(\s.*)")
_DATE: Final = re.compile(
    r"\s*\w+\.?\s+(?P<month>\w+)\.?\s+(?P<day>\d+)\s+(?P<hour>\d+):(?P<minute>\d+):(?P<second>\d+)(?P<fraction>\.\d+)?"
    r"\s+(?P<half>[^\d\s]\S*)?\s*(?P<year>\d{4})\s*$"
)
_MONTHS: Final = MappingProxyType(
    {"jan": 1, "feb": 2, "mar": 3, "apr": 4, "may": 5, "jun": 6, "jul": 7, "aug": 8, "sep": 9, "oct": 10, "nov": 11}
    | {"dec": 12, "mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12}
)


def read_asc(file: BinaryIO) -> Iterator[can.Message]:
    """Frames of a Vector `.asc` file.

    Parameters
    ----------
    file : BinaryIO

    Yields
    ------
    can.Message
        Its time stamp is in s: since 1970 where the file states a date that can be read, else since the beginning of
        the measurement.
    """
    from can.io.asc import ASCReader

    yield from ASCReader(cast("TextIO", _asc_lines(_lines(file))), relative_timestamp=True)


def read_candump(file: BinaryIO) -> Iterator[can.Message]:
    """Frames of what candump wrote: with `-L` or `-l`, or with `-ta` in its columns.

    Parameters
    ----------
    file : BinaryIO

    Yields
    ------
    can.Message
        Its time stamp is in s since 1970.

    Raises
    ------
    InputError
        At a line in another layout.
    """
    from can.io.canutils import CanutilsLogReader

    yield from CanutilsLogReader(cast("TextIO", _candump_lines(_lines(file))))


def _lines(file: BinaryIO) -> Iterator[str]:
    """Lines as UTF-8, or as Latin-1 where they are not: what is not ASCII is comment or date."""
    for line in file:
        try:
            yield line.decode("utf-8-sig")
        except UnicodeDecodeError:
            yield line.decode("latin-1")


def _candump_lines(lines: Iterator[str]) -> Iterator[str]:
    """Lines as `candump -L` writes them: `(seconds) bus identifier#data`."""
    for number, line in enumerate(lines, 1):
        if _CANDUMP_LOG.match(line) or not line.strip():
            yield line
        elif columns := _CANDUMP_COLUMNS.match(line):
            # A length of two digits marks a frame of CAN FD; what stands behind the bytes is the same as text.
            sign = "#" if len(columns["length"]) == 1 else "##0"
            is_remote = columns["data"].startswith("remote")
            data = "R" if is_remote else "".join(columns["data"].split()[: int(columns["length"])])
            yield f"({columns['time']}) {columns['bus']} {columns['identifier']}{sign}{data}"
        else:
            raise InputError(
                f"line {number} is {line.strip()[:80]!r}, expected (SECONDS) BUS IDENTIFIER#DATA, seconds since 1970",
                remedy="log with candump -L, or with candump -ta; a Vector log ends in .asc",
            )


def _asc_lines(lines: Iterator[str]) -> Iterator[str]:
    """Lines as python-can reads them completely: a header of two lines, events with absolute stamps, no dates."""
    header = "base hex"
    is_relative = False
    start_s = event_s = 0.0
    for line in lines:
        if base := _ASC_BASE.match(line):
            header = f"base {base[1]}"
            is_relative = (base[2] or "").lower() == "relative"
        elif date := _ASC_DATE.match(line):
            start_s, event_s = _seconds_of(date[1]), 0.0
        elif event := _ASC_EVENT.match(line):
            if header:
                yield header
                yield "internal events logged"
                header = ""
            # A relative stamp is the time since the event before, whether that is a frame or not.
            event_s = float(event[1]) + (event_s if is_relative else 0.0)
            yield f"{start_s + event_s:.9f}{event[2]}"


def _seconds_of(date: str) -> float:
    """Seconds since 1970 of an English or German date in local time; 0 where it cannot be read."""
    found = _DATE.match(date)
    month = _MONTHS.get(found["month"][:3].lower()) if found else None
    if found is None or month is None:
        return 0.0
    hour = int(found["hour"])
    half = (found["half"] or "").lower()
    if half.startswith(("a", "v")) and hour == 12:
        hour = 0
    elif half.startswith(("p", "n")) and hour < 12:
        hour += 12
    clock = hour, int(found["minute"]), int(found["second"])
    try:
        moment = datetime(int(found["year"]), month, int(found["day"]), *clock)
    except ValueError:
        return 0.0
    return moment.timestamp() + float(found["fraction"] or 0.0)
