"""Which code is running: version, commit, and a hash of the sources that decide a diagnosis."""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[1]
_JUDGING: Final = (
    "bench",
    "storage",
    "processing",
    "modeling",
    "diagnosis",
    "commands/diagnose.py",
    "commands/import_.py",
    "commands/options.py",
)


_ANALYSING: Final = ("bench", "storage", "processing", "modeling")


def source_fingerprint(names: Iterable[str] = _JUDGING) -> str:
    """Return SHA-256 over names and contents of source files, hexadecimal.

    Parameters
    ----------
    names : iterable of str
        Folders and files, relative to the package; default: those that decide a diagnosis.
    """
    total = hashlib.sha256()
    for path in _sources(names):
        total.update(path.relative_to(ROOT).as_posix().encode() + b"\0")
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


@cache
def analysis_identity() -> str:
    """Return version and hash of the sources that decide what is found in a recording, such as "0.1.0+9f86d081884c"."""
    from importlib.metadata import version

    return f"{version('sawbench')}+{source_fingerprint(_ANALYSING)[:12]}"


def software_identity() -> dict[str, Any]:
    """Return version, commit, whether the judging sources differ from that commit, and their fingerprint.

    Returns
    -------
    dict
        `version`, `commit` and `is_dirty` (None outside of a git checkout), `source_sha256`.
    """
    from importlib.metadata import version

    commit = _git("rev-parse", "HEAD")
    changes = _git("status", "--porcelain", "--", *_JUDGING) if commit else None
    return {
        "version": version("sawbench"),
        "commit": commit,
        "is_dirty": None if changes is None else bool(changes),
        "source_sha256": source_fingerprint(),
    }


def _sources(names: Iterable[str]) -> list[Path]:
    found: list[Path] = []
    for name in names:
        place = ROOT / name
        inside = [place] if place.is_file() else sorted(place.rglob("*"))
        found += [p for p in inside if p.is_file() and "__pycache__" not in p.parts and p.suffix != ".part"]
    return found


def _git(*arguments: str) -> str | None:
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
