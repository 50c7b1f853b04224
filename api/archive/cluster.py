"""A batch on a dask cluster; `distributed` is needed here and nowhere else."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any, Final

from sawbench.archive.batch import WorkerDied, attempt
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.bench.source_identity import analysis_identity

Finished = tuple[int, Any, SawbenchError | None]

# Items that wait on the cluster for each of its threads: enough to keep it busy, few enough for the scheduler.
_AHEAD: Final = 4
_TIMEOUT_S: Final = 30


def run_on_cluster(work: Callable[[Any], Any], items: Sequence[Any], address: str) -> Iterator[Finished]:
    """Yield index, value and error of every item as it is finished; see `batch.run_batch`.

    dask gives what a dead worker had to others, and gives an item up (`KilledWorker`) when too many workers died that
    held it, also where it only waited there. Such an item goes again, alone, once all others are done.

    Raises
    ------
    InputError
        If dask is not installed, nobody answers at the address, or the workers run another sawbench.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "--scheduler needs dask, which is not installed", remedy="pip install 'sawbench[cluster]'"
        ) from error
    try:
        client = Client(address, timeout=_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no dask scheduler answers: {error}", where=address, remedy="start one with `dask scheduler`"
        ) from error
    with client:
        n_ahead = _AHEAD * _threads(client, address)
        suspects: list[int] = []
        for index, value, error in _finished(client, work, items, range(len(items)), n_ahead):
            if isinstance(error, WorkerDied):
                suspects.append(index)
            else:
                yield index, value, error
        yield from _finished(client, work, items, suspects, 1)


def _threads(client: Any, address: str) -> int:
    """Threads of all workers, which must run this sawbench."""
    try:
        client.wait_for_workers(1, timeout=_TIMEOUT_S)
    except TimeoutError as error:
        raise InputError(
            "the scheduler has no worker", where=address, remedy=f"start one with `dask worker {address} --nthreads 1`"
        ) from error
    ours = analysis_identity()
    for worker, theirs in client.run(analysis_identity, on_error="return").items():
        if theirs != ours:
            raise InputError(
                f"the worker {worker} runs {theirs}, this is {ours}",
                where=address,
                remedy="install the same sawbench on every machine of the cluster",
            )
    return max(1, sum(client.nthreads().values()))


def _finished(
    client: Any, work: Callable[[Any], Any], items: Sequence[Any], wanted: Sequence[int], n_ahead: int
) -> Iterator[tuple[int, Any, Any]]:
    """Submit items, a few ahead of those that are finished, and yield each with its value and error."""
    from distributed import CancelledError, KilledWorker, as_completed

    left = iter(wanted)
    index_of: dict[Any, int] = {}

    def submit(n: int) -> list[Any]:
        begun = {client.submit(attempt, work, items[index], pure=False): index for index in islice(left, n)}
        index_of.update(begun)
        return list(begun)

    first = submit(n_ahead)
    running: Any = as_completed(first, loop=client.loop) if first else ()
    for future in running:
        for following in submit(1):
            running.add(following)
        index = index_of.pop(future)
        try:
            value, error = future.result()
        except KilledWorker:
            value, error = None, WorkerDied(items[index])
        except CancelledError as gone:
            raise SawbenchError(
                "the connection to the scheduler was lost",
                remedy="start it again and run the same command: it continues where it stopped",
            ) from gone
        yield index, value, error
