"""Reads a file in a process of its own: libraries that end the whole process on a damaged file end only this one."""

from __future__ import annotations

import json
import subprocess
import sys
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.storage.importers.mat_table import read_mat_table
from sawbench.storage.importers.mf4_signals import read_mf4_signals
from sawbench.storage.importers.raw_table import RawColumn, RawTable
from sawbench.storage.importers.table import FramesNeedDbc

_READERS: Final = MappingProxyType({"mat": read_mat_table, "mf4": read_mf4_signals})
_REFUSED: Final = 3


def read_apart(reader: str, path: Path) -> RawTable:
    """Read a table by a library that may crash.

    Parameters
    ----------
    reader : str
        "mat" or "mf4".
    path : Path

    Raises
    ------
    InputError
        As the reader does, and where it crashes.
    FramesNeedDbc
        As the reader does.
    """
    call = [sys.executable, "-m", __name__, reader, str(path)]
    run = subprocess.run(call, capture_output=True, check=False)
    if run.returncode == _REFUSED:
        refusal = json.loads(run.stdout)
        kind = FramesNeedDbc if refusal["needs_dbc"] else InputError
        raise kind(refusal["what"], where=path, remedy=refusal["remedy"])
    if run.returncode != 0:
        raise InputError("is damaged: the reader crashed", where=path, remedy="export it again")
    with np.load(BytesIO(run.stdout)) as found:
        columns = {
            name: RawColumn(values=found[f"values{k}"], unit=unit, time_s=found.get(f"time{k}"))
            for k, (name, unit) in enumerate(zip(found["names"].tolist(), found["units"].tolist(), strict=True))
        }
    return RawTable(path=path, columns=columns)


def _packed(raw: RawTable) -> bytes:
    arrays: dict[str, Any] = {
        "names": np.array(list(raw.columns), dtype=str),
        "units": np.array([column.unit for column in raw.columns.values()], dtype=str),
    }
    for k, column in enumerate(raw.columns.values()):
        arrays[f"values{k}"] = column.values
        if column.time_s is not None:
            arrays[f"time{k}"] = column.time_s
    stream = BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def _main() -> int:
    output, sys.stdout = sys.stdout.buffer, sys.stderr  # what a library prints must not mix with the answer
    try:
        output.write(_packed(_READERS[sys.argv[1]](Path(sys.argv[2]))))
    except InputError as error:
        refusal = {"what": error.what, "remedy": error.remedy, "needs_dbc": isinstance(error, FramesNeedDbc)}
        output.write(json.dumps(refusal).encode())
        return _REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(_main())
