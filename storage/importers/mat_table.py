"""A MATLAB file: vectors at the top or in structs, up to version 7 by scipy, version 7.3 as the HDF5 it is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.storage.importers.hdf5_table import read_hdf5_table
from sawbench.storage.importers.raw_table import RawColumn, RawTable


def read_mat_table(path: Path) -> RawTable:
    """Read the numeric vectors of a MATLAB file.

    Parameters
    ----------
    path : Path
        A vector in a struct is named with it, `run.force`; one in an array of structs with its number from 1,
        `cycle.3.voltage`; a column of a matrix with its place, `M.1`. The longer side of a matrix holds the samples.

    Raises
    ------
    InputError
        If the file is missing, or is not a MATLAB file.
    """
    import h5py
    from scipy.io import loadmat

    if not path.exists():
        raise InputError("no such file", where=path, remedy="check the path")
    if h5py.is_hdf5(path):
        return read_hdf5_table(path)
    try:
        content = loadmat(path, simplify_cells=True)
    except Exception as error:  # scipy raises whatever its parser stumbles over
        raise InputError(f"is not a MATLAB file, or is damaged: {error}", where=path) from error
    return RawTable(path=path, columns=dict(_vectors(content, "")))


def _vectors(content: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, RawColumn]]:
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from _vectors(value, f"{prefix}{key}.")
        elif isinstance(value, list):
            yield from _vectors({f"{key}.{k}": one for k, one in enumerate(value, start=1)}, prefix)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size > 1:
            if value.size == max(value.shape):
                yield f"{prefix}{key}", RawColumn(values=value.ravel().astype(np.float64))
            elif value.ndim == 2:
                columns = value if value.shape[0] > value.shape[1] else value.T
                for k, column in enumerate(columns.T, start=1):
                    yield f"{prefix}{key}.{k}", RawColumn(values=column.astype(np.float64))
