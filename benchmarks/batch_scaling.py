"""Many recordings on one worker and on two: `python -m benchmarks --only batch`.

Short trials, a fiftieth of them corrupt, in a folder of this machine; every batch fills an archive of its own, by
processes of this machine and, where dask is installed, by workers of a cluster on it. With a store and a worker that is
killed: `benchmarks.archive`.
"""

from __future__ import annotations

import importlib.util
import os
import resource
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from benchmarks.archive import EVERY_CORRUPT, free_port, process, running, upload, wait_for, workers
from benchmarks.measuring import Clock, Goal, Section, Table, time_words

RECORDINGS, QUICK_RECORDINGS = 300, 100
LEAST_GAIN = 1.7


@contextmanager
def processes(n_workers: int) -> Iterator[tuple[str, str]]:
    """Options of a command that works in processes of this machine."""
    yield "--jobs", str(n_workers)


@contextmanager
def cluster(n_workers: int) -> Iterator[tuple[str, str]]:
    """Run a scheduler and workers; gives the options of a command that uses them."""
    from distributed import Client

    address = f"tcp://127.0.0.1:{(port := free_port())}"
    with ExitStack() as stack:
        stack.enter_context(running("distributed.cli.dask_scheduler", "--port", str(port), "--no-dashboard"))
        wait_for(port)
        stack.enter_context(workers(address, n_workers))
        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(n_workers, timeout=120)
        yield "--scheduler", address


def processor_s() -> float:
    """Processor time of all processes that were started here and have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def timed(folder: Path, archive: Path, options: tuple[str, ...]) -> float:
    """Seconds of a batch, after one that compiled and imported what the workers need."""
    process(str(folder), str(archive.with_name(f"warm-{archive.name}")), *options)
    return process(str(folder), str(archive), *options)[0]


def measure(clock: Clock) -> Section:
    """Processes and cluster workers, one and two of each."""
    n = QUICK_RECORDINGS if clock.quick else RECORDINGS
    rows: list[tuple[str, ...]] = []
    goals: list[Goal] = []
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "recordings"
        upload(n, str(folder))
        ways = [processes, *([cluster] if importlib.util.find_spec("distributed") is not None else [])]
        for started in ways:
            name, seconds = started.__name__, []
            for k in (1, 2):
                with started(k) as options:
                    seconds.append(timed(folder, Path(place) / f"{name}-{k}", options))
                rows.append((f"{k}, {name}", f"{seconds[-1]:.1f} s", f"{n / seconds[-1]:.1f}"))
            ratio = None if clock.busy else seconds[0] / seconds[1]
            goals.append(Goal(what=f"two workers ahead of one, {name}", value=ratio, bound=LEAST_GAIN, at_least=True))
        before_s = processor_s()
        process(str(folder), str(Path(place) / "counted"))
        each_s = (processor_s() - before_s) / n
        again_s = process(str(folder), str(Path(place) / "counted"))[0]
        size = sum(file.stat().st_size for file in (Path(place) / "counted").rglob("*.parquet")) / n
    return Section(
        title="Batch scaling over workers",
        words=[
            f"`process --archive` of {n} trials of 1 s, every {EVERY_CORRUPT}th corrupt, workers warm. "
            f"{time_words(each_s)} of processor time a recording, start and table counted in; a second run, which "
            f"finds everything there, takes {again_s:.1f} s. The archive takes {size / 1e3:.1f} kB a recording."
        ],
        tables=[Table(head=("workers", "time", "recordings a second"), rows=rows)],
        goals=goals,
    )
