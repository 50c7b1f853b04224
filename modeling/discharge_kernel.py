"""Whole discharges of the baseline machine, stroke by stroke and by averaging over periodic strokes."""

from __future__ import annotations

import math

import numpy as np

from modeling import slots
from modeling.baseline_kernel import (
    CALM,
    N_RECORD,
    OK,
    STALLED,
    time_phase,
)
from modeling.compilation import kernel
from modeling.dormand_prince import FRACTIONS, angle_rate, angle_step
from modeling.frozen_effects import add_effects
from modeling.machine import TWO_PI, drive, fill_tables, machine, open_circuit

BY_SOC, BY_VOLTAGE, BY_STALL, BY_LIMIT, FAILED = 0, 1, 2, 3, 4
LONGEST_S = 1.0e7
LONGEST_START_S = 30.0  # a motor that has not turned the crank by then will not
# Columns of the curves: at the middle of a stroke.
TIME, SOC, VOLTAGE, BATTERY_CURRENT, MOTOR_CURRENT, RATE = range(6)
N_CURVES = 6


@kernel()
def start_up(p, m, spline, ocv, y, n_steps, tolerance, ends_at_once):
    """Run from `y` = (i, W, a, soc) until a dead centre is passed calmly, or at all.

    Returns time, state, half turns done and a status.
    """
    voltage = max(m[9], m[8] * m[10])
    scales = (max(voltage / m[0], 1e-3), max(voltage / m[2], 1e-3))
    record = np.zeros(N_RECORD)
    turns = math.floor(y[2] / math.pi)
    begin = (y[0], y[1], y[2] - turns * math.pi, y[3])
    t, _, turns, end, status = time_phase(
        p, m, spline, ocv, np.array([LONGEST_START_S]), 0, 0.0, begin, turns, n_steps, tolerance,
        scales, ends_at_once, np.empty((4, 1)), record,
    )  # fmt: skip
    if t >= LONGEST_START_S:
        status = STALLED
    return t, end, turns, status


@kernel()
def _crossing_time(duration, soc0, soc1, rate0, rate1, level):
    """Time within a step at which the charge reaches a level; `rate` is dsoc/dt at both ends."""
    low, high = 0.0, 1.0
    for _ in range(50):
        u = 0.5 * (low + high)
        rise = soc1 - soc0
        a, b = duration * rate0, duration * rate1
        value = soc0 + u * (a + u * (3.0 * rise - 2.0 * a - b + u * (a + b - 2.0 * rise)))
        if value > level:
            low = u
        else:
            high = u
    return duration * high


