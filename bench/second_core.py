"""Part of a list of work on a second core, in a forked process: for a command, which alone knows what else runs.

Nothing is copied on the way there; what comes back is pickled. Off unless the command says `second_core`, and where
the system cannot fork safely or has one core.
"""

from __future__ import annotations

import copyreg
import os
import pickle
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType
from typing import IO, Any, NoReturn, TypeVar

T = TypeVar("T")
R = TypeVar("R")

_is_allowed: ContextVar[bool] = ContextVar("_is_allowed", default=False)


@contextmanager
def second_core() -> Iterator[None]:
    """Let `on_two_cores` fork inside this block."""
    token = _is_allowed.set(True)
    try:
        yield
    finally:
        _is_allowed.reset(token)


def on_two_cores(work: Callable[[T], R], items: Sequence[T], *, known: Sequence[Any] = ()) -> list[R]:
    """Work on every item, the last ones in a forked process where that is allowed: whoever is free takes the next.

    Parameters
    ----------
    work : callable
        Takes an item; what it returns must be picklable, but for `known`. It may do nothing but return.
    items : sequence
    known : sequence, optional
        Objects that both processes have: where one is part of what is returned, it comes back as itself.

    Returns
    -------
    list
        In the order of the items. What the other process fails at, this one does again, so errors are raised here.

    Warns
    -----
    RuntimeWarning
        What the other process found cannot be pickled: this one does it again.

    Examples
    --------
    >>> with second_core():
    ...     on_two_cores(abs, [-1, 2, -3])
    [1, 2, 3]
    """
    if len(items) < 2 or not _is_allowed.get() or sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2:
        return [work(item) for item in items]
    # One ticket for every item but the first of each side: this process goes up the list, the other one down, and where
    # the tickets end they have met.
    tickets = os.eventfd(len(items) - 2, os.EFD_SEMAPHORE | os.EFD_NONBLOCK)
    with os.fdopen(os.memfd_create("found"), "w+b") as there:
        with warnings.catch_warnings():  # from Python 3.12 on: of threads, which here wait or draw the progress
            warnings.simplefilter("ignore", DeprecationWarning)
            pid = os.fork()
        if pid == 0:
            _write_and_end(there, work, items[::-1], tickets, known)
        try:
            ours = _share(work, items, tickets)
            is_whole = os.waitpid(pid, 0)[1] == 0
        except BaseException:
            os.kill(pid, signal.SIGKILL)  # nobody waits for it any more
            os.waitpid(pid, 0)
            raise
        finally:
            os.close(tickets)
        theirs = _read(there, known) if is_whole else None
    return [*ours, *([work(item) for item in items[len(ours) :]] if theirs is None else reversed(theirs))]


def _share(work: Callable[[T], R], items: Sequence[T], tickets: int) -> list[R]:
    """Work on the first item, and on the next one for every ticket that is left."""
    found = [work(items[0])]
    while _took_one_of(tickets):
        found.append(work(items[len(found)]))
    return found


def _took_one_of(tickets: int) -> bool:
    try:
        return bool(os.eventfd_read(tickets))
    except BlockingIOError:
        return False


def _write_and_end(
    file: IO[bytes], work: Callable[[T], R], items: Sequence[T], tickets: int, known: Sequence[Any]
) -> NoReturn:  # fmt: skip
    """In the forked process: work, write what is found, and end without what Python does at an end.

    The exit status is 0 where all of it is written.
    """
    try:
        found = _share(work, items, tickets)
        try:
            _Pickler(file, known).dump(found)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            file.seek(0)
            file.truncate()
            _Pickler(file, ()).dump(f"{type(error).__name__}: {error}")
        file.flush()
        os._exit(0)
    finally:
        os._exit(1)


class _Pickler(pickle.Pickler):
    """Writes objects that the other side has as their place in the list of them."""

    def __init__(self, file: IO[bytes], known: Sequence[Any]) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self.dispatch_table = copyreg.dispatch_table | {MappingProxyType: _reduced}
        self._places = {id(one): place for place, one in enumerate(known)}

    def persistent_id(self, obj: Any) -> int | None:
        return self._places.get(id(obj))


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: IO[bytes], known: Sequence[Any]) -> None:
        super().__init__(file)
        self._known = known

    def persistent_load(self, pid: int) -> Any:
        return self._known[pid]


def _reduced(mapping: Mapping[Any, Any]) -> tuple[Any, tuple[Any, ...]]:
    """Give what pickle needs of a read-only mapping, which it cannot write by itself."""
    return _read_only, (dict(mapping),)


def _read_only(values: dict[Any, Any]) -> Mapping[Any, Any]:
    return MappingProxyType(values)


def _read(file: IO[bytes], known: Sequence[Any]) -> list[Any] | None:
    file.seek(0)
    found = _Unpickler(file, known).load()
    if isinstance(found, str):
        warnings.warn(f"done twice, because it could not be sent: {found}", RuntimeWarning, stacklevel=3)
        return None
    return found
