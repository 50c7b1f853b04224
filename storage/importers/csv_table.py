"""A table as text: comma, semicolon or tab between the cells, one header line."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from bench.errors import InputError
from bench.recording import Floats
from storage.importers.table import Table, take_columns

_DELIMITERS: Final = (",", ";", "\t")
_DECIMAL_COMMA: Final = re.compile(r"^[+-]?\d+,\d+([eE][+-]?\d+)?$")
_N_PROBED_LINES: Final = 20


def read_csv_table(path: Path) -> Table:
    """Read a CSV file.

    The delimiter is found in the header; a decimal comma is understood where the cells are not separated by
    commas. Lines before the header that begin with `#` are skipped. An empty cell or "nan" is a missing
    sample.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Table

    Raises
    ------
    InputError
        If the file is missing, has no header or no `time_s`, or a cell is not a number; the message names the
        column and the row.
    """
    import pandas as pd

    n_comments, header, delimiter, decimal = _probe(path)
    try:
        frame = pd.read_csv(
            path,
            sep=delimiter,
            decimal=decimal,
            header=None,
            names=list(range(len(header))),
            skiprows=n_comments + 1,
            index_col=False,
            skipinitialspace=True,
            encoding="utf-8-sig",
            low_memory=False,
        )
    except (pd.errors.ParserError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as a table: {error}".rstrip("\n"), where=path) from error
    if frame.empty:
        raise InputError("has a header but no data rows", where=path)
    columns: dict[str, Floats] = {}
    for position, name in enumerate(header):
        column = frame[position]
        if not name and bool(column.isna().to_numpy().all()):
            continue  # a delimiter at the end of every line
        if column.dtype.kind not in "fiu":
            raise _not_a_number(path, name, column.tolist())
        columns[name] = column.to_numpy(dtype=np.float64)
    return take_columns(path, columns, {})


def _probe(path: Path) -> tuple[int, list[str], str, str]:
    """Return the number of comment lines, the header's names, the delimiter and the decimal sign."""
    n_comments = 0
    lines: list[str] = []
    for line in _first_lines(path):
        if not lines and (line.startswith("#") or not line.strip()):
            n_comments += 1
        elif line.strip():
            lines.append(line)
    if not lines:
        raise InputError("is empty", where=path)
    delimiter = max(_DELIMITERS, key=lines[0].count)
    header, *rows = ([cell.strip() for cell in row] for row in csv.reader(lines, delimiter=delimiter))
    _check_header(path, header)
    decimal = "."
    if delimiter != "," and any(_DECIMAL_COMMA.match(cell) for row in rows for cell in row):
        decimal = ","
    for number, row in enumerate(rows, start=1):
        if len(row) > len(header):
            is_comma = delimiter == "," and len(row) == 2 * len(header)
            raise InputError(
                f"data row {number} has {len(row)} cells, the header has {len(header)}",
                where=path,
                remedy="decimal commas need semicolons between the cells"
                if is_comma
                else "check the row, and that every column has a name",
            )
    return n_comments, header, delimiter, decimal


def _first_lines(path: Path) -> Iterator[str]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            # Comments may be long: the first lines that are none are what counts.
            lines = (line for line in stream)
            for line in lines:
                yield line
                if line.strip() and not line.startswith("#"):
                    break
            yield from islice(lines, _N_PROBED_LINES)
    except FileNotFoundError:
        raise InputError("no such file", where=path, remedy="check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as text: {error}", where=path) from error


def _check_header(path: Path, header: list[str]) -> None:
    if all(_is_number(cell) for cell in header):
        raise InputError(
            f"has no header: its first line is {', '.join(header[:4])}",
            where=path,
            remedy="put the column names in the first line, for example time_s,force_n,displacement_mm",
        )
    repeated = sorted({name for name in header if name and header.count(name) > 1})
    if repeated:
        raise InputError(f"has the column {repeated[0]} more than once", where=path)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return not cell
    return True


def _not_a_number(path: Path, name: str, cells: list[object]) -> InputError:
    for row, cell in enumerate(cells, start=1):
        if isinstance(cell, str) and not _is_plain_number(cell):
            remedy = "use a point as decimal sign, or semicolons between the cells" if "," in cell else None
            return InputError(
                f"column {name} holds {cell!r} in data row {row}, not a number",
                where=path,
                remedy=remedy or "correct the cell, or leave it empty where the sample is missing",
            )
    return InputError(f"column {name} does not hold numbers", where=path)


def _is_plain_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
