"""Which column of a foreign table becomes which channel: by the map, and by the names that sawbench uses."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats, Signal
from sawbench.bench.units import CHANNEL_BY_NAME, TIME_COLUMN
from sawbench.storage.importers.clock_times import FirstTime, since_first, unit_since_1970
from sawbench.storage.importers.raw_table import RawColumn, RawTable, names_shown
from sawbench.storage.importers.table import Table
from sawbench.storage.importers.table_map import ColumnRule, TableMap
from sawbench.storage.importers.unit_conversion import (
    FACTORS,
    NAME_OF_STEM,
    factor_between,
    is_unit,
    split_unit,
    stored_unit,
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Choice:
    """What a table was taken for.

    Attributes
    ----------
    tables : tuple of Table
        One, or one a channel where every channel has times of its own.
    words : mapping of str to str
        Channel -> column, unit and factor, in words.
    warnings, notes : tuple of str
    mapped : frozenset of str
        Channels that the map asked for.
    first : FirstTime or None
        When the first row was, where the table states it: the times count from there.
    """

    tables: tuple[Table, ...]
    words: MappingProxyType[str, str]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    mapped: frozenset[str]
    first: FirstTime | None


@dataclass(frozen=True, kw_only=True, slots=True)
class _Taken:
    channel: str
    column: str
    raw: RawColumn
    rule: ColumnRule
    is_mapped: bool


def choose_columns(raw: RawTable, table_map: TableMap | None = None) -> Choice:
    """Take columns for channels and convert them to the units in which these are stored.

    Parameters
    ----------
    raw : RawTable
    table_map : TableMap, optional
        Its channels come first. What it does not name is taken by name: the names of `bench.units` in any case, or
        their words with a unit in brackets, "Force [kN]". Other columns keep their name; with a map they are left
        out.

    Raises
    ------
    InputError
        If the map names a column that is not there, a unit cannot be converted, there is no time or no channel,
        two columns are the same channel, or a column that is taken does not hold numbers.
    """
    table_map = table_map or TableMap()
    taken: dict[str, _Taken] = {}
    for item in _by_map(raw, table_map):
        taken[item.channel] = item
    used = {item.column for item in taken.values()}
    warnings = [*raw.warnings, *_taken_twice(taken)]
    left_out: list[str] = []
    for item in _by_name(raw, table_map, used):
        if item.channel in taken and not taken[item.channel].is_mapped:
            raise InputError(
                f"has {item.channel} more than once: {taken[item.channel].column}, {item.column}",
                where=raw.path,
                remedy="select one in a map (--map), or put every trial in its own file",
            )
        is_other = item.channel not in CHANNEL_BY_NAME and item.channel != TIME_COLUMN
        if item.channel in taken or (table_map.columns and is_other):
            left_out.append(item.column)
        else:
            taken[item.channel] = item
    values, units, words = {}, {}, {}
    for channel, item in taken.items():
        if item.raw.problem is not None:
            if not item.is_mapped and channel not in CHANNEL_BY_NAME and channel != TIME_COLUMN:
                warnings.append(f"column {item.column} does not contain numbers and is left out")
                continue
            raise item.raw.problem
        values[channel], units[channel], words[channel] = _converted(raw, item, warnings)
    first = None
    if TIME_COLUMN in values:
        values[TIME_COLUMN], first = _times(raw, taken[TIME_COLUMN], values[TIME_COLUMN])
    tables = _tables(raw, values, units, taken, table_map, warnings)
    return Choice(
        tables=tables,
        words=MappingProxyType(words),
        warnings=tuple(warnings),
        notes=(f"left out, not in the map: {names_shown(left_out)}",) if left_out else (),
        mapped=frozenset(table_map.columns),
        first=first,
    )


def _times(raw: RawTable, item: _Taken, time_s: Floats) -> tuple[Floats, FirstTime | None]:
    """Times of a table, since its first row where a clock shows them, and when that was."""
    if item.raw.first is not None or not len(time_s):
        return time_s, item.raw.first
    part = unit_since_1970(float(time_s[0]))
    if part:
        raise InputError(
            f"begins at {time_s[0]:.6g} s: probably {part} since 1970",
            where=f"{raw.path}, column {item.column}",
            remedy=f"state the unit in a map (--map): time_s = {{ column = {item.column!r}, unit = '{part}' }}",
        )
    exact = item.raw.since_first
    if exact is not None:
        exact = _converted(raw, replace(item, raw=replace(item.raw, values=exact)), [])[0]
        exact = exact - exact[0]
    return since_first(time_s, exact)


def _taken_twice(taken: Mapping[str, _Taken]) -> Iterator[str]:
    """Say which columns are several channels: that is rarely meant."""
    columns = Counter(item.column for item in taken.values())
    for column in (column for column, n in columns.items() if n > 1):
        channels = ", ".join(channel for channel, item in taken.items() if item.column == column)
        yield f"the map takes column {column} for {channels}: check whether another column is meant"


def _by_map(raw: RawTable, table_map: TableMap) -> Iterator[_Taken]:
    for channel, rule in table_map.columns.items():
        column = raw.find(rule.column)
        yield _Taken(channel=channel, column=column, raw=raw.columns[column], rule=rule, is_mapped=True)


def _by_name(raw: RawTable, table_map: TableMap, used: set[str]) -> Iterator[_Taken]:
    for column, content in raw.columns.items():
        if column in used:
            continue
        channel = _channel_named(column, content.unit)
        if channel == TIME_COLUMN and table_map.table.rate_hz is not None:
            continue
        yield _Taken(channel=channel, column=column, raw=content, rule=ColumnRule(column=column), is_mapped=False)


def _channel_named(column: str, unit: str) -> str:
    """Return the channel that a column is by its name, or the last part of it; else the name itself."""
    last = column.rsplit(".", 1)[-1] if "[" not in column else column
    name = re.sub(r"[\s_\-]+", "_", split_unit(last)[0].strip()).lower()
    if name in CHANNEL_BY_NAME or name == TIME_COLUMN:
        return name
    named = NAME_OF_STEM.get(name)
    if named is not None and unit and factor_between(unit, stored_unit(named)) is not None:
        return named
    return column


def _converted(raw: RawTable, item: _Taken, warnings: list[str]) -> tuple[Floats, str, str]:
    """Return values and unit of a channel as they are stored, and in words where they come from."""
    channel, rule = item.channel, item.rule
    stored = stored_unit(channel) if item.is_mapped or channel in CHANNEL_BY_NAME or channel == TIME_COLUMN else ""
    is_rescaled = rule.scale != 1.0 or rule.offset != 0.0
    stated = rule.unit or ("" if is_rescaled else item.raw.unit)
    if rule.unit and item.raw.unit not in ("", rule.unit) and not is_rescaled:
        warnings.append(f"{channel}: the map states {rule.unit}, the file {item.raw.unit!r}; the map is used")
    factor = 1.0
    if stored and stated:
        found = factor_between(stated, stored)
        if found is None and (rule.unit or is_unit(stated)):
            raise InputError(
                f"{channel} cannot be converted from {stated!r} to {stored}",
                where=f"{raw.path}, column {item.column}",
                remedy=f"state one of {', '.join(FACTORS[stored])}; for another unit write in the map unit = '{stored}'"
                f" and scale = {stored} per unit of the column",
            )
        if found is None:
            warnings.append(f"{channel} has the unknown unit {stated!r}, taken as {stored}")
        factor = found or 1.0
    if not is_rescaled and rule.sign == 1 and factor == 1.0:
        values = item.raw.values
    else:
        values = rule.sign * factor * (rule.scale * item.raw.values + rule.offset)
    shown = f"column {item.column!r}" + (f" in {stated}" if stated else "")
    parts = [f"scale {rule.scale:g}" * (rule.scale != 1.0), f"offset {rule.offset:g}" * (rule.offset != 0.0)]
    times = rule.sign * factor
    parts.append(f"times {times:g}" * (times != 1.0))
    return values, stored or stated, ", ".join([shown, *filter(None, parts)])


def convert_signal(signal: Signal, rule: ColumnRule, *, where: Path) -> tuple[Signal, str]:
    """Convert a decoded signal to the unit in which its channel is stored.

    Parameters
    ----------
    signal : Signal
    rule : ColumnRule
    where : Path
        For the error.

    Returns
    -------
    signal : Signal
    words : str
        Where the values come from.

    Raises
    ------
    InputError
        If the unit cannot be converted.
    """
    content = RawColumn(values=signal.values, unit=signal.unit)
    raw = RawTable(path=where, columns={str(rule.column): content})
    item = _Taken(channel=signal.channel, column=str(rule.column), raw=content, rule=rule, is_mapped=True)
    values, unit, words = _converted(raw, item, [])
    return replace(signal, values=values, unit=unit), words


def _tables(
    raw: RawTable,
    values: dict[str, Floats],
    units: dict[str, str],
    taken: dict[str, _Taken],
    table_map: TableMap,
    warnings: list[str],
) -> tuple[Table, ...]:
    if TIME_COLUMN not in values and table_map.table.rate_hz is None:
        own = {name: taken[name].raw.time_s for name in values}
        if own and all(time_s is not None for time_s in own.values()):
            return tuple(
                Table(path=raw.path, time_s=time_s, columns={name: values[name]}, units={name: units[name]})
                for name, time_s in own.items()
                if time_s is not None
            )
        raise _no_time(raw)
    others = {name: found for name, found in values.items() if name != TIME_COLUMN}
    if not others:
        raise InputError(
            f"has {TIME_COLUMN} but no channel; its columns are {names_shown(raw.columns)}",
            where=raw.path,
            remedy="assign columns to channels in a map (--map)",
        )
    time_s = values.get(TIME_COLUMN)
    if time_s is None:
        rate_hz = table_map.table.rate_hz or 1.0
        time_s = np.arange(max(map(len, others.values()))) / rate_hz
    for name, found in list(others.items()):
        if len(found) == len(time_s):
            continue
        if not taken[name].is_mapped and name not in CHANNEL_BY_NAME:
            warnings.append(f"{name} has {len(found)} values, the time {len(time_s)}; it is left out")
            del others[name]
            continue
        raise InputError(f"{name} has {len(found)} values but {TIME_COLUMN} has {len(time_s)}", where=raw.path)
    table = Table(path=raw.path, time_s=time_s, columns=others, units=units, place=raw.place)
    return (_without_repeated(table, table_map, warnings),)


def _without_repeated(table: Table, table_map: TableMap, warnings: list[str]) -> Table:
    """Leave rows out that say what the row before them says, and as the map has it all whose time is repeated."""
    is_old = np.zeros(len(table.time_s), dtype=bool)
    is_old[1:] = np.diff(table.time_s) == 0
    said = "rows with a repeated time are left out, as set in the map"
    if table_map.table.repeated_times != "drop":
        said = "rows are left out: they repeat the row before them, with its time"
        for values in table.columns.values():
            before, here = values[:-1], values[1:]
            is_old[1:] &= (here == before) | (np.isnan(here) & np.isnan(before))
    n_dropped = int(np.sum(is_old))
    if n_dropped:
        warnings.append(f"{n_dropped} {said}")
    is_new = ~is_old
    rows = np.flatnonzero(is_new)
    return replace(
        table,
        time_s=table.time_s[is_new],
        columns={name: values[is_new] for name, values in table.columns.items()},
        place=lambda row: table.place(int(rows[row])),
    )


def _no_time(raw: RawTable) -> InputError:
    if set(raw.columns) <= {str(place) for place in range(1, len(raw.columns) + 1)}:
        return InputError(
            f"has no header: its {len(raw.columns)} columns have no names",
            where=raw.path,
            remedy="put the column names in the first line, for example time_s,force_n,displacement_mm, or name the "
            "columns by their places in a map (--map): [columns] time_s = { column = 1 }",
        )
    close = [n for n in raw.columns if n.rsplit(".", 1)[-1].lower().startswith(("time", "t_", "stamp", "sec"))]
    example = f"time_s = {{ column = {close[0]!r}, unit = 's' }}" if close else "time_s = { column = ..., unit = ... }"
    return InputError(
        f"has no column {TIME_COLUMN}; its columns are {names_shown(raw.columns)}",
        where=raw.path,
        remedy=f"name the time column {TIME_COLUMN}, in seconds, or use a map (--map): [columns] {example}, or "
        "[table] rate_hz = ...",
    )
