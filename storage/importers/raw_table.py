"""What a file of others holds before anything is taken for a channel: named columns, their units, their times."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final

from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats
from sawbench.storage.importers.clock_times import FirstTime
from sawbench.storage.importers.unit_conversion import split_unit

_N_NAMES_SHOWN: Final = 12


def data_row(row: int) -> str:
    """Say where a row, counted from 0, stands in a file that has no lines.

    Examples
    --------
    >>> data_row(0)
    'data row 1'
    """
    return f"data row {row + 1}"


@dataclass(frozen=True, kw_only=True, slots=True)
class RawColumn:
    """One column as it stands in the file.

    Attributes
    ----------
    values : ndarray, shape (n,)
        NaN where a cell is empty.
    unit : str
        Unit the file states; "" if it states none.
    time_s : ndarray, shape (n,), s, optional
        Of formats in which every channel has times of its own.
    since_first : ndarray, shape (n,), optional
        The values less the first one, with all their digits, where a float64 does not hold these beside the digits
        before the point.
    first : FirstTime, optional
        When the first value was, of times that count from it.
    problem : InputError, optional
        Why the values cannot be used; raised when somebody asks for the column.
    """

    values: Floats
    unit: str = ""
    time_s: Floats | None = None
    since_first: Floats | None = None
    first: FirstTime | None = None
    problem: InputError | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class RawTable:
    """All columns of a file.

    Attributes
    ----------
    path : Path
    columns : mapping of str to RawColumn
        In the order of the file; a name inside groups or structs is joined with points.
    notes : tuple of str
        How the file was read, where that was not plain.
    warnings : tuple of str
        What of the file could not be used.
    place : callable
        Says where a row, counted from 0, stands in the file.
    """

    path: Path
    columns: Mapping[str, RawColumn]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    place: Callable[[int], str] = data_row

    def find(self, wanted: str | int) -> str:
        """Return the name of a column.

        Parameters
        ----------
        wanted : str or int
            Its name, with or without the unit in brackets or the groups before it; or its place, counted from 1.

        Raises
        ------
        InputError
            If there is no such column, or several.
        """
        names = list(self.columns)
        if isinstance(wanted, int):
            if not 1 <= wanted <= len(names):
                raise InputError(
                    f"has no column {wanted}", where=self.path, remedy=f"columns are counted from 1 to {len(names)}"
                )
            return names[wanted - 1]
        if wanted in self.columns:
            return wanted
        path_wanted = wanted.replace("/", ".")
        rules = (
            lambda name: name == path_wanted or name.endswith(f".{path_wanted}"),
            lambda name: split_unit(name)[0] == wanted,
            lambda name: split_unit(name)[0].lower() == split_unit(wanted)[0].lower(),
        )
        for rule in rules:
            found = [name for name in names if rule(name)]
            if len(found) == 1:
                return found[0]
            if found:
                raise InputError(
                    f"has {len(found)} columns {wanted!r}: {', '.join(found)}",
                    where=self.path,
                    remedy="give the full name in the map",
                )
        close = difflib.get_close_matches(wanted, names, n=1, cutoff=0.5)
        raise InputError(
            f"has no column {wanted!r}; its columns are {names_shown(names)}",
            where=self.path,
            remedy=f"did you mean {close[0]!r}?" if close else "correct the column in the map",
        )


def names_shown(names: Collection[str]) -> str:
    """Return names of columns for a message, not more than can be read.

    Examples
    --------
    >>> names_shown(["t", "Fz"])
    't, Fz'
    """
    shown = ", ".join(islice(names, _N_NAMES_SHOWN)) or "no columns"
    return shown + (f" and {len(names) - _N_NAMES_SHOWN} more" if len(names) > _N_NAMES_SHOWN else "")
