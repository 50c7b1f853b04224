"""Lines of text from an instrument -> numbers; what could not be read is counted, never guessed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

import numpy as np
from sawbench.acquisition.devices.row_instrument import Rows

NUMBER: Final = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
# The first number of a line, behind a label that ends in a colon: "Reading: 12.5 kg"; with nothing grown onto it, and
# no comma or space in front of further digits, which may be of the same number: "12,5", "1 234".
LABELLED_NUMBER: Final = re.compile(rf"^(?:.*?:)?\s*({NUMBER})(?=$|[;|\t]|,(?!\d)|\s(?! *\d))")
_NUMBER: Final = re.compile(NUMBER)
_DIGIT: Final = re.compile(r"\d")
_LINE_END: Final = re.compile(r"[\r\n]")
_LONGEST_LINE: Final = 4096


@dataclass(frozen=True, kw_only=True, slots=True)
class LineFormat:
    r"""Where the numbers are in a line.

    Attributes
    ----------
    columns : tuple of int
        Columns to read, from 1.
    separator : str or None
        Between columns; None: any white space.
    pattern : Pattern or None
        Regular expression whose groups are the columns, in place of a separator.
    line_end : str
        Spaces and control characters around a line mean nothing, so that "\r" does for "\r\n" too.
    has_decimal_comma : bool

    Examples
    --------
    >>> LineFormat(columns=(1, 3), separator=";", has_decimal_comma=True).numbers("1,5; x ;-2e3")
    (1.5, -2000.0)
    """

    columns: tuple[int, ...]
    separator: str | None = None
    pattern: re.Pattern[str] | None = None
    line_end: str = "\n"
    has_decimal_comma: bool = False

    def numbers(self, line: str) -> tuple[float, ...] | None:
        """Return the numbers in the columns; None where the line is another one."""
        if self.pattern is not None:
            found = self.pattern.search(line)
            cells = found.groups() if found else ()
        else:
            cells = tuple(line.split(self.separator))
        if len(cells) < max(self.columns):
            return None
        texts = [(cells[column - 1] or "").strip() for column in self.columns]
        if self.has_decimal_comma:
            texts = [text.replace(",", ".") for text in texts]
        # Python's float() would take "1_0" and "infinity" too.
        if not all(_NUMBER.fullmatch(text) for text in texts):
            return None
        return tuple(map(float, texts))


class LineFramer:
    r"""Bytes in, numbers out.

    Parameters
    ----------
    line_format : LineFormat
    is_begun : bool
        The next byte begins a line; otherwise the first line may have begun before, and is never used.

    Notes
    -----
    A line without a digit, or that ends in a colon, is a label and
    no sample; any other line that does not fit is a lost sample. What cannot be told: a digit that became another.

    Examples
    --------
    >>> framer = LineFramer(LineFormat(columns=(1,)))
    >>> [piece.values[:, 0].tolist() for piece in framer.feed(b"5\r\n12.5\r\nReadings:\r\n13\r\n1")]
    [[12.5, 13.0]]
    >>> framer.feed(b"\xb4.0\r\n15\r\n"), framer.n_discarded_bytes
    ([Rows(values=array([[15.]]), n_lost=1)], 6)
    """

    def __init__(self, line_format: LineFormat, *, is_begun: bool = False) -> None:
        self._format = line_format
        self._end = line_format.line_end.encode()
        self._rest = b""
        self._is_begun = is_begun
        self._n_lost = 0
        self.n_discarded_bytes = 0

    def feed(self, received: bytes) -> list[Rows]:
        """Return the lines that `received` completes."""
        *lines, self._rest = (self._rest + received).split(self._end)
        if len(self._rest) > _LONGEST_LINE:
            self._discard(self._rest)
            self._rest = b""
        if lines and not self._is_begun:
            self._is_begun = True
            del lines[0]
        pieces: list[Rows] = []
        rows: list[tuple[float, ...]] = []
        n_lost_before = 0
        for line in lines:
            row = self._read(line)
            if row is None:
                continue
            if self._n_lost and rows:
                pieces.append(Rows(np.array(rows), n_lost_before))
                rows = []
            if not rows:
                n_lost_before, self._n_lost = self._n_lost, 0
            rows.append(row)
        if rows:
            pieces.append(Rows(np.array(rows), n_lost_before))
        return pieces

    def _read(self, line: bytes) -> tuple[float, ...] | None:
        # What is no ASCII becomes a character that fits no number.
        text = line.decode("ascii", "replace").strip("\0\r\n\t ")
        # A line end inside: two lines grew together.
        row = None if _LINE_END.search(text) else self._format.numbers(text)
        is_label = text.isascii() and (text.endswith(":") or not _DIGIT.search(text))
        if row is None and not is_label:
            self._discard(line)
            self._n_lost += 1
        return row

    def _discard(self, line: bytes) -> None:
        self.n_discarded_bytes += len(line) + len(self._end)