@kernel()
def brute_force(p, spline, ocv, start, n_steps, tolerance, cutoff_soc, cutoff_voltage, curves):  # noqa: PLR0912, PLR0915
    """Every stroke from `start` to a cut-off, angle steps from the first calm dead centre on.

    Parameters
    ----------
    cutoff_soc, cutoff_voltage : float
        The voltage is the mean over a stroke at the battery's terminals; below 0 for none.
    curves : ndarray, shape (n_rows, N_CURVES)
        Filled with every stroke that fits.

    Returns
    -------
    time, motor charge, battery charge, strokes, rows of curves filled, how it ended
    """
    m = machine(p)
    tables = np.empty((n_steps, 6, 4))
    fill_tables(p, m, spline, n_steps, FRACTIONS, tables)
    add_effects(p, n_steps, FRACTIONS, tables)
    h = TWO_PI / n_steps
    y = (start[0], start[1], start[2], start[3])
    t = 0.0
    motor_charge = 0.0
    n_rows = 0
    n_strokes = 0
    begin = y[3]
    while t < LONGEST_S:
        before_soc = y[3]
        waited, y, turns, status = start_up(p, m, spline, ocv, y, n_steps, tolerance, True)
        if status != OK:
            used = (begin - before_soc) / m[16]
            return t, motor_charge, used, n_strokes, n_rows, BY_STALL if status == STALLED else FAILED
        if y[3] <= cutoff_soc:
            t += waited * (before_soc - cutoff_soc) / (before_soc - y[3])
            return t, motor_charge, (begin - cutoff_soc) / m[16], n_strokes, n_rows, BY_SOC
        t += waited
        i, r, soc = y[0], 1.0 / y[1], y[3]
        place = (n_steps // 2) * (turns % 2)
        first = angle_rate(m, tables[place, 0], drive(m, ocv, soc), i, r, 0.0)
        t_mark, soc_mark, charge_mark = -1.0, soc, motor_charge
        before_v, before_t = -1.0, 0.0
        while True:
            if place == 0:
                if t_mark >= 0.0:
                    took = t - t_mark
                    current = (soc_mark - soc) / m[16] / took
                    ocv_middle, _, _ = open_circuit(m, ocv, 0.5 * (soc + soc_mark))
                    volt = ocv_middle - p[slots.BATTERY_RESISTANCE] * current
                    n_strokes += 1
                    if n_rows < len(curves):
                        row = curves[n_rows]
                        row[TIME], row[SOC], row[VOLTAGE] = 0.5 * (t + t_mark), 0.5 * (soc + soc_mark), volt
                        row[BATTERY_CURRENT], row[RATE] = current, 1.0 / took
                        row[MOTOR_CURRENT] = (motor_charge - charge_mark) / took
                        n_rows += 1
                    middle = 0.5 * (t + t_mark)
                    if volt <= cutoff_voltage:
                        reached = 0.5 * (soc + soc_mark)
                        if before_v > cutoff_voltage:
                            back = (cutoff_voltage - volt) / (before_v - volt)
                            reached += back * (middle - before_t) / took * (soc_mark - soc)
                            middle -= back * (middle - before_t)
                        return middle, motor_charge, (begin - reached) / m[16], n_strokes, n_rows, BY_VOLTAGE
                    before_v, before_t = volt, middle
                t_mark, soc_mark, charge_mark = t, soc, motor_charge
            curve = drive(m, ocv, soc)
            i1, r1, away, last, duration, stages, _, _ = angle_step(m, tables[place], curve, h, i, r, first)
            if not math.fabs(r1 - r) < CALM * r:
                half = n_steps // 2
                y = (i, 1.0 / r, (place % half) * h + (place // half) * math.pi, soc)
                break
            if soc + away <= cutoff_soc:
                t += _crossing_time(duration, soc, soc + away, first[2] / r, last[2] / r1, cutoff_soc)
                return t, motor_charge, (begin - cutoff_soc) / m[16], n_strokes, n_rows, BY_SOC
            motor_charge += h * stage_charge(stages)
            t += duration
            soc += away
            i, r, first = i1, r1, last
            place += 1
            if place == n_steps:
                place = 0
            if t > LONGEST_S:
                break
    return t, motor_charge, (begin - y[3]) / m[16], n_strokes, n_rows, BY_LIMIT


@kernel()
def stage_charge(stages):
    """Integral of i dt over an angle step, up to the factor h."""
    return (
        35 / 384 * stages[0][0] * stages[0][1]
        + 500 / 1113 * stages[1][0] * stages[1][1]
        + 125 / 192 * stages[2][0] * stages[2][1]
        - 2187 / 6784 * stages[3][0] * stages[3][1]
        + 11 / 84 * stages[4][0] * stages[4][1]
    )


@kernel()
def drifting_stroke(m, tables, ocv, h, i, r, soc, until):
    """One stroke with the charge running down, or its part until the charge reaches `until`.

    Returns the end (i, r, soc), duration, motor charge.
    """
    n_steps = len(tables)
    t = 0.0
    charge = 0.0
    first = angle_rate(m, tables[0, 0], drive(m, ocv, soc), i, r, 0.0)
    for n in range(n_steps):
        curve = drive(m, ocv, soc)
        i1, r1, away, last, duration, stages, _, _ = angle_step(m, tables[n], curve, h, i, r, first)
        if soc + away < until:
            t += _crossing_time(duration, soc, soc + away, first[2] / r, last[2] / r1, until)
            return i1, r1, until, t, charge
        t += duration
        soc += away
        charge += h * stage_charge(stages)
        i, r, first = i1, r1, last
    return i, r, soc, t, charge
