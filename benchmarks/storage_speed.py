"""Write, read and size of a recording against MDF4, HDF5, Parquet and CSV.

The signals are a jigsaw's, made up here: rates, resolution and noise as the bench's instruments have them.
"""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
from sawbench.bench.recording import SampleBlock, Trial
from sawbench.bench.units import CHANNELS
from sawbench.storage.importers import import_path
from sawbench.storage.reader import read_recording
from sawbench.storage.writer import RecordingWriter

from benchmarks.measuring import Clock, Plot, Section, Table

SECONDS, BLOCK_S = 20.0, 0.05
# Rate in Hz and smallest step of the instrument: 24 bit force, 16 bit displacement, 12 to 16 bit on CAN.
INSTRUMENTS = {
    "force_n": (5000.0, 1000 / 2**23),
    "displacement_mm": (5000.0, 25 / 2**16),
    "motor_current_a": (1000.0, 0.01),
    "battery_voltage_v": (1000.0, 0.001),
    "battery_current_a": (1000.0, 0.01),
}
UNITS = {channel.name: channel.unit for channel in CHANNELS}
Columns = dict[str, tuple[np.ndarray, np.ndarray]]


def counts(name: str, time_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Integer counts of a cut with 14 strokes a second, with noise of the size real sensors have."""
    angle = 2 * np.pi * 14 * time_s
    value, noise = {
        "force_n": (240 * np.maximum(-np.sin(angle), 0), 0.5),
        "displacement_mm": (10 * (1 - np.cos(angle)), 0.003),
        "motor_current_a": (10 + 3 * np.sin(angle), 0.03),
        "battery_voltage_v": (18 - 0.1 * np.sin(angle), 0.002),
        "battery_current_a": (4.6 + 1.3 * np.sin(angle), 0.02),
    }[name]
    return np.rint((value + rng.normal(0, noise, len(time_s))) / INSTRUMENTS[name][1])


def blocks(*, with_raw: bool = False, gain: float = 1.0) -> list[SampleBlock]:
    """All blocks of a trial in the order in which they arrive."""
    rng = np.random.default_rng(1)
    made = []
    for k in range(round(SECONDS / BLOCK_S)):
        for name, (rate_hz, step) in INSTRUMENTS.items():
            n = round(rate_hz * BLOCK_S)
            time_s = k * n / rate_hz + np.arange(n) / rate_hz
            raw = counts(name, time_s, rng)
            made.append(
                SampleBlock(
                    device=name, channel=name, unit=UNITS[name], first_index=k * n, time_s=time_s,
                    values=raw * (step * gain), raw=raw if with_raw else None, period_s=1 / rate_hz,
                )
            )  # fmt: skip
    return made


def columns_of(written: list[SampleBlock]) -> Columns:
    """Times and values of each channel."""
    whole = {}
    for name in INSTRUMENTS:
        own = [block for block in written if block.channel == name]
        whole[name] = np.concatenate([b.time_s for b in own]), np.concatenate([b.values for b in own])
    return whole


def write_mcap(path: Path, written: list[SampleBlock], preview_rate_hz: float = 50.0) -> None:
    """With a flush a second, as a live recording does."""
    now_s = [0.0]
    path.unlink(missing_ok=True)
    writer = RecordingWriter(
        path=path, trial=Trial(trial_id=path.stem), config_toml="", provenance={},
        started_at=datetime(2026, 3, 2, tzinfo=UTC), clock=lambda: now_s[0], preview_rate_hz=preview_rate_hz,
    )  # fmt: skip
    with writer:
        for block in written:
            now_s[0] = float(block.time_s[-1])
            writer.write_block(block)


def write_mdf(path: Path, columns: Columns) -> None:
    """Compressed (deflate), a group for each channel."""
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        for name, (time_s, values) in columns.items():
            file.append([Signal(samples=values, timestamps=time_s, name=name, unit=UNITS[name])])
        file.save(path, overwrite=True, compression=2)


def read_mdf(path: Path) -> None:
    """Every channel with its times."""
    from asammdf import MDF

    with MDF(path) as file:
        for name in INSTRUMENTS:
            file.get(name)


def write_hdf5(path: Path, columns: Columns) -> None:
    """Chunked, shuffled, deflate at level 4."""
    import h5py

    with h5py.File(path, "w") as file:
        for name, pair in columns.items():
            for part, values in zip(("time_s", "values"), pair, strict=True):
                file.create_dataset(f"{name}/{part}", data=values, compression="gzip", shuffle=True)


def read_hdf5(path: Path) -> None:
    """Every array."""
    import h5py

    with h5py.File(path) as file:
        for name in INSTRUMENTS:
            for part in ("time_s", "values"):
                file[name][part][...]


def write_parquet(path: Path, columns: Columns) -> None:
    """Zstandard; one long table, because the channels have rates of their own."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table(
        {
            "channel": pa.DictionaryArray.from_arrays(
                np.repeat(np.arange(len(columns), dtype=np.int8), [len(t) for t, _ in columns.values()]), list(columns)
            ),
            "time_s": np.concatenate([t for t, _ in columns.values()]),
            "value": np.concatenate([v for _, v in columns.values()]),
        }
    )
    pq.write_table(table, path, compression="zstd", use_dictionary=["channel"])


