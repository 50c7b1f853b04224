"""A table as JSON: lists by name, a list of records, or a list of rows, at the top or inside objects."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.storage.importers.raw_table import RawColumn, RawTable


def read_json_table(path: Path) -> RawTable:
    """Read the lists of numbers of a JSON file.

    Parameters
    ----------
    path : Path
        Lists inside objects are named with them, joined with points. The columns of a list of rows are named by
        their places, "1", "2", ..., or by a list `columns` beside it. `null` is a missing sample.

    Raises
    ------
    InputError
        If the file is missing or is not JSON.
    """
    try:
        columns = dict(_lists(json.loads(path.read_bytes()), path, ""))
    except FileNotFoundError:
        raise InputError("no such file", where=path, remedy="check the path") from None
    except (OSError, ValueError, OverflowError, RecursionError) as error:
        raise InputError(f"is not a JSON file, or is damaged: {error}", where=path) from error
    return RawTable(path=path, columns=columns)


def _lists(content: Any, path: Path, prefix: str, names: list[str] | None = None) -> Iterator[tuple[str, RawColumn]]:
    if isinstance(content, Mapping):
        stated = content.get("columns")
        for key, value in content.items():
            yield from _lists(
                value, path, f"{prefix}.{key}" if prefix else key, stated if value is not stated else None
            )
    elif isinstance(content, list) and content:
        if all(isinstance(item, Mapping) for item in content):
            keys = dict.fromkeys(key for record in content for key in record)
            columns = {key: [record.get(key) for record in content] for key in keys}
        elif all(isinstance(item, list) and len(item) == len(content[0]) for item in content):
            n_columns = len(content[0])
            is_named = isinstance(names, list) and len(names) == n_columns
            keys = map(str, names) if names is not None and is_named else map(str, range(1, n_columns + 1))
            columns = dict(zip(keys, map(list, zip(*content, strict=True)), strict=True))
        else:
            columns = {"": content}
        for key, values in columns.items():
            name = ".".join(part for part in (prefix, key) if part)
            text = next((value for value in values if isinstance(value, str)), None)
            if text is not None:
                what, remedy = f"column {name} has {text!r}, not a number", "write numbers without quotes"
                problem = InputError(what, where=path, remedy=remedy)
                yield name, RawColumn(values=np.full(len(values), np.nan), problem=problem)
            elif all(value is None or isinstance(value, int | float) for value in values):
                whole = all(isinstance(value, int) for value in values)
                yield (
                    name,
                    RawColumn(
                        values=np.array([np.nan if v is None else v for v in values], dtype=np.float64),
                        since_first=np.array([v - values[0] for v in values], dtype=np.float64) if whole else None,
                    ),
                )
