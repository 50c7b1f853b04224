"""Worker processes on this machine, each with one item at a time, so that it is known what a dead one died over.

`concurrent.futures` fails every waiting item when a worker dies and does not say which item it was.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any, Final

from sawbench.archive.batch import DEATHS_ALLOWED, WorkerDied, attempt
from sawbench.bench.errors import SawbenchError

Finished = tuple[int, Any, SawbenchError | None]

# Where each core has a worker, more threads than one in each only get in each other's way.
_ONE_THREAD: Final = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL", "NUMBA")}


class _Worker:
    """One process and the index of the item it works on."""

    def __init__(self, work: Callable[[Any], Any]) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, work), daemon=True)
        self.process.start()
        theirs.close()  # from here on the end of the process closes the pipe
        self.index: int | None = None

    def give(self, index: int, item: Any) -> None:
        """Send an item; a worker that is dead already shows when its answer is read."""
        self.index = index
        with suppress(OSError):
            self.pipe.send(item)

    def end(self) -> None:
        """End the process, whatever it does."""
        self.process.terminate()
        self.process.join()
        self.pipe.close()


def run_in_processes(work: Callable[[Any], Any], items: Sequence[Any], n_workers: int) -> Iterator[Finished]:
    """Yield index, value and error of every item as it is finished; see `batch.run_batch`."""
    waiting, deaths = deque(range(len(items))), Counter[int]()
    with _one_thread_each():
        workers = [_Worker(work) for _ in range(n_workers)]
        try:
            while True:
                for worker in workers:
                    if worker.index is None and waiting:
                        index = waiting.popleft()
                        worker.give(index, items[index])
                busy = {worker.pipe: worker for worker in workers if worker.index is not None}
                if not busy:
                    return
                for pipe in wait(list(busy)):
                    worker = busy[pipe]  # pyright: ignore[reportArgumentType]
                    index, worker.index = worker.index, None
                    assert index is not None
                    try:
                        yield index, *worker.pipe.recv()
                    except (EOFError, OSError):
                        worker.end()
                        workers[workers.index(worker)] = _Worker(work)
                        deaths[index] += 1
                        if deaths[index] >= DEATHS_ALLOWED:
                            yield index, None, WorkerDied(items[index])
                        else:
                            waiting.appendleft(index)
        finally:
            for worker in workers:
                worker.end()


def _serve(pipe: Connection, work: Callable[[Any], Any]) -> None:
    """Answer every item until the pipe is closed; Ctrl-C is the parent's to handle."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, OSError):
        while True:
            pipe.send(attempt(work, pipe.recv()))


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let the processes that are started inside inherit one thread each; what the user set is left alone."""
    added = {name: value for name, value in _ONE_THREAD.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)
