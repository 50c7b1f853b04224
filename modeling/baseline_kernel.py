"""Transient of the baseline machine: time steps while the crank is slow, angle steps once it turns.

From rest, and wherever the speed changes much within one angle step, Dormand-Prince steps in time with error control;
they end exactly on the dead centres. Between dead centres the crank angle takes over as the independent variable: the
trigonometry and the load are tabulated at the stages of equal steps, no step ever straddles a reversal.
"""

from __future__ import annotations

import math

import numpy as np

from modeling import slots
from modeling.compilation import kernel
from modeling.dense_output import at, emit, quintic, slope_at
from modeling.dormand_prince import FRACTIONS, angle_rate, angle_step, time_step
from modeling.machine import TWO_PI, fill_tables, load, machine, source_rate

OK = 0
STALLED = 1
NO_CONVERGENCE = 2
EMPTY = 3

# What `record` holds at the end: five integrals, end state, error estimates, counts.
E_SUPPLIED, E_COPPER, E_CONVERTED, E_DAMPED, E_CUT = 0, 1, 2, 3, 4
END_CURRENT, END_SPEED, END_ANGLE, END_SOC, END_TIME = 5, 6, 7, 8, 9
ERROR_CURRENT, ERROR_SPEED = 10, 11
N_TIME_STEPS, N_ANGLE_STEPS = 12, 13
STOOD_S = 14
N_RECORD = 15

MOST_TIME_STEPS = 2_000_000
CALM = 0.15  # largest relative change of speed within one angle step


@kernel()
def simulate_baseline(p, spline, time_s, start, n_steps, tolerance, out, record):
    """Integrate from `start` = (i, W, a, soc) at time 0 to the last sample; fill `out` and `record`.

    Parameters
    ----------
    p : ndarray, shape (N_SLOTS,)
    spline : ndarray, shape (n_nodes, 4)
        Measured force, N; no rows where there is none.
    time_s : ndarray, shape (n,)
        Sample times, increasing, the first not negative.
    start : ndarray, shape (4,)
    n_steps : int
        Even number of angle steps a turn.
    tolerance : float
        Local error of a time step relative to stall current and no-load speed.
    out : ndarray, shape (4, n)
        Filled with motor current, motor speed, crank angle, state of charge.
    record : ndarray, shape (N_RECORD,)

    Returns
    -------
    int
        OK, STALLED (the crank stands at the end), EMPTY or NO_CONVERGENCE.
    """
    m = machine(p)
    gear = p[slots.GEAR]
    tables = np.empty((n_steps, 6, 4))
    fill_tables(p, m, spline, n_steps, FRACTIONS, tables)
    record[:] = 0.0
    y = start.copy()
    turns = math.floor(y[2] / math.pi)  # half turns done
    y[2] -= turns * math.pi  # the angle is kept from the last dead centre on
    t = 0.0
    k = 0
    end = time_s[-1]
    scale_i = max(max(m[9], m[8] * m[10]) / m[0], math.fabs(y[0]), 1e-3)
    scale_w = max(max(m[9], m[8] * m[10]) / m[2], math.fabs(y[1]), 1e-3)
    while k < len(time_s) and time_s[k] <= 0.0:
        out[0, k], out[1, k], out[2, k], out[3, k] = y[0], gear * y[1], turns * math.pi + y[2], y[3]
        k += 1
    work = (np.empty((7, 6)), np.empty(4), np.empty(5))
    status = OK
    while t < end and status == OK:
        t, k, turns, status = _time_phase(
            p, m, spline, time_s, k, t, y, turns, n_steps, tolerance, scale_i, scale_w, out, record, work
        )
        if t < end and status == OK:
            t, k, turns = _angle_phase(
                m, tables, time_s, k, t, y, turns, n_steps, gear, scale_i, scale_w, out, record
            )
    record[END_CURRENT], record[END_SPEED], record[END_SOC], record[END_TIME] = y[0], y[1], y[3], t
    record[END_ANGLE] = turns * math.pi + y[2]
    if status == OK and y[3] <= 0.0 and m[7] != slots.FIXED_VOLTAGE:
        status = EMPTY
    return status


