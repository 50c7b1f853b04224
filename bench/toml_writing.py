"""TOML text of nested tables, with comments: what `tomllib` reads back."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from datetime import date, datetime, time
from typing import Any

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(tables: Mapping[str, Any], comments: Mapping[tuple[str, ...], Sequence[str]] | None = None) -> str:
    """Write tables as TOML.

    Parameters
    ----------
    tables : mapping
        Of tables, whose own tables stand on one line each, but those of devices: they have a `driver` and lines of
        their own.
    comments : mapping of tuple of str to sequence of str, optional
        Lines above a table (its name), an entry (table, key) or an entry of no table (its name); `()` is the head of
        the file. A list of tables has a line for each.

    Examples
    --------
    >>> print(toml_text({"plant": {"r_ohm": {"nominal": 0.2}}}, {("plant", "r_ohm"): ["warm"]}), end="")
    [plant]
    # warm
    r_ohm = { nominal = 0.2 }
    """
    said = comments or {}
    lines = [f"# {line}" for line in said.get((), ())]
    for name, value in tables.items():
        if not isinstance(value, Mapping):
            lines += [*(f"# {line}" for line in said.get((name,), ())), f"{_key(name)} = {_value(value)}"]
    for name, table in tables.items():
        if not isinstance(table, Mapping):
            continue
        divided = [key for key, entry in table.items() if _is_section(entry)]
        own = {key: entry for key, entry in table.items() if key not in divided}
        if own or not divided:
            lines += _section((name,), own, said)
        for key in divided:
            lines += _section((name, key), table[key], said)
    return "\n".join(lines).strip("\n") + "\n"


def _is_section(entry: Any) -> bool:
    return isinstance(entry, Mapping) and "driver" in entry


def _section(
    path: tuple[str, ...], table: Mapping[str, Any], said: Mapping[tuple[str, ...], Sequence[str]]
) -> list[str]:
    lines = ["", *(f"# {line}" for line in said.get(path, ())), f"[{'.'.join(map(_key, path))}]"]
    for key, entry in table.items():
        lines += [f"# {line}" for line in said.get((*path, key), ())]
        lines.append(f"{_key(key)} = {_value(entry)}")
    return lines


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else json.dumps(name)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {_value(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON escapes are TOML's, but for the one control character that JSON leaves as it is.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int | float):
        return repr(value)
    return value.isoformat() if isinstance(value, datetime | date | time) else _list(value)


def _list(value: Sequence[Any]) -> str:
    if value and all(isinstance(entry, Mapping) for entry in value):
        return "[\n" + "".join(f"    {_value(entry)},\n" for entry in value) + "]"
    return "[" + ", ".join(_value(entry) for entry in value) + "]"
