"""What the fault matrix breaks and how it is told: the instruments, the sine that both see, the lines of the page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import tomli_w
from sawbench.acquisition.devices import load_instrument
from sawbench.acquisition.simulation.bench_server import TICK_S
from sawbench.bench.config import BenchConfig, LoadedConfig, parse_config
from sawbench.bench.recording import Signal

SECONDS, FAULT_AT_S, SINE_HZ = 9.0, 3.0, 10.0
MEAN = {"displacement_mm": 12.0}
AMPLITUDE = {"force_n": 200.0, "displacement_mm": 10.0, "motor_current_a": 40.0}
# What the clock leaves without any fault: see the first row of each instrument.
SILENT_ERROR_S = 0.0025
# The switch of `edge_times` sees the same sine as displacement, and closes where it rises through 10 mm.
EDGES = "stroke_rate_hz"
EDGE_ANGLE = float(np.arccos((MEAN["displacement_mm"] - 10.0) / AMPLITUDE["displacement_mm"]))
WITNESS = {"driver": "gsv8", "port": "witness", "rate_hz": 2000}


@dataclass(frozen=True, kw_only=True)
class Instrument:
    """One instrument under test, beside a witness that measures another channel."""

    name: str
    channel: str
    rate_hz: float
    table: dict[str, Any]
    n_bytes_12_ms: int
    witness: str = "displacement_mm"
    is_polled: bool = False
    has_processes: bool = True

    @property
    def silent_error_s(self) -> float:
        """Time error that has to be said, s: three samples of a slow instrument, a tick of the rig of a polled one."""
        return 2 * TICK_S if self.is_polled else max(SILENT_ERROR_S, 3.0 / self.rate_hz)

    @property
    def beyond(self) -> float:
        """What its input cannot mean, and its bytes still can."""
        return 2400.0 if self.name == "cia404" else 649.0 if self.name == "binary_frames" else 1e6

    @property
    def rate_words(self) -> str:
        """Its rate, or that it is asked."""
        if self.channel == EDGES:
            return "an edge a stroke"
        return "asked for every value" if self.is_polled else f"{self.rate_hz:g} Hz"

    def loaded(self) -> LoadedConfig:
        """Victim and witness, as a file holds them."""
        return parse_config(tomli_w.dumps({"devices": self._devices()}))

    def config(self) -> BenchConfig:
        """Victim and witness."""
        further = {EDGES: {"unit": "Hz", "range": [0, 100]}} if self.channel == EDGES else {}
        return BenchConfig(channels=further, devices=self._devices())

    def _devices(self) -> dict[str, dict[str, Any]]:
        calibration = {"displacement_mm": {"scale": 2.5}, "force_n": {"scale": 250.0}}[self.witness]
        channels = {self.witness: {"input": 1, "raw_range": [-10.5, 10.5], "calibration": calibration}}
        return {"victim": {"port": "victim", **self.table}, "witness": {**WITNESS, "channels": channels}}


def _further(name: str, channel: str, rate_hz: float, n_bytes_12_ms: int, *, is_polled: bool = False) -> Instrument:
    """An instrument as its own example has it, for the faults of its link alone."""
    table: dict[str, Any] = {"driver": name, **load_instrument(name).example}
    if "interface" in load_instrument(name).settings.model_fields:
        table["interface"] = "slcan"
    return Instrument(
        name=name, channel=channel, rate_hz=rate_hz, n_bytes_12_ms=n_bytes_12_ms, table=table, is_polled=is_polled,
        witness="force_n" if channel == "displacement_mm" else "displacement_mm", has_processes=False,
    )  # fmt: skip


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
    _further("msc7xxx", "displacement_mm", 100.0, 0, is_polled=True),
    _further("loadstar", "force_n", 150.0, 16),
    _further("mantracourt", "force_n", 100.0, 0, is_polled=True),
    _further("hx711", "force_n", 80.0, 10),
    _further("text_lines", "force_n", 500.0, 6 * 18),
    _further("binary_frames", "force_n", 1000.0, 12 * 8),
    _further("micro_epsilon_ethernet", "displacement_mm", 1041.67, 0),
    _further("mantracourt_can", "force_n", 250.0, 3 * 14),
    _further("cia404", "force_n", 100.0, 2 * 22),
    _further("edge_times", EDGES, SINE_HZ, 0, is_polled=True),
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
    if signal.channel == EDGES:
        inside = (signal.values > 0) & (signal.time_s < seconds)
        for low, high in marks:
            inside &= (signal.time_s < low) | (signal.time_s > high)
        return np.exp(1j * (2 * np.pi * SINE_HZ * signal.time_s[inside] - EDGE_ANGLE))
    found = []
    # Most of the samples of a stroke, and enough for three unknowns.
    fewest = max(6, min(20, 0.6 * len(signal.time_s) / (signal.duration_s * SINE_HZ)))
    for k in range(int(seconds * SINE_HZ)):
        start_s, end_s = k / SINE_HZ, (k + 1) / SINE_HZ
        inside = (signal.time_s >= start_s) & (signal.time_s < end_s)
        if inside.sum() < fewest or any(low < end_s and start_s < high for low, high in marks):
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
