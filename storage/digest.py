"""SHA-256 of files."""

from __future__ import annotations

import hashlib
from pathlib import Path

from sawbench.bench.errors import RecordingError


def sha256_of(path: str | Path) -> str:
    """Return the SHA-256 of a file, hexadecimal.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """
    try:
        with Path(path).open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror or error}", where=path) from error
