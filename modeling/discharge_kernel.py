"""A whole discharge stroke by stroke."""

from __future__ import annotations

import math

import numpy as np
from sawbench.modeling.compilation import kernel
from sawbench.modeling.machine import load_tables, machine, open_circuit
from sawbench.modeling.stroke_kernel import drifting_stroke
from sawbench.modeling.transient_kernel import (
    MOTOR_CHARGE,
    N_RECORD,
    NO_CONVERGENCE,
    OK,
    STALLED,
    is_calm,
    time_phase,
)

BY_SOC, BY_VOLTAGE, BY_STALL, BY_LIMIT, FAILED, COARSE = 0, 1, 2, 3, 4, 5
LONGEST_S = 1.0e7
_SWINGING = 2.0  # a crank that its blade swings is no faster than so many times its no-load speed
LONGEST_START_S = 30.0  # a motor that has not turned the crank by then will not
# Columns of the curves: at the middle of a stroke.
TIME, SOC, VOLTAGE, BATTERY_CURRENT, MOTOR_CURRENT, RATE = range(6)
N_CURVES = 6


@kernel()
def start_up(m, spline, ocv, y, n_steps, tolerance, must_be_calm):
    """Run from `y` = (i, W, a, soc) until the dead centre at angle 0 is passed, calmly where asked.

    Returns time, (i, r, soc) there, charge through the motor, strokes, and a status: NO_CONVERGENCE where the crank
    does not get faster any more and is not calm.
    """
    voltage = max(m.voltage, m.duty * m.nominal_voltage)
    scales = (max(voltage / m.resistance, 1e-3), max(voltage / m.back_emf, 1e-3))
    if must_be_calm and not is_calm(m, (0.0, _SWINGING * scales[1]), n_steps):
        return 0.0, y[0], 0.0, y[3], 0.0, 0, NO_CONVERGENCE
    record, out, limit = np.zeros(N_RECORD), np.empty((4, 1)), np.array([LONGEST_START_S])
    turns = math.floor(y[2] / math.pi)
    first_stroke = turns // 2
    y = (y[0], y[1], y[2] - turns * math.pi, y[3])
    t = fastest = 0.0
    while True:
        waited, _, turns, y, status = time_phase(
            m, spline, ocv, limit, 0, 0.0, y, turns, n_steps, tolerance, scales, True, out, record
        )
        t += waited
        charge, n_strokes = record[MOTOR_CHARGE], turns // 2 - first_stroke
        if status != OK or waited >= LONGEST_START_S:
            return t, y[0], 0.0, y[3], charge, n_strokes, status if status != OK else STALLED
        if turns % 2 == 0:
            if not must_be_calm or is_calm(m, y, n_steps):
                return t, y[0], 1.0 / y[1], y[3], charge, n_strokes, OK
            if y[1] <= fastest:
                return t, y[0], 0.0, y[3], charge, n_strokes, NO_CONVERGENCE
            fastest = y[1]


@kernel()
def brute_force(p, spline, ocv, start, settings, curves):
    """Every stroke from `start` to a cut-off; time steps where the speed changes much within an angle step.

    Parameters
    ----------
    p, spline, ocv, start : ndarray
        As in `transient_kernel.simulate_transient`.
    settings : tuple
        Steps a turn, tolerance of the time steps, cut-off charge, cut-off voltage (mean over a stroke at the battery's
        terminals; below 0 for none).
    curves : ndarray, shape (n_rows, N_CURVES)
        Filled with every stroke that fits.

    Returns
    -------
    time, motor charge, battery charge, strokes, rows of curves filled, how it ended
    """
    n_steps, tolerance, cutoff_soc, cutoff_voltage = settings
    m = machine(p)
    tables = load_tables(m, spline, n_steps)
    y = (start[0], start[1], start[2], start[3])
    begin = y[3]
    t = motor_charge = 0.0
    n_rows = n_strokes = 0
    has_started = False
    before_volts, before_middle = -1.0, 0.0
    while t < LONGEST_S:
        soc = y[3]
        is_whole = False
        if has_started:
            i1, r1, soc1, took, charge, is_whole = drifting_stroke(m, tables, ocv, y[0], 1.0 / y[1], soc, cutoff_soc)
            passed = 1
        if not is_whole:
            took, i1, r1, soc1, charge, passed, status = start_up(m, spline, ocv, y, n_steps, tolerance, False)
            if status != OK:
                used = (begin - soc) / m.per_capacity
                return t, motor_charge, used, n_strokes, n_rows, BY_STALL if status == STALLED else FAILED
            if soc1 < cutoff_soc:
                part = (soc - cutoff_soc) / (soc - soc1)
                took, charge, soc1 = part * took, part * charge, cutoff_soc
        if soc1 <= cutoff_soc:
            used = (begin - cutoff_soc) / m.per_capacity
            return t + took, motor_charge + charge, used, n_strokes, n_rows, BY_SOC
        motor_charge += charge
        n_strokes += passed
        if has_started:
            current, half, middle = (soc - soc1) / m.per_capacity / took, 0.5 * (soc + soc1), t + 0.5 * took
            volts = open_circuit(m, ocv, half)[0] - m.battery_resistance * current
            if n_rows < len(curves):
                row = curves[n_rows]
                row[TIME], row[SOC], row[VOLTAGE], row[BATTERY_CURRENT] = middle, half, volts, current
                row[MOTOR_CURRENT], row[RATE] = charge / took, 1.0 / took
                n_rows += 1
            if volts <= cutoff_voltage:
                if before_volts > cutoff_voltage:
                    back = (cutoff_voltage - volts) / (before_volts - volts) * (middle - before_middle)
                    half += back / took * (soc - soc1)
                    middle -= back
                return middle, motor_charge, (begin - half) / m.per_capacity, n_strokes, n_rows, BY_VOLTAGE
            before_volts, before_middle = volts, middle
        has_started = True
        t += took
        y = (i1, 1.0 / r1, 0.0, soc1)
    return t, motor_charge, (begin - y[3]) / m.per_capacity, n_strokes, n_rows, BY_LIMIT
