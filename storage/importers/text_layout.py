"""Finds out how a table is written as text: separator, decimal sign, header, units, where the numbers begin."""

from __future__ import annotations

import csv
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sawbench.bench.errors import InputError
from sawbench.storage.importers.clock_times import HALF_OF_DAY, ZONE
from sawbench.storage.importers.table_map import ReadingRules
from sawbench.storage.importers.unit_conversion import bare_unit, is_unit

COMMENT_SIGNS: Final = ("#", "%", "//", "!")
_SEPARATORS: Final = (";", "\t", "|", ",", " ")
_SEP_LINE: Final = re.compile(r"^sep=(.)\s*$", re.IGNORECASE)
_NUMBER: Final = re.compile(r"^[+-]?(\d+(\.\d*|,\d+)?|[.,]\d+)([eE][+-]?\d+)?$|^[+-]?(nan|inf)$", re.IGNORECASE)
_GROUPED: Final = re.compile(r"^[+-]?[1-9]\d{0,2}(?:([.,'\u00a0\u202f])\d{3})(?:\1\d{3})*(?:[.,]\d+)?$")
_CLOCK: Final = re.compile(
    r"^(\d{1,4}[-./]\d{1,2}[-./]\d{1,4})?[ T]?(\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?)?"
    rf"( ?{HALF_OF_DAY})?( ?({ZONE}))?$"
)
_DECIMAL_COMMA: Final = re.compile(r"^[+-]?\d*,\d+([eE][+-]?\d+)?$")
_DECIMAL_POINT: Final = re.compile(r"^[+-]?\d*\.\d+([eE][+-]?\d+)?$")
_N_JUDGED_ROWS: Final = 40
# Each of the two headers of a .lvm file ends so; its last column has a cell only in rows with a comment.
_LABVIEW_END: Final = "***End_of_Header***"
_LABVIEW_COMMENT: Final = "Comment"