@kernel()
def _angle_phase(m, tables, time_s, k, t, y, turns, n_steps, gear, scale_i, scale_w, out, record):
    """Angle steps from a dead centre (y[2] = 0) until the end is near or the speed changes too much."""
    half = n_steps // 2
    h = TWO_PI / n_steps
    end = time_s[-1]
    place = half if turns % 2 else 0
    i, w, soc = y[0], y[1], y[3]
    rows = tables[place]
    first = angle_rate(m, rows[0, 0], rows[0, 1], rows[0, 2], rows[0, 3], i, w, soc)
    energy = np.zeros(5)
    angle = turns * math.pi
    count = 0
    di0, dw0, ds0 = first[0] * w, first[1] * w, first[2] * w
    dd0 = (source_rate(m, soc, ds0) - m[0] * di0 - m[2] * dw0) * m[1]
    error_i = 0.0
    error_w = 0.0
    while True:
        before = (energy[0], energy[1], energy[2], energy[3], energy[4])
        i1, w1, soc1, duration, last, ei, ew = angle_step(m, tables[place], h, i, w, soc, first, energy)
        if not (math.fabs(w1 - w) < CALM * w and t + duration <= end):
            for c in range(5):
                energy[c] = before[c]
            break
        t1 = t + duration
        di1, dw1, ds1 = last[0] * w1, last[1] * w1, last[2] * w1
        dd1 = (source_rate(m, soc1, ds1) - m[0] * di1 - m[2] * dw1) * m[1]
        if k < len(time_s) and time_s[k] <= t1:
            current = quintic(duration, i, di0, dd0, i1, di1, dd1)
            path = quintic(duration, angle + count * h, w, dw0, angle + (count + 1) * h, w1, dw1)
            k = emit(time_s, k, out, gear, t, t1, current, path, soc, ds0, soc1, ds1)
        error_i += math.fabs(ei)
        error_w += math.fabs(ew)
        count += 1
        place += 1
        if place == n_steps:
            place = 0
        t, i, w, soc, first = t1, i1, w1, soc1, last
        di0, dw0, ds0, dd0 = di1, dw1, ds1, dd1
    for c in range(5):
        record[c] += energy[c]
    record[ERROR_CURRENT] += error_i / scale_i
    record[ERROR_SPEED] += error_w / scale_w
    record[N_ANGLE_STEPS] += count
    done = count // half
    y[0], y[1], y[2], y[3] = i, w, (count - done * half) * h, soc
    return t, k, turns + done


@kernel()
def _is_calm(p, m, spline, y, turns, n_steps):
    """Whether an angle step from this dead centre would change the speed only a little."""
    if y[1] <= 0.0:
        return False
    slow = 1.0 / y[1]
    change = slow * slow * m[3] * math.fabs(y[0]) / m[5] * TWO_PI / n_steps
    drag = slow * (m[4] + p[slots.K_FC] * p[slots.RADIUS] ** 2) / m[5] * TWO_PI / n_steps
    return change < CALM and drag < CALM


