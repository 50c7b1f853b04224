"""An archive on a cluster and an object store: what is lost when a worker is killed, and what a second worker gains.

    pip install 'sawbench[cluster]' 'moto[server]'
    python -m benchmarks.archive [--recordings 1000] [--scaling 200] [--out archive.json]

Starts moto's S3 server and a dask scheduler with worker processes on this machine, uploads short recordings of which
every fiftieth is corrupt, and runs `sawbench process s3://... --archive s3://... --scheduler ...`. While it runs, one
worker is killed (SIGKILL). Then: is every recording in the table, is exactly what is corrupt marked as failed, and does
a second run do nothing? The scaling is the time of a batch on one worker over that on two, each with an archive of its
own, workers warm; measure it on a machine that does nothing else (`python -m benchmarks --only batch` measures it too,
without a store). Ends with 1 if anything is not as it must be.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np
import sawbench
from sawbench.archive.table import ResultTable
from sawbench.storage.output import write_whole
from sawbench.storage.places import place_of
from sawbench.storage.reader import write_recording

BUCKET: Final = "s3://lab"
EVERY_CORRUPT: Final = 50
_STARTED: Final = datetime(2026, 1, 5, 9, tzinfo=UTC)
_MATERIALS: Final = {"oak": 240.0, "nylon": 60.0, "black locust": 280.0}
_SECONDS, _RATE_HZ, _NOISE = 1.0, 1000.0, 1e-3


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def running(*command: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a server until the block ends."""
    call = [sys.executable, "-m", *command]
    process = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(30)


def wait_for(port: int, limit_s: float = 120.0) -> None:
    until = time.monotonic() + limit_s
    while time.monotonic() < until:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.2)
    raise TimeoutError(f"nobody answers at port {port}")


