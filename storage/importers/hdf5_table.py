"""A table as HDF5: one-dimensional datasets, in any group."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.storage.importers.raw_table import RawColumn, RawTable


def read_hdf5_table(path: Path) -> RawTable:
    """Read the numeric vectors of an HDF5 file, MATLAB's 7.3 among them.

    Parameters
    ----------
    path : Path
        Datasets are named with their groups, joined with points; an attribute `unit` or `units` is the unit the
        file states. One row or one column of a matrix is a vector too.

    Raises
    ------
    InputError
        If the file is missing or no HDF5.
    """
    import h5py

    columns: dict[str, RawColumn] = {}

    def take(full_name: str, item: object) -> None:
        if not isinstance(item, h5py.Dataset) or full_name.startswith("#"):
            return
        if item.dtype.kind not in "fiu" or not 1 < (item.size or 0) == max(item.shape):
            return
        stated = item.attrs.get("unit", item.attrs.get("units", ""))
        unit = stated.decode() if isinstance(stated, bytes) else str(stated)
        stored = np.asarray(item[()]).ravel()
        # The differences of unsigned numbers wrap around.
        whole = (stored - stored[0]).astype(np.float64) if stored.dtype.kind == "i" else None
        columns[full_name.replace("/", ".")] = RawColumn(values=stored.astype(np.float64), unit=unit, since_first=whole)

    if not path.exists():
        raise InputError("no such file", where=path, remedy="check the path")
    try:
        with h5py.File(path, "r") as store:
            store.visititems(take)
    except Exception as error:  # h5py raises OSError, RuntimeError, KeyError and others, as the damage lies
        raise InputError(f"is not an HDF5 file, or is damaged: {error}", where=path) from error
    return RawTable(path=path, columns=columns)
