"""The channels of an ASAM MDF file (MF4), each on its own time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.storage.importers.raw_table import RawColumn, RawTable
from sawbench.storage.importers.table import FramesNeedDbc


def read_mf4_signals(path: Path) -> RawTable:
    """Read the numeric channels of an MF4 file.

    Returns
    -------
    RawTable
        A channel that the file holds in several groups is named with each of them: `group2.Fz`.

    Raises
    ------
    InputError
        If the file is not an MF4 file or has no channel.
    FramesNeedDbc
        If it holds CAN frames instead of channels.
    """
    from asammdf import MDF

    if not path.exists():
        raise InputError("no such file", where=path, remedy="check the path")
    try:
        measurement = MDF(path)
    except Exception as error:  # asammdf raises whatever its parser stumbles over
        raise InputError(f"is not an MF4 file, or is damaged: {error}", where=path) from error
    with measurement:
        if any("CAN_DataFrame" in name for name in measurement.channels_db):
            raise FramesNeedDbc(
                "contains CAN frames, not signals", where=path, remedy="give the DBC that describes the frames"
            )
        try:
            columns = _channels(measurement)
        except Exception as error:
            raise InputError(f"is damaged: {error}", where=path) from error
    if not columns:
        raise InputError("has no channel with numbers", where=path)
    return RawTable(path=path, columns=columns)


def _channels(measurement: Any) -> dict[str, RawColumn]:
    columns: dict[str, RawColumn] = {}
    for name, places in measurement.channels_db.items():
        for group, index in places:
            if measurement.masters_db.get(group) == index:
                continue
            found = measurement.get(name, group=group, index=index)
            values = np.asarray(found.samples)
            if values.ndim != 1 or values.dtype.kind not in "fiu" or not len(values):
                continue
            key = name if len(places) == 1 else f"group{group}.{name}"
            columns[key] = RawColumn(
                values=values.astype(np.float64),
                unit=found.unit or "",
                time_s=np.asarray(found.timestamps, dtype=np.float64),
            )
    return columns
