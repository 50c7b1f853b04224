"""An hour at 10 kHz and 8 channels: what every command takes of memory and time.

    python -m benchmarks.long_recording [--minutes 60] [--keep FILE]

The recording is made of one settled stroke of the model, its rate falling by 2 % over the hour, with white noise of a
thousandth of each channel's range; three more channels of another kind lie beside the five of the bench. Each command
runs in a process of its own; memory is the largest resident set that the system has seen of it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import sawbench
from sawbench.bench.recording import SampleBlock, Trial
from sawbench.storage.writer import RecordingWriter

from benchmarks.measuring import Clock, Goal, Section, Table

RATE_HZ, BLOCK_S, K_FC = 10_000.0, 0.5, 240.0
MOST_GB = 1.5
OTHERS = {"vibration_g": 3.0, "motor_temperature_degc": 60.0, "sound_pa": 0.5}
COMMANDS = {
    "info": "info {recording}",
    "process": "process {recording} --out {out}/processed",
    "fit": "fit {recording}",
    "report": "report {recording} --out {out}/pages",
    "view": "view {recording} --no-view --rrd {out}/view.rrd",
    "compare": "compare {recording} --out {out}/comparison.html",
    "export": "export {recording} --format parquet --out {out}/tables",
}


def settled_stroke() -> tuple[dict[str, np.ndarray], dict[str, str], float, str, float | None]:
    """One stroke of the model on 1000 crank angles: channels, their units, its period, configuration, duty."""
    opened = sawbench.simulate(k_fc_n_s_per_m=K_FC, duration_s=3.0, rate_hz=50_000.0).recording(material="oak")
    signals = opened.recording.signals
    shift = signals["displacement_mm"].values
    is_low = (shift[1:-1] <= shift[:-2]) & (shift[1:-1] < shift[2:])
    starts_s = signals["displacement_mm"].time_s[1:-1][is_low]
    period_s = float(starts_s[-1] - starts_s[-2])
    at_s = starts_s[-2] + period_s * np.arange(1000) / 1000
    stroke = {name: np.interp(at_s, signal.time_s, signal.values) for name, signal in signals.items()}
    units = {name: signal.unit for name, signal in signals.items()}
    return stroke, units, period_s, opened.loaded.text, opened.recording.trial.duty


def make(path: Path, minutes: float) -> int:
    """Write the recording; returns its number of samples."""
    stroke, units, period_s, config, duty = settled_stroke()
    units |= {name: name.rpartition("_")[2] for name in OTHERS}
    rng, n = np.random.default_rng(1), round(RATE_HZ * BLOCK_S)
    noise = rng.normal(0.0, 1e-3, 1 << 20)
    duration_s = 60.0 * minutes
    trial = Trial(trial_id=path.stem, material="oak", duty=duty, feed_mm_s=4.0, source="simulated by the model")
    origin = datetime(2026, 3, 2, tzinfo=UTC)
    writer = RecordingWriter(
        path=path, trial=trial, config_toml=config, provenance={}, started_at=origin, preview_rate_hz=1.0
    )
    with writer:
        for block in range(round(duration_s / BLOCK_S)):
            time_s = (block * n + np.arange(n)) / RATE_HZ
            turns = (time_s - 0.01 * time_s**2 / duration_s) / period_s
            for name, unit in units.items():
                if name in OTHERS:
                    values = OTHERS[name] * (1.0 + 0.1 * np.sin(2.0 * np.pi * turns))
                else:
                    values = np.interp(1000.0 * (turns % 1.0), np.arange(1001), np.r_[stroke[name], stroke[name][0]])
                size = OTHERS[name] if name in OTHERS else float(np.ptp(stroke[name]))
                first = int(rng.integers(len(noise) - n))
                writer.write_block(
                    SampleBlock(device="model", channel=name, unit=unit, first_index=block * n, time_s=time_s,
                                values=values + size * noise[first : first + n], period_s=1.0 / RATE_HZ)
                )  # fmt: skip
    return round(duration_s / BLOCK_S) * n * len(units)


def run(text: str, recording: Path, out: Path) -> tuple[float, float, int, str]:
    """Largest resident set of a command, GB, its seconds, its exit code and what it said."""
    arguments = text.format(recording=recording, out=out).split()
    start = time.perf_counter()
    said = out / "said.txt"
    with said.open("w") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "sawbench.commands.main", *arguments], stdout=file, stderr=subprocess.STDOUT
        )
        _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return used.ru_maxrss * 1024 / 1e9, time.perf_counter() - start, process.returncode, said.read_text()


def measure(clock: Clock, minutes: float = 60.0, keep: Path | None = None) -> Section:
    """Make the recording and run every command on it; of a quick run 6 minutes."""
    minutes = min(minutes, 6.0) if clock.quick else minutes
    rows, goals = [], []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        recording = keep or folder / "hour.mcap"
        if not recording.exists():
            make(recording, minutes)
        n_samples = round(60.0 * minutes * RATE_HZ) * (5 + len(OTHERS))
        for name, text in COMMANDS.items():
            memory_gb, took_s, code, said = run(text, recording, folder)
            if code not in (0, 1):
                print(said, file=sys.stderr)
            label = f"`{name}`" + ("" if code == 0 else f" (exit code {code})")
            rows.append((label, f"{memory_gb:.2f} GB", f"{took_s:.0f} s"))
            what = f"memory of `{name}`, {minutes:g} min at 10 kHz x 8"
            goals.append(Goal(what=what, value=memory_gb if code == 0 else None, bound=MOST_GB, unit="GB"))
        size_gb = recording.stat().st_size / 1e9
    return Section(
        title="A long recording",
        words=[
            f"{minutes:g} min of 8 channels at 10 kHz: {n_samples / 1e6:.0f} million samples, {size_gb:.2f} GB as a "
            f"file, {16 * n_samples / 1e9:.1f} GB as arrays of times and values. Largest resident set and wall time "
            "of each command, in a process of its own."
        ],
        tables=[Table(head=("command", "memory", "time"), rows=rows)],
        goals=goals,
    )


def main() -> None:
    """Print the table."""
    from benchmarks.page import section_text

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--keep", type=Path, metavar="FILE", help="take the recording from there, or leave it there")
    options = parser.parse_args()
    print(section_text(measure(Clock(), options.minutes, options.keep)))


if __name__ == "__main__":
    main()