def upload(n: int, folder: str, every_corrupt: int | None = EVERY_CORRUPT) -> list[str]:
    """Write short recordings, all different, to a store or a folder; return the names of those that are corrupt."""
    length = {"duration_s": _SECONDS, "rate_hz": _RATE_HZ}
    runs = {name: sawbench.simulate(k_fc_n_s_per_m=k_fc, **length).recording(material=name)
            for name, k_fc in _MATERIALS.items()}  # fmt: skip
    corrupt = []
    with tempfile.TemporaryDirectory() as place:
        for number in range(n):
            rng = np.random.default_rng(number)
            material = list(_MATERIALS)[number % len(_MATERIALS)]
            whole = runs[material].recording
            noisy = {
                name: replace(one, values=one.values + rng.normal(0.0, _NOISE * np.ptp(one.values), len(one.values)))
                for name, one in whole.signals.items()
            }
            name, started = f"trial-{number:06d}", _STARTED + timedelta(hours=6 * number)
            trial = replace(whole.trial, trial_id=name, started_at=started, blade=f"B{number % 7}", feed_mm_s=4.0)
            path = write_recording(replace(whole, trial=trial, signals=noisy), Path(place) / f"{name}.mcap")
            content = path.read_bytes()
            path.unlink()
            if every_corrupt is not None and number % every_corrupt == every_corrupt - 1:
                content = (b"", rng.bytes(4096), b"\x00" * 100 + content[100:])[number // every_corrupt % 3]
                corrupt.append(f"{name}.mcap")
            write_whole(place_of(f"{folder}/{name}.mcap"), content, overwrite=True, makes_folder=True)
    return corrupt


def process(paths: Sequence[str], archive: str, *options: str) -> tuple[float, str]:
    """Run `sawbench process`; return the seconds it took and what it said."""
    call = [sys.executable, "-m", "sawbench.commands.main", "process", *paths, "--archive", archive, *options, "--json"]
    begun = time.monotonic()
    done = subprocess.run(call, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
    return time.monotonic() - begun, done.stderr


def kill_a_worker(address: str, archive: str, running_batch: subprocess.Popen[Any]) -> bool:
    """Kill one worker process as soon as the first results are kept; return whether the batch was still running."""
    from distributed import Client

    table = ResultTable(place_of(archive))
    while running_batch.poll() is None and not table.exists():
        time.sleep(0.5)
    with Client(address, set_as_default=False) as client:
        pids = list(client.run(os.getpid).values())
    was_running = running_batch.poll() is None
    say(f"of the workers {pids} the first is killed")
    os.kill(pids[0], signal.SIGKILL)
    return was_running


def survive(n: int, address: str) -> dict[str, Any]:
    """Process n recordings while a worker is killed, then once more."""
    folder, archive = f"{BUCKET}/recordings", f"{BUCKET}/archive"
    corrupt = upload(n, folder)
    say(f"{n} recordings are in the store, {len(corrupt)} of them corrupt")
    call = [sys.executable, "-m", "sawbench.commands.main", "process", folder, "--archive", archive]
    begun = time.monotonic()
    batch = subprocess.Popen(
        [*call, "--scheduler", address], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    was_running = kill_a_worker(address, archive, batch)
    said = batch.communicate()[1]
    seconds = time.monotonic() - begun
    say(f"the batch ended after {seconds:.0f} s")
    found = ResultTable(place_of(archive)).read(("source", "exit_code", "error", "k_fc_n_s_per_m"))
    failed = sorted(Path(source).name for source in found[found["exit_code"] != 0]["source"])
    again_s, again = process([folder], archive, "--scheduler", address)
    return {
        "recordings": n,
        "seconds": round(seconds, 1),
        "exit_code": batch.returncode,
        "killed_while_running": was_running,
        "rows": len(found),
        "corrupt": len(corrupt),
        "failed_are_the_corrupt": failed == corrupt,
        "corrupt_are_named": all(name in said for name in corrupt),
        "with_k_fc": int(found["k_fc_n_s_per_m"].notna().sum()),
        "second_run_evaluated": int(match[1]) if (match := re.search(r"(\d+) evaluated now", again)) else None,
        "second_run_seconds": round(again_s, 1),
    }


def scaling(n: int, scheduler_port: int) -> dict[str, float]:
    """Seconds of a batch on one and on two workers, and their ratio."""
    from distributed import Client

    address, folder, seconds = f"tcp://127.0.0.1:{scheduler_port}", f"{BUCKET}/scaling", {}
    upload(n, folder)
    for n_workers in (1, 2):
        with workers(address, n_workers), Client(address, set_as_default=False) as client:
            client.wait_for_workers(n_workers, timeout=120)
            process([folder], f"{BUCKET}/warm-{n_workers}", "--scheduler", address)
            seconds[n_workers] = process([folder], f"{BUCKET}/timed-{n_workers}", "--scheduler", address)[0]
    return {"recordings": n, "one_s": round(seconds[1], 1), "two_s": round(seconds[2], 1),
            "ratio": round(seconds[1] / seconds[2], 2)}  # fmt: skip


@contextmanager
def workers(address: str, n: int) -> Iterator[None]:
    one_thread = ("--nthreads", "1", "--nworkers", str(n), "--no-dashboard")
    with running("distributed.cli.dask_worker", address, *one_thread):
        yield


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=1000)
    parser.add_argument("--scaling", type=int, default=200, help="recordings of the scaling; 0 leaves it out")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path)
    wanted = parser.parse_args()
    store_port, scheduler_port = free_port(), free_port()
    os.environ |= {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{store_port}", "AWS_ACCESS_KEY_ID": "bench",
        "AWS_SECRET_ACCESS_KEY": "bench", "AWS_DEFAULT_REGION": "us-east-1", "OPENBLAS_NUM_THREADS": "1",
        "NUMBA_NUM_THREADS": "1",
    }  # fmt: skip
    address = f"tcp://127.0.0.1:{scheduler_port}"
    scheduler = ("distributed.cli.dask_scheduler", "--port", str(scheduler_port), "--no-dashboard")
    with running("moto.server", "-p", str(store_port)), running(*scheduler):
        wait_for(store_port)
        wait_for(scheduler_port)
        with workers(address, wanted.workers):
            found: dict[str, Any] = {"survival": survive(wanted.recordings, address)}
        if wanted.scaling:
            found["scaling"] = scaling(wanted.scaling, scheduler_port)
    print(json.dumps(found, indent=2))
    if wanted.out:
        wanted.out.write_text(json.dumps(found, indent=2))
    one = found["survival"]
    is_whole = one["rows"] == one["recordings"] and one["failed_are_the_corrupt"] and one["corrupt_are_named"]
    return 0 if is_whole and one["killed_while_running"] and one["second_run_evaluated"] == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
