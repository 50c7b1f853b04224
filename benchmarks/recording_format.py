"""Size and speed of recordings: `python benchmarks/recording_format.py`.

The signals are a jigsaw's, made up here: rates, resolution and noise as the bench's instruments have them.
"""

from __future__ import annotations

import importlib
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from sawbench.bench.recording import SampleBlock, Trial
from sawbench.bench.units import CHANNELS
from sawbench.storage.importers import import_path
from sawbench.storage.reader import read_recording
from sawbench.storage.writer import RecordingWriter

SECONDS = 20.0
BLOCK_S = 0.05
# Rate in Hz and smallest step of the instrument: 24 bit force, 16 bit displacement, 12 to 16 bit on CAN.
INSTRUMENTS = {
    "force_n": (5000.0, 1000 / 2**23),
    "displacement_mm": (5000.0, 25 / 2**16),
    "motor_current_a": (1000.0, 0.01),
    "battery_voltage_v": (1000.0, 0.001),
    "battery_current_a": (1000.0, 0.01),
}


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


def blocks(with_raw: bool, gain: float) -> list[SampleBlock]:
    """All blocks of a trial in the order in which they arrive."""
    rng = np.random.default_rng(1)
    made = []
    units = {channel.name: channel.unit for channel in CHANNELS}
    for k in range(round(SECONDS / BLOCK_S)):
        for name, (rate_hz, step) in INSTRUMENTS.items():
            n = round(rate_hz * BLOCK_S)
            time_s = k * n / rate_hz + np.arange(n) / rate_hz
            raw = counts(name, time_s, rng)
            made.append(
                SampleBlock(
                    device=name,
                    channel=name,
                    unit=units[name],
                    first_index=k * n,
                    time_s=time_s,
                    values=raw * (step * gain),
                    raw=raw if with_raw else None,
                    period_s=1 / rate_hz,
                )
            )
    return made


def measure(folder: Path, label: str, written: list[SampleBlock], preview_rate_hz: float = 50.0) -> None:
    """Write with a flush a second as a live recording does, read back, print one line."""
    path = folder / f"{label}.mcap"
    now_s = [0.0]
    started = time.perf_counter()
    writer = RecordingWriter(
        path=path,
        trial=Trial(trial_id=label),
        config_toml="",
        provenance={},
        started_at=datetime(2026, 3, 2, tzinfo=UTC),
        clock=lambda: now_s[0],
        preview_rate_hz=preview_rate_hz,
    )
    with writer:
        for block in written:
            now_s[0] = float(block.time_s[-1])
            writer.write_block(block)
    write_s = time.perf_counter() - started
    started = time.perf_counter()
    read_recording(path)
    read_s = time.perf_counter() - started
    n = sum(len(block.values) for block in written)
    size = path.stat().st_size
    speed = f"write {n / write_s / 1e6:5.1f}, read {n / read_s / 1e6:5.1f} million samples/s"
    print(f"{label:28s} {size / n:5.2f} bytes a sample, {speed}, {100 * write_s / SECONDS:.2f} % of a core live")


def measure_import(folder: Path) -> None:
    """Import a campaign of 18 trials with 750 000 rows in all, jittered times, five channels."""
    importlib.import_module("pandas")  # once a process, and not what is measured
    rng = np.random.default_rng(2)
    n_trials, n_rows = 18, 41_700
    entries = []
    for k in range(n_trials):
        time_s = (np.arange(n_rows) + rng.uniform(-0.1, 0.1, n_rows)) / 5000
        columns = [time_s, *(counts(name, time_s, rng) * step for name, (_, step) in INSTRUMENTS.items())]
        header = {"header": ",".join(("time_s", *INSTRUMENTS)), "comments": ""}
        name = f"trial-{k + 1:02d}.csv"
        np.savetxt(folder / name, np.column_stack(columns), "%.7f", delimiter=",", **header)
        entries.append(f'[[trial]]\nfile = "{name}"\n')
    (folder / "campaign.toml").write_text("".join(entries))
    started = time.perf_counter()
    report = import_path(folder / "campaign.toml", folder / "imported")
    import_s = time.perf_counter() - started
    size = sum(path.stat().st_size for path in report.paths)
    rows = n_trials * n_rows
    text_size = sum(path.stat().st_size for path in folder.glob("*.csv"))
    print(
        f"campaign of {n_trials} CSV, {rows} rows: imported in {import_s:.1f} s, "
        f"{size / report.n_samples:.2f} bytes a sample "
        f"({size / 1e6:.0f} MB, the text {text_size / 1e6:.0f} MB)"
    )


def main() -> None:
    """Print the table of docs/recording_format.md."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        measure(folder, "values", blocks(with_raw=False, gain=1.0))
        measure(folder, "values, preview at 1 Hz", blocks(with_raw=False, gain=1.0), preview_rate_hz=1.0)
        measure(folder, "values and raw counts", blocks(with_raw=True, gain=1.0))
        measure(folder, "recalibrated and raw counts", blocks(with_raw=True, gain=1.00371))
        measure_import(folder)


if __name__ == "__main__":
    main()
