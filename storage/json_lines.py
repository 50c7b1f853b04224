"""Files of JSON lines to which lines are only added: a journal, amendments."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def append_line(path: Path, fields: Mapping[str, Any]) -> None:
    """Append one line in one piece and wait until it is on the disk.

    A crash leaves the line whole or, at worst, torn at the very end; the next one then restarts.

    Parameters
    ----------
    path : Path
        Its folder is made where it is missing.
    fields : mapping
        Plain values.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    line = json.dumps(dict(fields), ensure_ascii=False, allow_nan=False).encode() + b"\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab+", buffering=0) as file:
        if file.seek(0, os.SEEK_END):
            file.seek(-1, os.SEEK_END)
            if file.read(1) != b"\n":
                line = b"\n" + line
        file.write(line)
        os.fsync(file.fileno())
