"""Run the extended kernel and hand its results over in the shape of a baseline run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modeling import baseline_kernel as baseline
from modeling import extended_kernel as kernel
from modeling import extended_physics as physics
from modeling import slots

Floats = NDArray[np.float64]
NOT_FROZEN: Floats = np.zeros(0)
N_RECORD = baseline.N_RECORD + 1


def scales(vector: Floats) -> tuple[float, float]:
    """Stall current, A, and no-load crank speed, rad/s: what local errors are measured by."""
    voltage = vector[slots.VOLTAGE]
    if vector[slots.MODE] == slots.FIXED_DUTY:
        voltage = vector[slots.DUTY] * vector[slots.NOMINAL_VOLTAGE]
    no_load = voltage / (vector[slots.BACK_EMF] * vector[slots.GEAR])
    return max(voltage / vector[slots.RESISTANCE], 1e-3), max(no_load, 1e-3)


def run_extended(
    vector: Floats, spline: Floats, ocv: Floats, time_s: Floats, start: Floats, tolerance: float, out: Floats
) -> tuple[int, Floats, Floats]:
    """Fill `out`, shape (4, n); return the status code, a record as the baseline's plus one place, and what is seen.

    The first five places of the record hold the terms of the energy balance themselves, J; its last the rest.
    """
    turns = int(np.floor(start[physics.ANGLE] / np.pi))
    state = np.zeros(physics.N_ALL)
    state[: physics.N_STATES] = start
    state[physics.ANGLE] -= turns * np.pi
    seen = np.empty((physics.N_SEEN, len(time_s)))
    end = np.empty(physics.N_ALL)
    counts = np.zeros(kernel.N_RECORD)
    counts[kernel.SCALE_CURRENT], counts[kernel.SCALE_SPEED] = scales(vector)
    # The chip of the first turn: as at three quarters of the no-load speed.
    counts[kernel.TURN_S] = 2 * np.pi / (0.75 * counts[kernel.SCALE_SPEED])
    time, turns, code = kernel.simulate_extended(
        vector, spline, ocv, time_s, state, turns, -1, NOT_FROZEN, tolerance, out, seen, end, counts
    )
    record = np.zeros(N_RECORD)
    record[:5] = end[[physics.SUPPLIED, physics.COPPER, physics.CONVERTED, physics.DAMPED, physics.CUT]]
    record[baseline.END_CURRENT], record[baseline.END_SPEED] = end[physics.CURRENT], end[physics.SPEED]
    record[baseline.END_ANGLE] = end[physics.ANGLE] + turns * np.pi
    record[baseline.END_SOC], record[baseline.END_TIME] = end[physics.SOC], time
    record[baseline.N_TIME_STEPS] = counts[kernel.N_STEPS]
    record[-1] = end[physics.OTHER]
    return code, record, seen
