"""What battery testers log: time, current, voltage, temperature and cycle of one file or of many runs in it.

Without a map, columns are found by the names that sawbench and common testers give them. A map may hold `*` in its
columns: every run that fits all of them is taken, such as `T25.*.volVec` in a MATLAB file of several rates.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats
from sawbench.bench.units import BATTERY_CURRENT, BATTERY_VOLTAGE, TIME_COLUMN
from sawbench.storage.importers.column_choice import choose_columns
from sawbench.storage.importers.dispatch import read_raw_table, stem_of
from sawbench.storage.importers.raw_table import RawTable, names_shown
from sawbench.storage.importers.table_map import ColumnRule, TableMap
from sawbench.storage.importers.unit_conversion import split_unit

TEMPERATURE: Final = "temperature_c"
CYCLE: Final = "cycle"
_CHANNELS: Final = (TIME_COLUMN, BATTERY_CURRENT.name, BATTERY_VOLTAGE.name)
# Names, in small letters and without signs, that a column has at Arbin, BioLogic, Neware, Maccor, Digatron and in
# common exports; a unit behind a slash belongs to the name.
_NAMES: Final = MappingProxyType(
    {
        TIME_COLUMN: {
            "times": "s", "testtime": "", "testtimes": "s", "totaltime": "", "testsec": "s", "elapsedtime": "",
            "time": "", "proctime": "", "timevec": "s",
        },
        BATTERY_CURRENT.name: {
            "batterycurrenta": "A", "current": "", "currenta": "A", "ima": "mA", "ia": "A", "amps": "A", "cur": "",
            "currvec": "A", "currentmeasured": "A",
        },
        BATTERY_VOLTAGE.name: {
            "batteryvoltagev": "V", "voltage": "", "voltagev": "V", "ecellv": "V", "volts": "V", "vol": "",
            "volvec": "V", "voltagemeasured": "V",
        },
        TEMPERATURE: {
            "temperaturec": "", "temperature": "", "auxtemperature1": "", "temp": "", "celltemp": "", "celltempmid": "",
            "batterytempdegc": "", "temperaturemeasured": "",
        },
        CYCLE: {"cycleindex": "", "cyclenumber": "", "cycle": "", "cyc": "", "cycleid": ""},
    }
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class DischargeTable:
    """One run of a battery tester, rows with an empty cell left out.

    Attributes
    ----------
    label : str
        The file, and what `*` of the map stands for.
    time_s, current_a, voltage_v : ndarray, shape (n,)
        The current with the sign of the file and the map.
    temperature_c, cycle : ndarray, shape (n,), or None
    taken : mapping of str to str
        Channel -> the column it was taken from, in words.
    warnings : tuple of str
        What of the table could not be used.
    """

    label: str
    time_s: Floats
    current_a: Floats
    voltage_v: Floats
    temperature_c: Floats | None
    cycle: Floats | None
    taken: Mapping[str, str]
    warnings: tuple[str, ...] = ()


def read_discharge_tables(path: str | Path, table_map: TableMap | None = None) -> list[DischargeTable]:
    """Read the runs of a battery tester.

    Parameters
    ----------
    path : str or Path
        Of every format that `sawbench import` takes.
    table_map : TableMap, optional
        Columns of `time_s`, `battery_current_a`, `battery_voltage_v`, and where there are any `temperature_c` and
        `cycle`.

    Raises
    ------
    InputError
        If a column is missing or does not hold numbers, or no run fits the map.
    """
    path = Path(path)
    raw = read_raw_table(path, table_map)
    if table_map is None or not table_map.columns:
        rules = _by_name(raw, table_map or TableMap())
        return [_table(raw, rules, stem_of(path))]
    missing = [name for name in _CHANNELS[1:] if name not in table_map.columns]
    if missing:
        raise InputError(
            f"the map has no column for {', '.join(missing)}",
            where=path,
            remedy='for example: [columns] battery_voltage_v = "Voltage(V)"',
        )
    return [_table(raw, one, " ".join((stem_of(path), *found))) for one, found in _expanded(raw, table_map)]


def _by_name(raw: RawTable, table_map: TableMap) -> TableMap:
    """Return a map of the columns that are known by their names."""
    rules: dict[str, ColumnRule] = {}
    bare = {column: _bare(column) for column in raw.columns}
    for channel, names in _NAMES.items():
        found = next((name for name in names if name in bare.values()), None)
        if found is None:
            continue
        columns = [column for column, name in bare.items() if name == found]
        if len(columns) > 1:
            raise InputError(
                f"has {len(columns)} columns that may be {channel}: {names_shown(columns)}",
                where=raw.path,
                remedy="select one in a map (--map); a * in its name stands for one run after the other: [columns] "
                f"{channel} = '{_starred(columns)}'",
            )
        stated = raw.columns[columns[0]].unit or split_unit(columns[0])[1]
        unit = names[found] if channel in _CHANNELS and not stated else ""
        rules[channel] = ColumnRule(column=columns[0], unit=unit or None)
    missing = [name for name in _CHANNELS if name not in rules]
    if missing == [TIME_COLUMN] and table_map.table.rate_hz is not None:
        missing = []
    if missing:
        raise InputError(
            f"no column found for {', '.join(missing)}; its columns are {names_shown(raw.columns)}",
            where=raw.path,
            remedy="assign the column in a map (--map): [columns] " + " ".join(f"{name} = ..." for name in missing),
        )
    return _with_columns(table_map, rules)


def _starred(columns: Sequence[str]) -> str:
    """Return the name that stands for all columns, with a star for every part that differs."""
    parts = [set(part) for part in zip(*(column.split(".") for column in columns), strict=False)]
    return ".".join(part.pop() if len(part) == 1 else "*" for part in parts)


def _bare(column: str) -> str:
    """Return the last part of a column's name in small letters, without its unit in brackets and without signs."""
    last = column.rsplit(".", 1)[-1] if "[" not in column and "(" not in column else column
    return re.sub(r"[^a-z0-9]", "", split_unit(last)[0].lower())


