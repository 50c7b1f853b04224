"""Many recordings on one worker and on two: `python -m benchmarks --only batch`.

Short trials, a fiftieth of them corrupt, in a folder of this machine; every batch fills an archive of its own, by
processes of this machine and, where dask is installed, by workers of a cluster on it. With a store and a worker that is
killed: `benchmarks.archive`. What two workers can gain on this machine is measured in the same run: two commands that
know nothing of each other, each with half of the recordings, against one with all of them.

    python -m benchmarks.batch_scaling [--recordings 300]
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import resource
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

from benchmarks.archive import EVERY_CORRUPT, free_port, process, running, upload, wait_for, workers
from benchmarks.measuring import Clock, Goal, Section, Table, time_words

RECORDINGS, QUICK_RECORDINGS = 200, 100
# So many are enough for a batch that compiles.
WARMING = 60
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
    process(sorted(map(str, folder.glob("*.mcap")))[:WARMING], str(archive.with_name(f"warm-{archive.name}")), *options)
    return process([str(folder)], str(archive), *options)[0]


def half_each(folder: Path, archive: Path) -> float:
    """Seconds until two commands of one process have each done half of a folder; both begin at once."""
    files = sorted(map(str, folder.glob("*.mcap")))

    def seconds(half: int) -> float:
        return process(files[half::2], f"{archive}-{half}")[0]

    with ThreadPoolExecutor(2) as threads:
        return max(threads.map(seconds, range(2)))


def measure(clock: Clock, n: int | None = None) -> Section:
    """Processes and cluster workers, one and two of each."""
    n = n or (QUICK_RECORDINGS if clock.quick else RECORDINGS)
    rows: list[tuple[str, ...]] = []
    goals: list[Goal] = []
    gains: list[str] = []
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
            gains.append(f"{seconds[0] / seconds[1]:.2f} for {name}")
            goals.append(Goal(what=f"two workers ahead of one, {name}", value=ratio, bound=LEAST_GAIN, at_least=True))
        before_s = processor_s()
        alone_s = process([str(folder)], str(Path(place) / "counted"))[0]
        each_s = (processor_s() - before_s) / n
        halves_s = half_each(folder, Path(place) / "half")
        rows += [("one command", f"{alone_s:.1f} s", f"{n / alone_s:.1f}")]
        rows += [("two commands, half each", f"{halves_s:.1f} s", f"{n / halves_s:.1f}")]
        again_s = process([str(folder)], str(Path(place) / "counted"))[0]
        size = sum(file.stat().st_size for file in (Path(place) / "counted").rglob("*.parquet")) / n
    return Section(
        title="Batch scaling over workers",
        words=[
            f"`process --archive` of {n} trials of 1 s, every {EVERY_CORRUPT}th corrupt, workers warm. "
            f"{time_words(each_s)} of processor time a recording, start and table counted in; a second run, which "
            f"finds everything there, takes {again_s:.1f} s. The archive takes {size / 1e3:.1f} kB a recording.",
            f"Two commands that know nothing of each other, each with half of the recordings, are "
            f"{alone_s / halves_s:.2f} times as fast as one with all: so much this machine gives. Two workers ahead of "
            f"one: {', '.join(gains)}.",
        ],
        tables=[Table(head=("workers", "time", "recordings a second"), rows=rows)],
        goals=goals,
    )


def main() -> None:
    """Print the table."""
    from benchmarks.page import section_text

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=RECORDINGS)
    print(section_text(measure(Clock(), parser.parse_args().recordings)))


if __name__ == "__main__":
    main()
