"""What the fault matrix breaks and how it is told: the instruments, the sine that both see, the lines of the page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import tomli_w
from sawbench.bench.config import BenchConfig, LoadedConfig, parse_config
from sawbench.bench.recording import Signal

SECONDS, FAULT_AT_S, SINE_HZ = 9.0, 3.0, 10.0
MEAN = {"displacement_mm": 10.0}
AMPLITUDE = {"force_n": 200.0, "displacement_mm": 10.0, "motor_current_a": 40.0}
# What the clock leaves without any fault: see the first row of each instrument.
SILENT_ERROR_S = 0.0025
WITNESS = {"driver": "gsv8", "port": "x", "rate_hz": 2000}


@dataclass(frozen=True, kw_only=True)
class Instrument:
    """One instrument under test, beside a witness that measures another channel."""

    name: str
    channel: str
    rate_hz: float
    table: dict[str, Any]
    n_bytes_12_ms: int
    witness: str = "displacement_mm"

    def loaded(self) -> LoadedConfig:
        """Victim and witness, as a file holds them."""
        return parse_config(tomli_w.dumps({"devices": self._devices()}))

    def config(self) -> BenchConfig:
        """Victim and witness."""
        return BenchConfig(devices=self._devices())

    def _devices(self) -> dict[str, dict[str, Any]]:
        calibration = {"displacement_mm": {"scale": 2.5}, "force_n": {"scale": 250.0}}[self.witness]
        channels = {self.witness: {"input": 1, "raw_range": [-10.5, 10.5], "calibration": calibration}}
        return {"victim": {"port": "x", **self.table}, "witness": {**WITNESS, "channels": channels}}


FORCE = {"force_n": {"input": 1, "raw_range": [-3.5, 3.5], "calibration": {"scale": 250.0}}}
INSTRUMENTS = (
    Instrument(
        name="gsv8", channel="force_n", rate_hz=6000.0, n_bytes_12_ms=72 * 8,
        table={"driver": "gsv8", "rate_hz": 6000, "channels": FORCE},
    ),
    Instrument(
        name="gsv3", channel="force_n", rate_hz=1000.0, n_bytes_12_ms=12 * 3,
        table={"driver": "gsv3", "rate_hz": 1000, "channels": {"force_n": {**FORCE["force_n"], "raw_range": [-2, 2]}}},
    ),
    Instrument(
        name="dbc_can", channel="motor_current_a", rate_hz=1000.0, n_bytes_12_ms=12 * 22,
        table={
            "driver": "dbc_can", "interface": "slcan", "dbc": "jigsaw_bench.dbc", "counter": "SampleCounter",
            "signals": {"motor_current_a": "MotorStatus.MotorCurrent"},
        },
    ),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the page."""

    fault: str
    lost: str
    said: str
    time_error_ms: float | None
    is_silent: bool


def sine_of(channel: str, time_s: Any, noise: Any = 0.0) -> Any:
    """What every sensor sees: the same sine, so that a shift between channels shows."""
    return MEAN.get(channel, 0.0) - AMPLITUDE[channel] * np.cos(2 * np.pi * SINE_HZ * time_s) + 1e-4 * noise


def stroke_phases(signal: Signal, marks: list[tuple[float, float]], seconds: float = SECONDS) -> Any:
    """Phase factor of each stroke of the sine, complex, outside of what events mark."""
    found = []
    for k in range(int(seconds * SINE_HZ)):
        start_s, end_s = k / SINE_HZ, (k + 1) / SINE_HZ
        inside = (signal.time_s >= start_s) & (signal.time_s < end_s)
        if inside.sum() < 20 or any(low < end_s and start_s < high for low, high in marks):
            continue
        angle = 2 * np.pi * SINE_HZ * signal.time_s[inside]
        basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(angle)], axis=1)
        cosine, sine, _ = np.linalg.lstsq(basis, signal.values[inside], rcond=None)[0]
        found.append(-(cosine + 1j * sine) / np.hypot(cosine, sine))
    return np.array(found)


def worst_time_error_s(victim: Signal, witness: Signal, marks: list[tuple[float, float]], seconds: float) -> float:
    """Largest shift of a stroke of either against the witness as a whole, outside of `marks` of the victim."""
    strokes = stroke_phases(witness, [], seconds)
    if not len(strokes):
        return 0.0
    zero = np.mean(strokes)
    found = (strokes, stroke_phases(victim, marks, seconds))
    return max(float(np.max(np.abs(np.angle(f / zero)), initial=0.0)) / (2 * np.pi * SINE_HZ) for f in found)
