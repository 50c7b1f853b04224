"""A long recording: `python -m benchmarks.soak --minutes 60` says what is missing, and what it costs.

Four channels of 10 kHz, on one to four GSV-8 amplifiers, are emulated in a process of their own, on real ptys in real
time; `sawbench record` records them in another. Processor time and memory of the recorder, and of a live view beside
it, are read from /proc, so this needs Linux.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray
from sawbench.acquisition.simulation.bench_server import run_bench
from sawbench.bench.config import load_config

RATE_HZ = 10_000
CHANNELS = {"force_n": 250.0, "displacement_mm": 2.5, "motor_current_a": 10.0, "battery_voltage_v": 2.0}
LOOK_EVERY_S = 5.0
# Imports, the first strokes and the tables of the clocks come before this.
WARM_S = 60.0
_TICKS_A_S = os.sysconf("SC_CLK_TCK")
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


class Strokes:
    """A plant that costs next to nothing: 14 strokes a second, with noise from a table."""

    def __init__(self) -> None:
        self._noise = np.random.default_rng(17).standard_normal(1 << 16)
        self._begun_s = np.inf

    def trigger(self, time_s: float) -> None:
        self._begun_s = time_s

    def read(self, channel: str, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        angle = 2 * np.pi * 14.0 * np.maximum(time_s - self._begun_s, 0.0) if np.isfinite(self._begun_s) else 0 * time_s
        noise = np.take(self._noise, np.rint(time_s * RATE_HZ).astype(np.int64), mode="wrap")
        mean, amplitude, scatter = {
            "force_n": (0.0, 150.0, 0.3),
            "displacement_mm": (10.0, -10.0, 0.003),
            "motor_current_a": (0.0, 10.0, 0.03),
            "battery_voltage_v": (18.0, -0.1, 0.002),
        }[channel]
        wave = np.sin(angle) if channel != "displacement_mm" else np.cos(angle)
        return mean + amplitude * wave + scatter * noise


def config_text(n_amplifiers: int, ports: dict[str, str] | None = None) -> str:
    """The four channels on `n_amplifiers` amplifiers, 1, 2 or 4."""
    devices: dict[str, dict[str, Any]] = {}
    for k, (channel, scale) in enumerate(CHANNELS.items()):
        name = f"amplifier_{k % n_amplifiers + 1}"
        table = devices.setdefault(name, {"driver": "gsv8", "port": (ports or {}).get(name, name), "rate_hz": RATE_HZ})
        wired = table.setdefault("channels", {})
        wired[channel] = {"input": len(wired) + 1, "raw_range": [-20.0, 20.0], "calibration": {"scale": scale}}
    return tomli_w.dumps({"devices": devices})


@dataclass(frozen=True, kw_only=True)
class Look:
    """Processor time (s) and resident memory (bytes) of a process and its children, at `time_s`."""

    time_s: float
    cpu_s: float
    memory_bytes: int


def look_at(pid: int, time_s: float) -> Look:
    """Sum over the process and what it started."""
    cpu_s, memory = 0.0, 0
    waiting = [pid]
    while waiting:
        process = waiting.pop()
        folder = Path(f"/proc/{process}")
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            children = [(task / "children").read_text().split() for task in (folder / "task").iterdir()]
        except (FileNotFoundError, ProcessLookupError):
            continue
        cpu_s += (int(fields[11]) + int(fields[12])) / _TICKS_A_S
        memory += int(fields[21]) * _PAGE_BYTES
        waiting += [int(child) for group in children for child in group]
    return Look(time_s=time_s, cpu_s=cpu_s, memory_bytes=memory)


def watch(process: subprocess.Popen[str]) -> tuple[list[Look], list[Look]]:
    """Look at the recorder alone, and at it with its children, until it ends."""
    alone, together = [], []
    begun_s = time.monotonic()
    while process.poll() is None:
        now_s = time.monotonic() - begun_s
        together.append(look_at(process.pid, now_s))
        alone.append(_without_children(process.pid, now_s))
        time.sleep(LOOK_EVERY_S)
    return [look for look in alone if look.memory_bytes], [look for look in together if look.memory_bytes]


def _without_children(pid: int, time_s: float) -> Look:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return Look(time_s=time_s, cpu_s=0.0, memory_bytes=0)
    cpu_s = (int(fields[11]) + int(fields[12])) / _TICKS_A_S
    return Look(time_s=time_s, cpu_s=cpu_s, memory_bytes=int(fields[21]) * _PAGE_BYTES)


def figures(looks: list[Look]) -> dict[str, float]:
    """Share of a core and memory after the first minute, and how fast the memory rises."""
    later = [look for look in looks if look.time_s >= min(WARM_S, looks[-1].time_s / 2)]
    first, last = later[0], later[-1]
    times, memory = (np.array([getattr(look, name) for look in later]) for name in ("time_s", "memory_bytes"))
    # By halves: a single large allocation is no slope.
    half = len(later) // 2
    middle = [float(np.median(part)) for part in (memory[:half], memory[half:])] if half else [float(memory[0])] * 2
    span_s = float(np.median(times[half:]) - np.median(times[:half])) if half else 1.0
    return {
        "share_of_a_core": (last.cpu_s - first.cpu_s) / max(last.time_s - first.time_s, 1e-9),
        "memory_mb_first": first.memory_bytes / 1e6,
        "memory_mb_last": last.memory_bytes / 1e6,
        "memory_mb_most": float(memory.max()) / 1e6,
        "memory_mb_a_minute": (middle[1] - middle[0]) / 1e6 / span_s * 60,
    }


def soak(minutes: float, folder: Path, *, n_amplifiers: int, live: bool) -> dict[str, object]:
    """Record for `minutes` and return the figures."""
    config = folder / "bench_config.toml"
    config.write_text(config_text(n_amplifiers))
    instruments = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.soak", "--instruments", str(config)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert instruments.stdout is not None
        config.write_text(config_text(n_amplifiers, json.loads(instruments.stdout.readline())))
        call = [sys.executable, "-m", "sawbench.commands.main", "record", "--material", "none", "--trial", "soak"]
        call += ["--seconds", str(60 * minutes), "--out", str(folder), "--config", str(config), "--json"]
        call += ["--live"] if live else []
        with (folder / "recorder.txt").open("w") as said, (folder / "summary.json").open("w+") as out:
            process = subprocess.Popen(call, stdin=subprocess.DEVNULL, stdout=out, stderr=said, text=True)
            alone, together = watch(process)
            out.seek(0)
            text = out.read()
    finally:
        assert instruments.stdin is not None
        instruments.stdin.close()
        instruments.wait(20)
    if process.returncode not in {0, 1} or not text:
        raise SystemExit(f"the recorder ended with {process.returncode}: {(folder / 'recorder.txt').read_text()}")
    summary = json.loads(text)
    (folder / "looks.json").write_text(json.dumps([asdict(look) for look in alone]))
    return {
        "minutes": minutes,
        "n_amplifiers": n_amplifiers,
        "live": live,
        "exit_code": process.returncode,
        "n_samples": sum(c["n_samples"] for c in summary["channels"]),
        "n_missing": sum(c["n_missing"] for c in summary["channels"]),
        "n_gaps": sum(c["n_gaps"] for c in summary["channels"]),
        "file_mb": Path(summary["path"]).stat().st_size / 1e6,
        "recorder": figures(alone),
        "with_its_children": figures(together),
    }


def main() -> None:
    """Run the instruments, or the whole."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--amplifiers", type=int, choices=(1, 2, 4), default=4, help="that share the four channels")
    parser.add_argument("--live", action="store_true", help="with a live view, whose process is counted apart")
    parser.add_argument("--folder", type=Path, help="keep the recording there")
    parser.add_argument("--instruments", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.instruments is not None:
        run_bench(Strokes(), load_config(options.instruments).config, transport="pty", trigger_after_s=2.0)
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        print(json.dumps(soak(options.minutes, folder, n_amplifiers=options.amplifiers, live=options.live), indent=2))


if __name__ == "__main__":
    main()