@kernel()
def _time_phase(
    p, m, spline, time_s, k, t, y, turns, n_steps, tolerance, scale_i, scale_w, out, record, work
):
    """Time steps with error control until a dead centre is reached at a calm speed, or the end."""
    rates, new, energy = work
    end = time_s[-1]
    cuts_odd = p[slots.CUTTING_SIGN] < 0.0
    h = 0.05 / (m[0] * m[1])
    if y[1] > 0.0:
        h = min(h * 8.0, 0.3 / y[1])
    n_taken = 0
    is_held = False
    while t < end:
        n_taken += 1
        if n_taken > MOST_TIME_STEPS:
            return t, k, turns, NO_CONVERGENCE
        base = math.pi * (turns % 2)
        is_cutting = (turns % 2 == 1) == cuts_odd
        h = min(h, end - t)
        error_i, error_w = time_step(p, m, spline, base, is_cutting, h, y, is_held, rates, new, energy)
        if not is_held and y[1] <= 0.0 and (rates[0, 1] < 0.0 or (rates[0, 1] == 0.0 and rates[0, 0] <= 0.0)):
            is_held = True
            y[1] = 0.0
            continue
        ratio = max(error_i / scale_i, error_w / scale_w) / tolerance
        if not ratio <= 1.0:
            if h < 1e-12:
                return t, k, turns, NO_CONVERGENCE
            h *= 0.2 if not ratio < 1e6 else max(0.2, 0.9 * ratio**-0.2)
            continue
        grown = h * min(4.0, 0.9 * max(ratio, 1e-8) ** -0.2)
        t1 = end if h == end - t else t + h
        ends = _polynomials(m, h, y, new, rates)
        # Events: a dead centre ahead, the crank coming to rest, or leaving it again.
        event = 0
        if is_held:
            if _torque_at_rest(p, m, spline, base, is_cutting, new) > 0.0:
                h_event = _release(p, m, spline, base, is_cutting, h, y, new, ends)
                event = 3
        elif new[2] > math.pi * (1.0 + 1e-15):
            h_event = h * _crossing(ends[1], math.pi)
            event = 1
        elif new[1] < 0.0:
            h_event = h * _standstill(ends[1])
            event = 2
        if event and h_event < h * (1.0 - 1e-12):
            h = max(h_event, 1e-13)
            error_i, error_w = time_step(p, m, spline, base, is_cutting, h, y, is_held, rates, new, energy)
            if event == 1 and new[1] > 0.0:
                for _ in range(4):
                    miss = math.pi - new[2]
                    if math.fabs(miss) < 1e-13:
                        break
                    h += miss / new[1]
                    time_step(p, m, spline, base, is_cutting, h, y, is_held, rates, new, energy)
            t1 = min(t + h, end)
            ends = _polynomials(m, h, y, new, rates)
        if event == 1:
            new[2] = math.pi
        path = ends[1]
        shifted = (path[0] + turns * math.pi, path[1], path[2], path[3], path[4], path[5])
        k = emit(
            time_s, k, out, p[slots.GEAR], t, t1, ends[0], shifted, y[3], rates[0, 3], new[3], rates[6, 3]
        )
        for c in range(5):
            record[c] += energy[c]
        record[ERROR_CURRENT] += error_i / scale_i
        record[ERROR_SPEED] += error_w / scale_w
        record[N_TIME_STEPS] += 1
        if is_held:
            record[STOOD_S] += t1 - t
        y[:] = new
        t = t1
        h = grown
        if event == 2:
            y[1] = 0.0
            is_held = True
        elif event == 3:
            is_held = False
        elif event == 1:
            turns += 1
            y[2] = 0.0
            if _is_calm(p, m, spline, y, turns, n_steps):
                return t, k, turns, OK
    return t, k, turns, STALLED if is_held and t >= end else OK


@kernel()
def _polynomials(m, h, y, new, rates):
    """Quintics of current and angle over a time step."""
    curve0 = (source_rate(m, y[3], rates[0, 3]) - m[0] * rates[0, 0] - m[2] * rates[0, 1]) * m[1]
    curve1 = (source_rate(m, new[3], rates[6, 3]) - m[0] * rates[6, 0] - m[2] * rates[6, 1]) * m[1]
    return (
        quintic(h, y[0], rates[0, 0], curve0, new[0], rates[6, 0], curve1),
        quintic(h, y[2], rates[0, 2], rates[0, 1], new[2], rates[6, 2], rates[6, 1]),
    )


@kernel()
def _crossing(path, level):
    """Fraction of the step at which the angle reaches a level, by bisection closed with Newton steps."""
    low, high = 0.0, 1.0
    u = 0.5
    for _ in range(60):
        miss = at(path, u) - level
        if miss > 0.0:
            high = u
        else:
            low = u
        slope = slope_at(path, u)
        u = u - miss / slope if slope > 0.0 else 0.5 * (low + high)
        if not low < u < high:
            u = 0.5 * (low + high)
        if high - low < 1e-15 or math.fabs(miss) < 1e-14:
            break
    return u


@kernel()
def _standstill(path):
    """Fraction of the step at which the speed falls to 0."""
    low, high = 0.0, 1.0
    for _ in range(50):
        u = 0.5 * (low + high)
        if slope_at(path, u) > 0.0:
            low = u
        else:
            high = u
    return high


@kernel()
def _torque_at_rest(p, m, spline, base, is_cutting, y):
    """Torque that would set the crank in motion, N*m: the motor's less what the load can hold."""
    return m[3] * y[0] - max(load(p, m, spline, base + y[2], is_cutting)[3], 0.0)


@kernel()
def _release(p, m, spline, base, is_cutting, h, y, new, ends):
    """Time within a held step at which the motor overcomes the load."""
    held = max(load(p, m, spline, base + y[2], is_cutting)[3], 0.0)
    low, high = 0.0, 1.0
    for _ in range(50):
        u = 0.5 * (low + high)
        if m[3] * at(ends[0], u) > held:
            high = u
        else:
            low = u
    return h * high