def read_parquet(path: Path) -> None:
    """The whole table, on one thread."""
    import pyarrow.parquet as pq

    pq.read_table(path, use_threads=False)


def write_csv(path: Path, columns: Columns) -> None:
    """One row per sample."""
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        for name, (time_s, values) in columns.items():
            table.writerows((name, f"{t:.7f}", f"{v:.7g}") for t, v in zip(time_s, values, strict=True))


def read_csv(path: Path) -> None:
    """By pandas."""
    import pandas as pd

    pd.read_csv(path, header=None)


def import_campaign(folder: Path) -> Callable[[], object]:
    """Write a campaign of 6 CSV trials with jittered times; returns the work that imports it."""
    rng, n_rows, entries = np.random.default_rng(2), 41_700, []
    for k in range(6):
        time_s = (np.arange(n_rows) + rng.uniform(-0.1, 0.1, n_rows)) / 5000
        columns = [time_s, *(counts(name, time_s, rng) * step for name, (_, step) in INSTRUMENTS.items())]
        name = f"trial-{k + 1:02d}.csv"
        np.savetxt(
            folder / name, np.column_stack(columns), "%.7f", delimiter=",",
            header=",".join(("time_s", *INSTRUMENTS)), comments="",
        )  # fmt: skip
        entries.append(f'[[trial]]\nfile = "{name}"\n')
    (folder / "campaign.toml").write_text("".join(entries))
    return partial(import_path, folder / "campaign.toml", folder / "imported")


def measure(clock: Clock) -> Section:
    """Formats against each other, then what our own options cost."""
    plain = blocks()
    columns = columns_of(plain)
    n = sum(len(values) for _, values in columns.values())
    formats: dict[str, tuple[Callable[[Path], object], Callable[[Path], object] | None]] = {
        "sawbench (MCAP)": (lambda path: write_mcap(path, plain), read_recording),
        "MDF4 (asammdf)": (lambda path: write_mdf(path, columns), read_mdf),
        "HDF5 (h5py)": (lambda path: write_hdf5(path, columns), read_hdf5),
        "Parquet (pyarrow)": (lambda path: write_parquet(path, columns), read_parquet),
        "CSV (csv, pandas)": (lambda path: write_csv(path, columns), read_csv),
    }
    recalibrated, raw = blocks(with_raw=True, gain=1.00371), blocks(with_raw=True)
    variants = {
        "values": lambda path: write_mcap(path, plain),
        "values, preview at 1 Hz instead of 50 Hz": lambda path: write_mcap(path, plain, 1.0),
        "values and raw counts": lambda path: write_mcap(path, raw),
        "values with a calibration of many digits, and raw counts": lambda path: write_mcap(path, recalibrated),
    }
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        paths = {name: folder / f"{k}.{'mf4' if 'MDF' in name else 'mcap'}" for k, name in enumerate(formats)}
        written = clock.together({name: partial(write, paths[name]) for name, (write, _) in formats.items()})
        read = clock.together({name: partial(read, paths[name]) for name, (_, read) in formats.items()})
        sizes = {name: path.stat().st_size / n for name, path in paths.items()}
        own = clock.together({name: partial(write, folder / "own.mcap") for name, write in variants.items()})
        own_rows = []
        for name, write in variants.items():
            write(folder / "own.mcap")
            size, load = (folder / "own.mcap").stat().st_size / n, own[name].median_s / SECONDS
            own_rows.append((name, f"{size:.1f}", f"{100 * load:.2f} % of a core"))
        imports = import_campaign(folder)
        imported_s = clock.once(imports)
    rows = [
        (name, f"{n / written[name].median_s / 1e6:.1f}", f"{n / read[name].median_s / 1e6:.1f}", f"{sizes[name]:.2f}")
        for name in formats
    ]
    return Section(
        title="Storage",
        words=[
            f"{SECONDS:g} s of force and displacement at 5 kHz and three channels at 1 kHz ({n} samples) with the "
            "resolution and noise of real sensors. The MCAP file is written as it is recorded: blocks of 50 ms, a "
            "flush a second, previews, checksums, and it is read with every check. The others get the whole arrays at "
            "once, and keep nothing but the values."
        ],
        tables=[
            Table(head=("format", "write, million samples/s", "read, million samples/s", "bytes a sample"), rows=rows),
            Table(
                title="What a recording holds",
                head=("stored", "bytes a sample", "load while recording"),
                rows=[*own_rows, ("import of 6 CSV, 250 200 rows, jittered times", "", f"{imported_s:.1f} s")],
            ),
        ],
        plots=[Plot(name="storage", title="Size of a sample", x_label="size / bytes", bars=sizes)],
        numbers={"bytes_a_sample": sizes["sawbench (MCAP)"]},
    )
