"""Processor time of recording 100 000 samples, and what is lost, against plain loggers and the least possible."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.measuring import Clock, Plot, Section, Table, time_words
from benchmarks.storage_speed import INSTRUMENTS, SECONDS, blocks, write_mcap

# The simulated instruments run in a process of their own: what is counted is the recorder alone. The first recording
# loads and compiles; what every recording costs besides its samples drops out of the difference of the others.
RECORD = """
import contextlib, io, json, sys, time
from sawbench.commands.main import main
found = []
for number, seconds in enumerate(sys.argv[2:]):
    said, start = io.StringIO(), time.process_time()
    with contextlib.redirect_stdout(said):
        main(["record", "--material", "oak", "--simulated", "--json", "--seconds", seconds, "--trial", str(number),
              "--out", sys.argv[1]])
    channels = json.loads(said.getvalue())["channels"]
    found.append({"cpu_s": time.process_time() - start, "seconds": float(seconds),
                  "samples": sum(c["n_samples"] for c in channels), "missing": sum(c["n_missing"] for c in channels)})
print(json.dumps(found))
"""


def record(durations_s: tuple[float, ...], folder: Path) -> list[dict[str, float]]:
    """Processor time, samples and missing samples of recordings from the simulated bench, one after the other."""
    done = subprocess.run(
        [sys.executable, "-c", RECORD, str(folder), *map(str, durations_s)],
        capture_output=True, text=True, check=False, cwd=folder,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"record failed: {done.stderr[-500:]}")
    return json.loads(done.stdout.splitlines()[-1])


def least(path: Path, written) -> None:
    """Scale the counts of every block and write the numbers: nothing can do less."""
    with path.open("wb") as file:
        for block in written:
            file.write((block.raw * INSTRUMENTS[block.channel][1]).tobytes())


def csv_logger(path: Path, written) -> None:
    """A row per sample, as a small script does."""
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        for block in written:
            step = INSTRUMENTS[block.channel][1]
            for time_s, count in zip(block.time_s.tolist(), block.raw.tolist(), strict=True):
                table.writerow((block.channel, time_s, count * step))


def hdf5_logger(path: Path, written) -> None:
    """Append every block to a growing dataset."""
    import h5py

    with h5py.File(path, "w") as file:
        for name in INSTRUMENTS:
            file.create_dataset(name, (0,), maxshape=(None,), chunks=(4096,), dtype=np.float64)
        for block in written:
            data, n = file[block.channel], len(block.values)
            data.resize(len(data) + n, axis=0)
            data[-n:] = block.raw * INSTRUMENTS[block.channel][1]


def measure(clock: Clock) -> Section:
    """The whole recorder from the slope over two durations, the writer and others from blocks in memory."""
    written = blocks(with_raw=True)
    n = sum(len(block.values) for block in written)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        _, short, long = record((1.0, 2.0, 8.0) if clock.quick else (2.0, 3.0, 18.0), folder)
        loggers = {"sawbench: writer alone": partial(write_mcap, folder / "a.mcap", written)}
        loggers |= {
            name: partial(work, folder / f"{k}.log", written)
            for k, (name, work) in enumerate(
                (("limit: scale and write the bytes", least), ("CSV, a row per sample", csv_logger),
                 ("HDF5, appended in blocks", hdf5_logger))
            )
        }  # fmt: skip
        found = clock.together(loggers)
    n_more = long["samples"] - short["samples"]
    whole_s = 1e5 * (long["cpu_s"] - short["cpu_s"]) / n_more
    per_100_ks = {"sawbench: the whole recorder": whole_s}
    per_100_ks |= {name: 1e5 * timing.median_s / n for name, timing in found.items()}
    rate_hz = n_more / (long["seconds"] - short["seconds"])
    share = 100 * whole_s * rate_hz / 1e5
    lost = short["missing"] + long["missing"]
    return Section(
        title="Recorder",
        words=[
            "The whole recorder reads serial and CAN instruments that run in another process, decodes, aligns the "
            f"clocks, watches, estimates k_Fc live and writes: {rate_hz:.0f} samples/s, {share:.1f} % of a core. "
            f"Samples lost: {lost:.0f} of {short['samples'] + long['samples']:.0f}. The others get {SECONDS:g} s of "
            "samples in blocks of 50 ms from memory, so they do less."
        ],
        tables=[
            Table(
                head=("logger", "processor time for 100 000 samples"),
                rows=[(name, time_words(spent)) for name, spent in per_100_ks.items()],
            )
        ],
        plots=[
            Plot(
                name="recorder", title="Processor time for 100 000 samples", x_label="time / ms",
                bars={name: 1e3 * spent for name, spent in per_100_ks.items()},
            )
        ],
        numbers={"recorder_s_per_100_ks": whole_s, "lost_samples": lost},
    )  # fmt: skip