@dataclass(frozen=True, kw_only=True, slots=True)
class TextLayout:
    """How a table is written.

    Attributes
    ----------
    names, units : tuple of str
        A column each; units are "" where none is stated.
    separator : str
        " " stands for any run of spaces and tabs.
    decimal : str, optional
        None where the lines that were looked at hold no fraction.
    n_lines_before : int
        Lines before the first row of numbers.
    comment : str
        Sign that begins a comment line.
    n_remarks : int
        Lines before the header that are neither empty nor part of the table.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    separator: str
    decimal: str | None
    n_lines_before: int
    comment: str
    n_remarks: int

    def without_comments(self, text: str) -> str:
        """Empty the lines that are comments; a sign within a line is part of its cell."""
        if self.comment not in text:
            return text
        return re.sub(rf"(?<![^\r\n])[ \t]*{re.escape(self.comment)}[^\r\n]*", "", text)

    @property
    def n_named(self) -> int:
        """Cells of a row up to the last column that has a name."""
        return max((place for place, name in enumerate(self.names, start=1) if name), default=0)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Line:
    number: int
    cells: list[str]
    is_comment: bool

    @property
    def is_wordy(self) -> bool:
        """Whether no cell is a number: names, units, or text of the instrument."""
        return any(self.cells) and not any(_is_value(cell) for cell in self.cells)

    @property
    def is_row(self) -> bool:
        """Whether more than half of the cells are numbers or times."""
        filled = [cell for cell in self.cells if cell]
        return not self.is_comment and 2 * sum(map(_is_value, filled)) > len(filled)

    @property
    def is_units(self) -> bool:
        """Whether the cells are units: under a header stands what its columns are measured in."""
        filled = [cell for cell in self.cells if cell not in ("", "-")]
        is_short = all(len(bare_unit(cell)) <= 8 for cell in filled)
        return self.is_wordy and is_short and any(is_unit(cell) for cell in filled)


def find_layout(path: Path, lines: list[str], rules: ReadingRules) -> TextLayout:
    """Find out how a table is written, as far as `rules` do not say it.

    Parameters
    ----------
    path : Path
        For errors.
    lines : list of str
        First lines of the file, enough to hold the header and some rows.
    rules : ReadingRules

    Raises
    ------
    InputError
        If there is no header, a name stands there twice, or the numbers can be read in two ways.
    """
    try:
        return _find_layout(path, lines, rules)
    except csv.Error as error:
        raise InputError(f"cannot be read as a table: {error}", where=path, remedy="check that it is text") from error


def _find_layout(path: Path, lines: list[str], rules: ReadingRules) -> TextLayout:
    stated = next((found[1] for line in lines[:1] if (found := _SEP_LINE.match(line))), None)
    separator = rules.separator or stated or _find_separator(lines)
    table = _parsed(lines, separator, skip_first=stated is not None)
    if not table:
        raise InputError("is empty", where=path)
    header = _find_header(path, _behind_labview_headers(table), rules)
    if header is None:
        return _without_header(path, table, separator, rules)
    below = [line for line in table if line.number > header.number]
    unit_line = next((line for line in below[:1] if line.is_units), None)
    rows = [line for line in below if line is not unit_line and not line.is_comment][:_N_JUDGED_ROWS]
    names = _check_names(path, header)
    if names[-1] == _LABVIEW_COMMENT and all(len(line.cells) < len(names) for line in rows):
        names.pop()
    _check_lengths(path, names, rows, separator)
    names += [""] * (max((len(line.cells) for line in rows), default=0) - len(names))
    units = [bare_unit(cell) for cell in unit_line.cells] if unit_line else []
    comments = [line for line in table if line.is_comment]
    n_before = (unit_line or header).number
    return TextLayout(
        names=tuple(names),
        units=tuple((*units, *[""] * len(names))[: len(names)]),
        separator=separator,
        decimal=rules.decimal or _find_decimal(path, rows, separator, rules),
        n_lines_before=n_before,
        comment=next((lines[c.number - 1].lstrip()[0] for c in comments), "#"),
        n_remarks=sum(line.number < header.number for line in table),
    )


def _behind_labview_headers(table: list[_Line]) -> list[_Line]:
    """Leave out the headers of a LabVIEW measurement file, whose lines look like names of columns."""
    ends = [place for place, line in enumerate(table) if line.cells[:1] == [_LABVIEW_END]]
    return table[ends[-1] + 1 :] if ends else table


def _parsed(lines: list[str], separator: str, *, skip_first: bool) -> list[_Line]:
    parsed = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or (skip_first and number == 1):
            continue
        sign = next((sign for sign in COMMENT_SIGNS if line.lstrip().startswith(sign)), None)
        text = line.strip("\r\n") if sign is None else line.strip()[len(sign) :]
        parsed.append(_Line(number=number, cells=split_cells(text, separator), is_comment=sign is not None))
    return parsed


def split_cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line, without the spaces around them."""
    if separator == " ":
        return line.split()
    (cells,) = csv.reader([line], delimiter=separator, skipinitialspace=True)
    return [cell.strip() for cell in cells]


def _find_separator(lines: list[str]) -> str:
    """Return the separator that makes most cells numbers, fits a line of names, and makes most cells, in that order."""
    judged = [line for line in lines if line.strip() and not line.lstrip().startswith(COMMENT_SIGNS)][-_N_JUDGED_ROWS:]
    if not judged:
        return ","

    def score(separator: str) -> tuple[float, bool, int]:
        rows = [split_cells(line, separator) for line in judged]
        numeric = [row for row in rows if any(map(_is_value, row))]
        n_cells = sum(bool(cell) for row in numeric for cell in row)
        share = sum(_is_value(cell) for row in numeric for cell in row) / max(n_cells, 1)
        length = Counter(map(len, numeric)).most_common(1)[0][0] if numeric else 0
        has_names = any(
            line.is_wordy and len(line.cells) == length for line in _parsed(lines, separator, skip_first=False)
        )
        return round(share * len(numeric) / len(rows), 1), has_names, n_cells

    return max(_SEPARATORS, key=score)


