"""Recorders killed at random: `python -m benchmarks.kills --count 200` says what each kill cost.

The instruments of `benchmarks.soak` run in a process of their own, on ptys in real time; a recorder is forked, and
killed by SIGKILL at a random moment. The time of the kill, on the clock of the same machine, tells how much is missing
at the end of what the file holds. The command exits with 1 where a file does not open, has a hole, or lost
over a second.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from sawbench.bench.errors import SawbenchError
from sawbench.bench.recording import Trial
from sawbench.commands.recording_session import SessionOptions, record_trial
from sawbench.inputs import config_for
from sawbench.storage.reader import read_recording
from sawbench.storage.recover import recover_recording

from benchmarks.soak import CHANNELS, config_text

MOST_LOST_S = 1.0
LATEST_KILL_S = 4.0
NO_FILE_S = 120.0
MOST_STARTS = 5


@dataclass(frozen=True, kw_only=True)
class Kill:
    """What one kill cost; `wrong` is empty where the file is as it should be."""

    seed: int
    after_s: float
    lost_s: float
    wrong: str


@contextlib.contextmanager
def instruments(folder: Path) -> Iterator[Path]:
    """Give the configuration that has their ports."""
    config = folder / "bench_config.toml"
    config.write_text(config_text(1))
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.soak", "--instruments", str(config)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdin is not None and process.stdout is not None
    try:
        config.write_text(config_text(1, json.loads(process.stdout.readline())))
        yield config
    finally:
        process.stdin.close()
        process.wait(20)
        process.stdout.close()


def forked_recorder(config: Path, path: Path) -> int:
    """Start to record in a process of its own, which has nothing to import any more; return its id."""
    pid = os.fork()
    if pid:
        return pid
    try:
        record_trial(config_for(None, config), SessionOptions(path=path, trial=Trial(trial_id="k"), seconds=None))
    except SawbenchError as error:
        print(error, file=sys.stderr, flush=True)
    finally:
        # What the parent set up for itself must not be taken down twice.
        os._exit(1)


def begun(config: Path, path: Path) -> int | None:
    """Id of a recorder whose file is there; None where it did not begin."""
    part = part_of(path)
    pid = forked_recorder(config, path)
    deadline_s = time.monotonic() + NO_FILE_S
    while not part.exists() and time.monotonic() < deadline_s:
        if os.waitpid(pid, os.WNOHANG) != (0, 0):
            return None
        time.sleep(0.002)
    return pid


def part_of(path: Path) -> Path:
    """Name of the file while it is recorded."""
    return path.with_name(path.name + ".part")


def killed(config: Path, folder: Path, seed: int) -> Kill:
    """Record, kill, read what is there."""
    rng = np.random.default_rng([20260325, seed])
    after_s = float(rng.uniform(0.0, LATEST_KILL_S))
    path = folder / f"k{seed}.mcap"
    # An amplifier that the one before left streaming may be too busy to answer in time.
    pids = (begun(config, path) for _ in range(MOST_STARTS))
    pid = next((pid for pid in pids if pid is not None), None)
    if pid is None:
        return Kill(seed=seed, after_s=after_s, lost_s=np.inf, wrong="the recorder did not begin")
    time.sleep(after_s)
    killed_at_s = time.time()
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    lost_s, wrong = what_is_left(part_of(path), killed_at_s)
    part_of(path).unlink()
    return Kill(seed=seed, after_s=after_s, lost_s=lost_s, wrong=wrong)


def what_is_left(part: Path, killed_at_s: float) -> tuple[float, str]:
    """How long before the kill the samples end, s, and what is wrong with the file."""
    try:
        recording = read_recording(part)
        copy = recover_recording(part, part.with_suffix(".recovered.mcap")).path
        again = read_recording(copy)
        copy.unlink()
    except SawbenchError as error:
        return np.inf, str(error)
    if recording.trial.started_at is None:
        return np.inf, "when it started is unknown"
    elapsed_s = killed_at_s - recording.trial.started_at.timestamp()
    lost_s = 0.0
    problems = ["" if not recording.is_complete else "called complete"]
    for channel in CHANNELS:
        signal_of = recording.signals.get(channel)
        end_s = 0.0 if signal_of is None else float(signal_of.time_s[-1])
        lost_s = max(lost_s, elapsed_s - end_s)
        if signal_of is None:
            continue
        told = {(e.time_s, e.end_s) for e in recording.events if e.kind == "gap"}
        untold = [gap for gap in signal_of.gaps if (gap.start_s, gap.end_s) not in told]
        if untold:
            problems.append(f"{channel}: a hole that nobody told of: {untold[0]}")
        if len(again.signals[channel].time_s) != len(signal_of.time_s):
            problems.append(f"{channel}: recovered otherwise than read")
    problems.append(f"lost {lost_s:.2f} s" if lost_s > MOST_LOST_S else "")
    return lost_s, "; ".join(filter(None, problems))


def run(count: int, first_seed: int = 0) -> list[Kill]:
    """Kill `count` recorders, one after the other."""
    found = []
    with tempfile.TemporaryDirectory() as folder, instruments(Path(folder)) as config:
        for seed in range(first_seed, first_seed + count):
            found.append(killed(config, Path(folder), seed))
            print(asdict(found[-1]), file=sys.stderr, flush=True)
    return found


def main() -> int:
    """Kill and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=0)
    options = parser.parse_args()
    found = run(options.count, options.first_seed)
    lost_s = np.array([kill.lost_s for kill in found])
    wrong = [asdict(kill) for kill in found if kill.wrong]
    print(
        json.dumps(
            {
                "count": len(found),
                "median_lost_s": float(np.median(lost_s)),
                "most_lost_s": float(lost_s.max()),
                "over_a_second": int(np.sum(lost_s > MOST_LOST_S)),
                "n_wrong": len(wrong),
                "wrong": wrong,
            },
            indent=1,
        )
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
