"""SHA-256 of files."""

from __future__ import annotations

import hashlib

from sawbench.bench.errors import RecordingError
from sawbench.storage.places import Place, on_disk, place_of


def sha256_of(path: str | Place) -> str:
    """Return the SHA-256 of a file, hexadecimal.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    """
    try:
        with on_disk(place_of(path)) as local, local.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror or error}", where=path) from error
