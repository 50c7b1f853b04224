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
N_RECORD = baseline.N_RECORD + 1 + 7  # the rest of the energy, then the state that a run can go on from


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
    """Fill `out`, shape (4, n); return the status, a longer record than the baseline's, and what is seen.

    The first five places of the record hold the terms of the energy balance themselves, J.
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
    record[baseline.N_RECORD] = end[physics.OTHER]
    turned = end[physics.ANGLE] + (turns % 2) * np.pi
    record[baseline.N_RECORD + 1 :] = (
        end[physics.SPEED] * vector[slots.GEAR],
        turned,
        *end[physics.FORCE : physics.N_STATES],
    )
    return code, record, seen


def end_state(record: Floats) -> dict[str, float]:
    """Fields of an InitialState that goes on from the end of a run with effects, its charge apart."""
    names = (
        "motor_speed_rad_s",
        "crank_angle_rad",
        "blade_force_n",
        "winding_temperature_rise_k",
        "rc_voltage_v",
        "polarization_v",
        "cut_distance_m",
    )
    state = {name: float(value) for name, value in zip(names, record[baseline.N_RECORD + 1 :], strict=True)}
    return {**state, "current_a": float(record[baseline.END_CURRENT])}
