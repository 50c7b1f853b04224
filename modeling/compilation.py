"""The one way this package compiles a function to machine code.

numba keeps compiled code on disk and renews it when the function's own file changes, but not when a constant
or a function that it takes from another file changes. Here the folder of compiled code is named after the
text of every file that compiles instead, so that an upgrade can never run a mixture of old and new physics.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import CellType, FunctionType, ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any

import numba
from numba.core import event
from numba.core.dispatcher import Dispatcher

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

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
    _announce_compilation()

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
def _announce_compilation() -> None:
    """Say so once on a terminal when the first compilation has taken over a second."""
    if sys.stderr.isatty():
        event.register("numba:compile", _Announcement())


class _Announcement(event.Listener):
    """Watches the time since the outermost compilation began."""

    def __init__(self) -> None:
        self._depth = 0
        self._began_s = 0.0
        self._is_said = False

    def on_start(self, event: Any) -> None:
        """Begin to count, or say that it takes long."""
        del event
        now_s = time.monotonic()
        if self._depth == 0:
            self._began_s = now_s
        elif not self._is_said and now_s - self._began_s > 1.0:
            sys.stderr.write("compiling the model, once per installation\n")
            self._is_said = True
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """One compilation is through."""
        del event
        self._depth -= 1


@cache
def interpreted(function: Any) -> Callable[..., Any]:
    """Give the same function to the interpreter: for arrays of machines, or for one run that is not worth compiling.

    Every compiled function that it calls, by name, through a module of the package or from a closure, is replaced too,
    so nothing is compiled. What branches on a quantity takes one machine at a time.

    Parameters
    ----------
    function : compiled function

    Returns
    -------
    callable
    """
    plain = function.py_func
    code = plain.__code__
    names = {name: plain.__globals__[name] for name in code.co_names if name in plain.__globals__}
    replaced = {name: _uncompiled(value) for name, value in names.items()}
    cells = tuple(CellType(_uncompiled(cell.cell_contents)) for cell in plain.__closure__ or ())
    return FunctionType(code, plain.__globals__ | replaced, plain.__name__, plain.__defaults__, cells)


def runner(function: Any, vector: NDArray[np.float64], compiles: bool) -> tuple[Callable[..., Any], Any]:
    """Return a kernel, compiled or interpreted, and its parameter vector in the form that runs fastest.

    Parameters
    ----------
    function : compiled function
    vector : ndarray, shape (n,)
    compiles : bool

    Returns
    -------
    callable
    ndarray or list of float
        Numbers of Python are faster to interpret than those of numpy.
    """
    return (function, vector) if compiles else (interpreted(function), vector.tolist())


def _uncompiled(value: Any) -> Any:
    if isinstance(value, Dispatcher):
        return interpreted(value)
    if isinstance(value, ModuleType) and value.__name__.startswith("sawbench."):
        return SimpleNamespace(**{name: _uncompiled(v) for name, v in vars(value).items() if not name.startswith("_")})
    return value


@cache
def _folder() -> Path:
    """Return a writable folder named after the source text of the package."""
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for source in sorted(package.rglob("*.py")):
        text = source.read_bytes()
        if b"sawbench.modeling.compilation" in text or source.name == "slots.py":
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
