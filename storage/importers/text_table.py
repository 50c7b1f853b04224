"""A table as text, as laboratories export it: any encoding, separator and decimal sign, with or without remarks."""

from __future__ import annotations

import gzip
import re
import warnings
import zlib
from dataclasses import replace
from io import BytesIO, StringIO
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats
from sawbench.storage.importers.clock_times import clock_times
from sawbench.storage.importers.raw_table import RawColumn, RawTable
from sawbench.storage.importers.table_map import ReadingRules
from sawbench.storage.importers.text_layout import TextLayout, find_layout
from sawbench.storage.importers.text_rows import TextRows, without_cut_line
from sawbench.storage.importers.unit_conversion import split_unit

if TYPE_CHECKING:
    from datetime import tzinfo

    import pandas as pd

_MARKS: Final = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
_N_PROBED_LINES: Final = 1000
_MANY_DIGITS: Final = 1e9
_N_PROBED_CHARACTERS: Final = 1_000_000
_MOST_BYTES: Final = 4_000_000_000
# As pandas says it.
_TOO_LONG: Final = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")


def read_text_table(path: Path, rules: ReadingRules | None = None) -> RawTable:
    """Read a table written as text, plain or packed with gzip.

    Parameters
    ----------
    path : Path
    rules : ReadingRules, optional
        What cannot be seen in the file itself.

    Returns
    -------
    RawTable
        An empty cell or "nan" is NaN. Of a table without a header the columns are named "1", "2", ...

    Raises
    ------
    InputError
        If the file is missing, is no text, has a row that is too long or too short, or its numbers can be read in two
        ways.
    """
    rules = rules or ReadingRules()
    text, encoding = _decode(path, _read_bytes(path), rules)
    if rules.thousands is not None and rules.thousands.isspace():  # would be taken for a separator
        text = re.sub(rf"(?<=\d){rules.thousands}(?=\d{{3}}(?!\d))", "", text)
    layout = find_layout(path, _first_lines(text), rules)
    text, warning = without_cut_line(text, layout)
    text = layout.without_comments(text)
    rows = TextRows(path=path, text=text, layout=layout)
    decimal = layout.decimal or "."
    frame = _frame(path, text, layout, decimal, rules)
    if layout.decimal is None and any(frame[position].dtype.kind not in "fiu" for position in frame):
        # No fraction in the first lines: the sign shows only further down.
        other = _frame(path, text, layout, ",", rules)
        if sum(c.dtype.kind in "fiu" for _, c in other.items()) > sum(c.dtype.kind in "fiu" for _, c in frame.items()):
            frame, decimal = other, ","
    if layout.n_named and bool(frame[layout.n_named - 1].isna().to_numpy().any()):
        rows.refuse_short()
    columns = {}
    named = zip(layout.names, layout.units, frame.items(), strict=True)
    for position, (name, unit, (_, cells)) in enumerate(named, start=1):
        if name or not bool(cells.isna().to_numpy().all()):
            column = name or str(position)
            found = _column(rows, column, unit or split_unit(name)[1], cells, decimal, rules.zone)
            if cells.dtype.kind in "fi" and abs(cells.iloc[0]) >= _MANY_DIGITS:
                texts = _frame(path, text, layout, decimal, rules, as_text=position - 1).iloc[:, 0]
                found = replace(found, since_first=_since_first(texts, decimal))
            columns[column] = found
    return RawTable(
        path=path,
        columns=columns,
        notes=_notes(layout, encoding, decimal),
        warnings=(warning,) if warning else (),
        place=rows.place,
    )


def _first_lines(text: str) -> list[str]:
    """Return the first lines, whatever ends them; not one that is cut."""
    head = StringIO(text[:_N_PROBED_CHARACTERS], newline=None)
    lines = list(islice(head, _N_PROBED_LINES))
    is_cut = len(text) > _N_PROBED_CHARACTERS and len(lines) < _N_PROBED_LINES
    return lines[:-1] if is_cut and len(lines) > 1 else lines


def _read_bytes(path: Path) -> bytes:
    try:
        if path.suffix.lower() != ".gz":
            return path.read_bytes()
        with gzip.open(path) as stream:
            content = stream.read(_MOST_BYTES + 1)
    except FileNotFoundError:
        raise InputError("no such file", where=path, remedy="check the path") from None
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"cannot be read: {getattr(error, 'strerror', None) or error}", where=path) from error
    if len(content) > _MOST_BYTES:
        raise InputError(f"has more than {_MOST_BYTES / 1e9:g} GB of text", where=path, remedy="split the file")
    return content


