"""The one way this package compiles a function to machine code.

numba keeps compiled code on disk and renews it when the function's own file changes, but not when a constant
or a function that it takes from another file changes. Here the folder of compiled code is named after the
text of every file that compiles instead, so that an upgrade can never run a mixture of old and new physics.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba

# No "nnan" and "ninf": the kernels test for a step that went wrong.
_SAFE_FAST = {"contract", "nsz", "arcp", "afn", "reassoc"}


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function with numba: on disk between runs, without the interpreter's lock, IEEE division.

    Parameters
    ----------
    **options
        Passed on to `numba.njit`, on top of the package's own.

    Returns
    -------
    callable
        A decorator.
    """

    def compile_(function: Callable[..., Any]) -> Any:
        settings = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": _SAFE_FAST, **options}
        before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        numba.config.CACHE_DIR = str(_folder())  # type: ignore[attr-defined]
        try:
            return numba.njit(**settings)(function)
        finally:
            numba.config.CACHE_DIR = before  # type: ignore[attr-defined]

    return compile_


@cache
def _folder() -> Path:
    """Return a writable folder named after the source text of the package."""
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for source in sorted(package.rglob("*.py")):
        text = source.read_bytes()
        if b"modeling.compilation" in text or source.name == "slots.py":
            digest.update(text)
    name = f"kernels-{digest.hexdigest()[:16]}"
    places = [
        os.environ.get("NUMBA_CACHE_DIR"),
        package / "__pycache__",
        Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "sawbench",
    ]
    for place in places:
        if place is None:
            continue
        folder = Path(place) / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return Path(tempfile.gettempdir()) / f"sawbench-{name}"
