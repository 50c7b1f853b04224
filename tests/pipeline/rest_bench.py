"""A tool at rest behind the simulated instruments, in a thread: noise, and on demand what goes wrong with sensors.

Shares no code with what judges or averages it.
"""

from __future__ import annotations

import contextlib
import io
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from acquisition.simulation.bench_server import run_bench
from acquisition.simulation.faults import Fault
from bench.config import load_config

CONFIG = Path(__file__).parents[2] / "bench_config.toml"
REST = {"force_n": 0.0, "displacement_mm": 4.0, "motor_current_a": 0.2, "battery_voltage_v": 18.0}
NOISE = {"force_n": 0.3, "displacement_mm": 0.01, "motor_current_a": 0.03, "battery_voltage_v": 0.005}


class RestingTool:
    """`behaviour`: channel -> function of (times, noise) that gives what the sensor says."""

    def __init__(self, behaviour: dict[str, Callable] | None = None) -> None:
        self._behaviour = behaviour or {}
        self._rng = np.random.default_rng(7)

    def read(self, channel, time_s):
        noise = self._rng.standard_normal(len(time_s))
        if channel in self._behaviour:
            return self._behaviour[channel](np.asarray(time_s), noise)
        return REST.get(channel, 0.0) + NOISE.get(channel, 0.03) * noise

    def trigger(self, time_s):
        del time_s


@contextlib.contextmanager
def resting_bench(behaviour=None, *, faults=(), clock_error_ppm=None, config_path=CONFIG):
    """Give the ports: device name -> address."""
    stop, out = threading.Event(), io.StringIO()
    thread = threading.Thread(
        target=run_bench,
        args=(RestingTool(behaviour), load_config(config_path).config),
        kwargs={
            "faults": tuple(Fault(**f) for f in faults),
            "clock_error_ppm": clock_error_ppm,
            "stop": stop,
            "watch_stdin": False,
            "out": out,
            "trigger_after_s": 1e9,
        },
        daemon=True,
    )
    thread.start()
    try:
        while "\n" not in out.getvalue():
            assert thread.is_alive(), "the bench did not start"
            time.sleep(0.002)
        yield json.loads(out.getvalue())
    finally:
        stop.set()
        thread.join(20)


def missampled(data: bytes, *, sent_baud: int, read_baud: int) -> bytes:
    """What a receiver at `read_baud` makes of `data` sent at `sent_baud`, 8N1, bit by bit."""
    bits = np.array([bit for byte in data for bit in (0, *(byte >> k & 1 for k in range(8)), 1)])
    ratio = sent_baud / read_baud

    def line(position: float) -> int:
        index = int(position)
        return int(bits[index]) if index < len(bits) else 1

    out, at = bytearray(), 0.0
    while at < len(bits):
        if line(at):
            at += 0.25
            continue
        # The middle of each of eight bits after the start bit, in the receiver's idea of time.
        out.append(sum(line(at + ratio * (1.5 + k)) << k for k in range(8)))
        at += ratio * 9.5
    return bytes(out)
