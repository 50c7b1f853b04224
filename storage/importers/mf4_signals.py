"""Plain channels of an ASAM MDF file (MF4), each on its own time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bench.errors import InputError
from bench.recording import Signal
from bench.units import CHANNEL_BY_NAME
from storage.importers.table import FramesNeedDbc, Table, signals_of


def read_mf4_signals(path: Path, *, is_idle: bool = False) -> tuple[dict[str, Signal], list[str]]:
    """Read the channels that are named like ours.

    Parameters
    ----------
    path : Path
    is_idle : bool
        As `signals_of`.

    Returns
    -------
    signals : dict of str to Signal
    warnings : list of str
        Also names the channels that were left out.

    Raises
    ------
    InputError
        If the file is no MF4 or holds none of our channels.
    FramesNeedDbc
        If it holds CAN frames instead of channels.
    """
    from asammdf import MDF

    if not path.exists():
        raise InputError("no such file", where=path, remedy="check the path")
    try:
        measurement = MDF(path)
    except Exception as error:  # asammdf raises whatever its parser stumbles over
        raise InputError(f"is no MF4 file, or is damaged: {error}", where=path) from error
    with measurement:
        return _read_channels(path, measurement, is_idle=is_idle)


def _read_channels(path: Path, measurement: Any, *, is_idle: bool) -> tuple[dict[str, Signal], list[str]]:
    names = [name for name in measurement.channels_db if name in CHANNEL_BY_NAME]
    if not names:
        if any("CAN_DataFrame" in name for name in measurement.channels_db):
            raise FramesNeedDbc(
                "holds CAN frames, not signals", where=path, remedy="give the DBC that describes the frames"
            )
        raise InputError(
            f"holds none of the channels {', '.join(CHANNEL_BY_NAME)}",
            where=path,
            remedy="name the channels as sawbench does",
        )
    signals: dict[str, Signal] = {}
    warnings: list[str] = []
    for name in names:
        if len(measurement.channels_db[name]) > 1:
            raise InputError(f"holds the channel {name} more than once", where=path)
        found = measurement.get(name)
        values = np.asarray(found.samples, dtype=np.float64)
        if values.ndim != 1:
            raise InputError(f"channel {name} has the shape {values.shape}, not one value a sample", where=path)
        time_s = np.asarray(found.timestamps, dtype=np.float64)
        if not len(time_s):
            warnings.append(f"channel {name} is empty and left out")
            continue
        table = Table(path=path, time_s=time_s, columns={name: values}, units={name: found.unit or ""})
        taken, said = signals_of(table, is_idle=is_idle)
        signals |= taken
        warnings += said
    left_out = [n for n in measurement.channels_db if n not in CHANNEL_BY_NAME and n.lower() not in ("time", "t")]
    if left_out:
        warnings.append(f"channels that sawbench does not know are left out: {', '.join(sorted(left_out))}")
    return signals, list(dict.fromkeys(warnings))
