"""A table as HDF5: one-dimensional datasets named like the channels, in any group."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.errors import InputError
from bench.recording import Floats
from storage.importers.table import Table, take_columns


def read_hdf5_table(path: Path) -> Table:
    """Read the numeric one-dimensional datasets of an HDF5 file.

    Parameters
    ----------
    path : Path
        Datasets take their last name part, so they may sit in a group; an attribute `unit` or `units` is
        the unit the file states.

    Returns
    -------
    Table

    Raises
    ------
    InputError
        If the file is missing or no HDF5, has no `time_s`, or a name in two groups.
    """
    import h5py

    columns: dict[str, Floats] = {}
    units: dict[str, str] = {}

    def take(full_name: str, item: object) -> None:
        if not isinstance(item, h5py.Dataset) or item.ndim != 1 or item.dtype.kind not in "fiu":
            return
        name = full_name.rsplit("/", 1)[-1]
        if name in columns:
            raise InputError(
                f"holds the dataset {name} more than once",
                where=path,
                remedy="put every trial into a file of its own",
            )
        columns[name] = np.asarray(item[()], dtype=np.float64)
        stated = item.attrs.get("unit", item.attrs.get("units", ""))
        units[name] = stated.decode() if isinstance(stated, bytes) else str(stated)

    if not path.exists():
        raise InputError("no such file", where=path, remedy="check the path")
    try:
        with h5py.File(path, "r") as store:
            store.visititems(take)
    except OSError as error:
        raise InputError("is no HDF5 file, or is damaged", where=path) from error
    return take_columns(path, columns, units)