def _with_columns(table_map: TableMap, rules: Mapping[str, ColumnRule]) -> TableMap:
    """Return a map with other columns."""
    return table_map.model_copy(update={"columns": dict(rules)})


def _expanded(raw: RawTable, table_map: TableMap) -> Iterator[tuple[TableMap, tuple[str, ...]]]:
    """Return one map for every run that the stars of a map stand for, and what they stand for."""
    starred = {name: str(rule.column) for name, rule in table_map.columns.items() if "*" in str(rule.column)}
    if not starred:
        yield table_map, ()
        return
    first = starred.get(TIME_COLUMN) or next(iter(starred.values()))
    pattern = re.compile(r"(?:.*\.)?" + re.escape(first).replace(r"\*", r"([^.]*)"))
    runs = [match.groups() for match in map(pattern.fullmatch, raw.columns) if match]
    if not runs:
        raise InputError(
            f"no column matches {first!r}; its columns are {names_shown(raw.columns)}",
            where=raw.path,
            remedy="correct the column in the map; * stands for a name between two dots",
        )
    for run in runs:
        rules = dict(table_map.columns)
        for name, column in starred.items():
            if column.count("*") > len(run):
                raise InputError(f"{name} has more stars than {first!r}", where=raw.path, remedy="correct the map")
            filled = column
            for part in run:
                filled = filled.replace("*", part, 1)
            rules[name] = rules[name].model_copy(update={"column": filled})
        yield _with_columns(table_map, rules), run


def _table(raw: RawTable, table_map: TableMap, label: str) -> DischargeTable:
    choice = choose_columns(raw, table_map)
    if len(choice.tables) != 1:
        raise InputError("its channels have different sample times", where=raw.path, remedy="export with a common time")
    (table,) = choice.tables
    current, voltage = table.columns[BATTERY_CURRENT.name], table.columns[BATTERY_VOLTAGE.name]
    is_whole = np.isfinite(table.time_s) & np.isfinite(current) & np.isfinite(voltage)
    if is_whole.sum() < 2:
        raise InputError("has fewer than two rows with time, current and voltage", where=f"{raw.path} ({label})")

    def further(name: str) -> Floats | None:
        values = table.columns.get(name)
        return None if values is None else values[is_whole]

    return DischargeTable(
        label=label,
        time_s=table.time_s[is_whole],
        current_a=current[is_whole],
        voltage_v=voltage[is_whole],
        temperature_c=further(TEMPERATURE),
        cycle=further(CYCLE),
        taken=choice.words,
        warnings=raw.warnings,
    )