def _decode(path: Path, content: bytes, rules: ReadingRules) -> tuple[str, str]:
    """Return the text and the name of its encoding: the stated one, that of its byte order mark, or what fits."""
    marked = next((name for mark, name in _MARKS if content.startswith(mark)), None)
    head = content[:2000]
    without_mark = "utf-16-le" if head[1::2].count(0) > len(head) // 4 else None
    if head[::2].count(0) > len(head) // 4:
        without_mark = "utf-16-be" if without_mark is None else None
    candidates = [name for name in (rules.encoding, marked, without_mark) if name] or ["utf-8", "cp1252", "latin-1"]
    for encoding in candidates:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        except LookupError:
            raise InputError(f"encoding {encoding!r} is unknown", where=path, remedy="correct it in the map") from None
        if "\0" in text:
            break
        return text, encoding
    raise InputError(
        "cannot be read as text: it has invalid bytes",
        where=path,
        remedy='state its encoding in a map (--map): [table] encoding = "latin-1"',
    )


def _frame(
    path: Path, text: str, layout: TextLayout, decimal: str, rules: ReadingRules, *, as_text: int | None = None
) -> pd.DataFrame:  # fmt: skip
    """All columns, or the text of the cells of a single one."""
    import pandas as pd

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # cells that would be dropped
            frame = pd.read_csv(
                BytesIO(text.encode()),
                sep=r"\s+" if layout.separator == " " else layout.separator,
                decimal=decimal,
                thousands=None if rules.thousands is None or rules.thousands.isspace() else rules.thousands,
                header=None,
                names=list(range(len(layout.names))),
                skiprows=layout.n_lines_before,
                index_col=False,
                skipinitialspace=True,
                low_memory=False,
                usecols=None if as_text is None else [as_text],
                dtype=None if as_text is None else str,
            )
    except (pd.errors.ParserError, pd.errors.ParserWarning, pd.errors.EmptyDataError) as error:
        if isinstance(error, pd.errors.EmptyDataError):
            raise InputError("has a header but no data rows", where=path) from error
        long = _TOO_LONG.search(str(error))
        if long is not None:
            needed, line, got = long.groups()
            raise InputError(
                f"the row has {got} cells, the header has {needed}", where=f"{path}, line {line}",
                remedy="check the row, and that every column has a name",
            ) from error  # fmt: skip
        raise InputError(f"cannot be read as a table: {error}".rstrip("\n"), where=path) from error
    if frame.empty:
        raise InputError("has a header but no data rows", where=path)
    return frame


def _column(
    rows: TextRows, name: str, unit: str, cells: pd.Series, decimal: str, zone: tzinfo | None
) -> RawColumn:  # fmt: skip
    if cells.dtype.kind in "fiu":
        return RawColumn(values=cells.to_numpy(dtype=np.float64), unit=unit)
    on_clock = clock_times(cells, zone)
    if on_clock is not None:
        return RawColumn(values=on_clock[0], unit="s", first=on_clock[1])
    problem = InputError(f"column {name} does not contain numbers", where=rows.path)
    # One cell that is no number leaves all of its column as text.
    for row, cell in enumerate(cells.tolist()):
        if isinstance(cell, str) and not _is_number(cell, decimal):
            remedy = "use a point as decimal sign, or semicolons between the cells" if "," in cell else None
            problem = InputError(
                f"column {name} has {cell!r}, not a number",
                where=f"{rows.path}, {rows.place(row)}",
                remedy=remedy or "correct the cell, or leave it empty where the sample is missing",
            )
            break
    return RawColumn(values=np.full(len(cells), np.nan), unit=unit, problem=problem)


def _since_first(cells: pd.Series, decimal: str) -> Floats | None:
    """Numbers with more digits than a float64 holds, less the first one; None where they are not plain digits."""
    parts = cells.str.partition(decimal)
    try:
        whole = parts[0].to_numpy(dtype=np.int64)
        fraction = ("0." + parts[2].fillna("")).to_numpy(dtype=np.float64)
    except (ValueError, TypeError):
        return None
    return (whole - whole[0]) + (fraction - fraction[0])


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell if decimal == "." else cell.replace(".", " ").replace(decimal, "."))
    except ValueError:
        return False
    return True


def _notes(layout: TextLayout, encoding: str, decimal: str) -> tuple[str, ...]:
    """Say how the text was read where that is not what every program writes."""
    said = []
    if encoding not in ("utf-8", "utf-8-sig"):
        said.append(f"read as {encoding}")
    if decimal == ",":
        said.append("decimal commas read as points")
    if layout.n_remarks:
        said.append(f"{layout.n_remarks} lines before the header left out")
    if any(layout.units):
        said.append("a row of units under the header")
    return tuple(said)