def _find_header(path: Path, table: list[_Line], rules: ReadingRules) -> _Line | None:
    """Return the line with the names of the columns, None where the table has none."""
    if rules.header_line == 0:
        return None
    if rules.header_line is not None:
        found = next((line for line in table if line.number == rules.header_line), None)
        if found is None:
            raise InputError(f"line {rules.header_line} is empty", where=path, remedy="correct header_line in the map")
        return found
    lengths = Counter(len(line.cells) for line in table if line.is_row)
    n_cells = lengths.most_common(1)[0][0] if lengths else max(len(line.cells) for line in table)
    first_row = next((line.number for line in table if line.is_row and len(line.cells) == n_cells), None)
    above = [
        line for line in table if line.is_wordy and not line.is_units and (first_row is None or line.number < first_row)
    ]

    def likeness(line: _Line) -> tuple[int, int, bool, int]:
        return -abs(len(line.cells) - n_cells), sum(map(bool, line.cells)), not line.is_comment, line.number

    # Names may look like units, as in "time_s,v", where no other line is above the rows.
    units = [line for line in table if line.is_units and first_row is not None and line.number < first_row]
    return max(above, key=likeness, default=next(iter(units), None))


def _without_header(path: Path, table: list[_Line], separator: str, rules: ReadingRules) -> TextLayout:
    """Return the layout of a table of bare numbers; its columns are known by their places."""
    rows = [line for line in table if not line.is_comment]
    first = next((line for line in rows if line.is_row), table[0])
    names = [str(place) for place in range(1, len(first.cells) + 1)]
    return TextLayout(
        names=tuple(names),
        units=("",) * len(names),
        separator=separator,
        decimal=rules.decimal or _find_decimal(path, rows[:_N_JUDGED_ROWS], separator, rules),
        n_lines_before=first.number - 1,
        comment="#",
        n_remarks=first.number - 1,
    )


def _check_names(path: Path, header: _Line) -> list[str]:
    names = list(header.cells)
    repeated = sorted({name for name in names if name and names.count(name) > 1})
    if repeated:
        raise InputError(
            f"has the column {repeated[0]} more than once",
            where=f"{path}, line {header.number}",
            remedy="rename one, or refer to the columns by position: header_line = 0 in [table] of a map",
        )
    return names


def _check_lengths(path: Path, names: list[str], rows: list[_Line], separator: str) -> None:
    for line in rows:
        n_cells = len(line.cells) - (len(line.cells) > len(names) and not line.cells[-1])
        if n_cells > len(names):
            is_comma = separator == "," and n_cells == 2 * len(names)
            raise InputError(
                f"the row has {n_cells} cells, the header has {len(names)}",
                where=f"{path}, line {line.number}",
                remedy="decimal commas need semicolons between the cells, or quotes around them"
                if is_comma
                else "check the row, and that every column has a name",
            )


def _find_decimal(path: Path, rows: list[_Line], separator: str, rules: ReadingRules) -> str | None:
    """Return the decimal sign of the cells; refuse cells that may hold thousands."""
    cells = [cell for line in rows for cell in line.cells if cell]
    commas = [cell for cell in cells if _DECIMAL_COMMA.match(cell)]
    points = [cell for cell in cells if _DECIMAL_POINT.match(cell)]
    if rules.thousands in (".", ","):
        return "," if rules.thousands == "." else "."
    if rules.thousands is None:
        grouped = [cell for cell in cells if _GROUPED.match(cell)]
        certain = [cell for cell in grouped if not _NUMBER.match(cell)]
        is_unclear = bool(commas) and (bool(points) or all(cell in grouped for cell in commas))
        if certain or is_unclear:
            raise InputError(
                f"contains {(certain or commas)[0]!r}: thousands separator or decimal sign?",
                where=path,
                remedy='state it in a map (--map): [table] decimal = "," or "."; thousands = "." or "," if used',
            )
    if commas:
        return ","
    return "." if points else None


def _is_value(cell: str) -> bool:
    return bool(_NUMBER.match(cell) or _GROUPED.match(cell) or (_CLOCK.match(cell) and cell))
