"""The simulated bench with sines for a plant, as a process of its own: `python sine_bench.py CONFIG JSON`."""

from __future__ import annotations

import json
import sys

import numpy as np
from sawbench.acquisition.simulation.bench_server import run_bench
from sawbench.acquisition.simulation.faults import Fault
from sawbench.bench.config import load_config

AMPLITUDE = {
    "force_n": 200.0,
    "displacement_mm": 10.0,
    "motor_current_a": 40.0,
    "battery_voltage_v": 2.0,
    "battery_current_a": 20.0,
}
MEAN = {"displacement_mm": 10.0, "battery_voltage_v": 17.0}
RATE_HZ = 10.0


class Sines:
    """Every channel is the same sine, so that a shift between channels shows."""

    def read(self, channel, time_s):
        return MEAN.get(channel, 0.0) + AMPLITUDE[channel] * np.sin(2 * np.pi * RATE_HZ * np.asarray(time_s))

    def trigger(self, time_s):
        sys.stderr.write(f"triggered at {time_s}\n")
        sys.stderr.flush()


if __name__ == "__main__":
    options = json.loads(sys.argv[2])
    faults = tuple(Fault(**fault) for fault in options.pop("faults", []))
    run_bench(Sines(), load_config(sys.argv[1]).config, faults=faults, **options)
