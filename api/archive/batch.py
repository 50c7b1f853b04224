"""One piece of work on many items: in this process, in several, or on a cluster; a bad item costs only itself."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Generic, TypeVar, cast

from sawbench.bench.errors import InputError, SawbenchError

T = TypeVar("T")
R = TypeVar("R")

# A worker that dies may have been killed from outside; one that dies twice over the same item dies of it.
DEATHS_ALLOWED: Final = 2
# So many recordings are worth the seconds that compiling the runtime takes each worker.
WORTH_COMPILING: Final = 50


class WorkerDied(SawbenchError):
    """The worker died over an item more often than chance explains (exit code 1)."""

    def __init__(self, item: object) -> None:
        super().__init__(
            "the worker process died repeatedly on this file: out of memory, or a crash of a library",
            where=str(item),
            remedy="run it alone on a machine with more memory, or inspect the file with `sawbench info`",
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class Workers:
    """Where a batch is worked on.

    Attributes
    ----------
    jobs : int
        Processes on this machine; 1 works in this process.
    scheduler : str or None
        Address of a dask scheduler, such as "tcp://lab:8786"; goes before `jobs`.
    """

    jobs: int = 1
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise InputError(f"--jobs is {self.jobs}, at least 1 is needed")


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome(Generic[T, R]):
    """What became of one item: its value, or the error in its way.

    Attributes
    ----------
    index : int
        Of the item in the batch.
    item : object
    value : object or None
    error : SawbenchError or None
    """

    index: int
    item: T
    value: R | None = None
    error: SawbenchError | None = None

    def result(self) -> R:
        """Return the value, or raise the error."""
        if self.error is not None:
            raise self.error
        return cast("R", self.value)


def run_batch(work: Callable[[T], R], items: Sequence[T], workers: Workers | None = None) -> Iterator[Outcome[T, R]]:
    """Work on every item, each once, and yield what became of it as soon as it is known.

    An item whose work raises, or whose worker dies twice over it, yields its error; the others go on. What a dead
    worker had begun is given to another.

    Parameters
    ----------
    work : callable
        Takes an item. With more than one worker both, and what comes back, must be picklable.
    items : sequence
    workers : Workers, optional
        Default: this process.

    Yields
    ------
    Outcome
        In the order in which they are finished.

    Raises
    ------
    InputError
        If the cluster cannot be used.

    Examples
    --------
    >>> [outcome.value for outcome in run_batch(abs, [-1, 2])]
    [1, 2]
    """
    workers = workers or Workers()
    if workers.scheduler is not None:
        from sawbench.archive.cluster import run_on_cluster

        found = run_on_cluster(work, items, workers.scheduler)
    elif workers.jobs > 1 and len(items) > 1:
        from sawbench.archive.processes import run_in_processes

        found = run_in_processes(work, items, min(workers.jobs, len(items)))
    else:
        found = ((index, *attempt(work, item)) for index, item in enumerate(items))
    for index, value, error in found:
        yield Outcome(index=index, item=items[index], value=value, error=error)


def attempt(work: Callable[[T], R], item: T) -> tuple[R | None, SawbenchError | None]:
    """Return the value of the work and no error, or no value and its error in words."""
    try:
        return work(item), None
    except SawbenchError as error:
        return None, error
    except OSError as error:
        place = error.filename or item
        return None, SawbenchError(f"cannot be read or written: {error.strerror or error}", where=str(place))
    except Exception as error:
        if os.environ.get("SAWBENCH_DEBUG"):
            raise
        return None, SawbenchError(
            f"internal error, please report it: {type(error).__name__}: {error}",
            where=str(item),
            remedy="run it on this file alone with SAWBENCH_DEBUG=1 for the traceback",
        )
