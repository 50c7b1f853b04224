"""The rows of a table written as text: the line of each, rows that are too short, and a last one that was cut off."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import Final

from sawbench.bench.errors import InputError
from sawbench.storage.importers.raw_table import data_row
from sawbench.storage.importers.text_layout import TextLayout, split_cells

# A last line is compared with those before it, in so many characters.
_LAST_CHARACTERS: Final = 10_000
_LEAST_LINES: Final = 10
_N_SHOWN_CHARACTERS: Final = 80


@dataclass(frozen=True, kw_only=True, slots=True)
class TextRows:
    """The rows of numbers in a text.

    Attributes
    ----------
    path : Path
        For errors.
    text : str
        All of the file, its comments emptied.
    layout : TextLayout
    """

    path: Path
    text: str
    layout: TextLayout

    def place(self, row: int) -> str:
        """Say where a row, counted from 0, stands in the file."""
        line = next(islice((line for line, _ in self._numbered()), row, None), None)
        return data_row(row) if line is None else f"line {line}"

    def refuse_short(self) -> None:
        """Raise if a row ends before the last column that has a name: which of its cells is missing is unknown.

        Raises
        ------
        InputError
        """
        needed = self.layout.n_named
        for line, cells in self._numbered():
            if len(cells) < needed:
                raise InputError(
                    f"the row has {len(cells)} cells, the header has {needed}",
                    where=f"{self.path}, line {line}",
                    remedy="complete the row; a cell without a value stays empty, between its separators",
                )

    def _numbered(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line and cells of what pandas takes for a row: what is not empty."""
        layout, number = self.layout, 0
        blank = " \r\n" if layout.separator == "\t" else " \t\r\n"

        def lines() -> Iterator[str]:
            nonlocal number
            for number, line in enumerate(StringIO(self.text, newline=None), start=1):
                if number > layout.n_lines_before and line.strip(blank):
                    yield line

        if layout.separator == " ":
            yield from ((number, line.split()) for line in lines())
            return
        try:
            # A cell in quotes may go over several lines.
            for cells in csv.reader(lines(), delimiter=layout.separator, skipinitialspace=True):
                yield number, cells
        except csv.Error as error:
            raise InputError(f"cannot be read as a table: {error}", where=f"{self.path}, line {number}") from error


def without_cut_line(text: str, layout: TextLayout) -> tuple[str, str]:
    """Leave out a last line that was cut off while it was written.

    That is a line with fewer cells than the header; and, if no line end follows, one with fewer cells than every line
    before, or with a last cell that is shorter than in every line before: a number of which digits are missing.

    Parameters
    ----------
    text : str
        All of the file.
    layout : TextLayout

    Returns
    -------
    text : str
    warning : str
        "" where the last line is whole.
    """
    whole = text.rstrip("\r\n")
    start = max(whole.rfind("\n"), whole.rfind("\r")) + 1
    last = whole[start:]
    if not last.strip() or last.startswith(layout.comment):
        return text, ""
    try:
        cells = split_cells(last, layout.separator)
        is_open = len(whole) == len(text)
        is_cut = len(cells) < layout.n_named or (is_open and _is_shorter(cells, text[:start], layout.separator))
    except csv.Error:  # said where the rows are read
        return text, ""
    if not is_cut:
        return text, ""
    line = sum(1 for _ in StringIO(whole, newline=None))
    if line <= layout.n_lines_before:
        return text, ""
    return text[:start], f"line {line}, the last one, is incomplete and left out: {last[:_N_SHOWN_CHARACTERS]!r}"


def _is_shorter(last: list[str], before: str, separator: str) -> bool:
    """Whether a last line has fewer cells, or a shorter last cell, than each of the lines before it."""
    lines = before[-_LAST_CHARACTERS:].splitlines()[1:]
    rows = [split_cells(line, separator) for line in lines if line.strip()]
    if len(rows) + 1 < _LEAST_LINES:
        return False
    return len(last) < min(map(len, rows)) or len(last[-1]) < min(len(row[-1]) for row in rows)
