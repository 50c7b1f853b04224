"""Transient of the baseline machine: time steps while the crank is slow, angle steps once it turns.

From rest, and wherever the speed changes much within one angle step, Dormand-Prince steps in time with error
control; they end exactly on the dead centres. Between dead centres the crank angle takes over as the
independent variable: the trigonometry and the load are tabulated at the stages of equal steps, no step ever
straddles a reversal.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from modeling import slots
from modeling.compilation import kernel
from modeling.dense_output import at, emit, quintic, slope_at
from modeling.dormand_prince import FRACTIONS, angle_energy, angle_rate, angle_step, time_step
from modeling.machine import TWO_PI, cutter, drive, fill_tables, load, machine, source_rate

OK = 0
STALLED = 1
NO_CONVERGENCE = 2
EMPTY = 3

# What `record` holds at the end: five integrals, end state, error estimates, counts.
E_SUPPLIED, E_COPPER, E_CONVERTED, E_DAMPED, E_CUT = 0, 1, 2, 3, 4
END_CURRENT, END_SPEED, END_ANGLE, END_SOC, END_TIME = 5, 6, 7, 8, 9
ERROR_CURRENT, ERROR_SPEED = 10, 11
N_TIME_STEPS, N_ANGLE_STEPS = 12, 13
STOOD_S, LARGEST_ERROR, STEPS_PER_TURN = 14, 15, 16
N_RECORD = 17
MOST_STEPS_PER_TURN = 4096

MOST_TIME_STEPS = 2_000_000
CALM = 0.15  # largest relative change of speed within one angle step
NOTHING, DEAD_CENTRE, STANDSTILL, RELEASE = 0, 1, 2, 3


@kernel()
def simulate_baseline(p, spline, ocv, time_s, start, n_steps, tolerances, out, record):
    """Integrate from `start` = (i, W, a, soc) at time 0 to the last sample; fill `out` and `record`.

    Parameters
    ----------
    p : ndarray, shape (N_SLOTS,)
    spline : ndarray, shape (n_nodes, 4)
        Measured force, N; no rows where there is none.
    ocv : ndarray, shape (n_pieces, 4)
        Open-circuit voltage over the charge, V; no rows for Eq. 16.
    time_s : ndarray, shape (n,)
        Sample times, increasing, the first not negative.
    start : ndarray, shape (4,)
    n_steps : int
        Even number of angle steps a turn to begin with; doubled where the tolerance asks for it.
    tolerances : tuple of 2 floats
        Largest local error of an angle step and of a time step, relative to stall current and no-load speed.
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
    tables = np.empty((0, 6, 4))
    record[:] = 0.0
    turns = math.floor(start[2] / math.pi)  # half turns done; the angle is kept from the last dead centre on
    y = (start[0], start[1], start[2] - turns * math.pi, start[3])
    t = 0.0
    k = 0
    end = time_s[-1]
    voltage = max(m[9], m[8] * m[10])
    scales = (max(voltage / m[0], math.fabs(y[0]), 1e-3), max(voltage / m[2], math.fabs(y[1]), 1e-3))
    while k < len(time_s) and time_s[k] <= 0.0:
        out[0, k], out[1, k], out[2, k], out[3, k] = y[0], gear * y[1], start[2], y[3]
        k += 1
    status = OK
    is_coarse = False
    while t < end and status == OK:
        if not is_coarse:
            t, k, turns, y, status = time_phase(
                p, m, spline, ocv, time_s, k, t, y, turns, n_steps, tolerances[1], scales, False, out, record
            )
        if t < end and status == OK:
            if len(tables) != n_steps:
                tables = np.empty((n_steps, 6, 4))
                fill_tables(p, m, spline, n_steps, FRACTIONS, tables)
            t, k, turns, y, is_coarse = _angle_phase(
                m, tables, ocv, time_s, k, t, y, turns, gear, tolerances[0], scales, out, record
            )
            if is_coarse:
                n_steps *= 2
    record[END_CURRENT], record[END_SPEED], record[END_SOC], record[END_TIME] = y[0], y[1], y[3], t
    record[END_ANGLE] = turns * math.pi + y[2]
    record[STEPS_PER_TURN] = n_steps
    if status == OK and y[3] <= 0.0 and m[7] != slots.FIXED_VOLTAGE:
        status = EMPTY
    return status


@kernel()
def _second(m, curve, away, rates):
    """Second derivative of the current over time, A/s^2: Eq. 12 differentiated."""
    return (source_rate(m, curve, away, rates[2]) - m[0] * rates[0] - m[2] * rates[1]) * m[1]


@kernel()
def _over_time(w, rates):
    """Rates over time (di, dW, dsoc) from rates over the angle (di, dr, dsoc): dW = -W^2 dr."""
    return rates[0] * w, -rates[1] * w * w * w, rates[2] * w


@kernel()
def _angle_phase(m, tables, ocv, time_s, k, t, y, turns, gear, tolerance, scales, out, record):  # noqa: PLR0915
    """Take angle steps until the end is near, the speed changes much, or the steps are too long.

    The last value returned says that they are too long: the local error passed the tolerance.
    """
    n_steps = len(tables)
    half = n_steps // 2
    h = TWO_PI / n_steps
    end = time_s[-1]
    n_samples = len(time_s)
    begin = round(y[2] / h)
    place = begin + half * (turns % 2)
    i, w, soc = y[0], y[1], y[3]
    r = 1.0 / w
    first = angle_rate(m, tables[place, 0], drive(m, ocv, soc), i, r, 0.0)
    start_angle = turns * math.pi + begin * h
    count = 0
    is_coarse = False
    largest = 0.0
    rates = _over_time(w, first)
    e0 = e1 = e2 = e3 = e4 = error_i = error_w = 0.0
    while True:
        rows = tables[place]
        curve = drive(m, ocv, soc)
        i1, r1, away, last, duration, stages, ei, er = angle_step(m, rows, curve, h, i, r, first)
        t1 = t + duration
        w1 = 1.0 / r1
        if not (math.fabs(r1 - r) < CALM * r and t1 <= end):
            break
        local_i = math.fabs(h * ei) / scales[0]
        local_w = math.fabs(h * er) * w1 * w1 / scales[1]
        local = max(local_i, local_w)
        if local > tolerance and n_steps < MOST_STEPS_PER_TURN:
            is_coarse = True
            break
        energy = angle_energy(m, rows, h, stages)
        e0 += energy[0]
        e1 += energy[1]
        e2 += energy[2]
        e3 += energy[3]
        e4 += energy[4]
        rates1 = _over_time(w1, last)
        soc1 = soc + away
        if k < n_samples and time_s[k] <= t1:
            angle = start_angle + count * h
            current = quintic(
                duration,
                i,
                rates[0],
                _second(m, curve, 0.0, rates),
                i1,
                rates1[0],
                _second(m, curve, away, rates1),
            )
            path = quintic(duration, angle, w, rates[1], angle + h, w1, rates1[1])
            k = emit(time_s, k, out, gear, t, t1, current, path, soc, rates[2], soc1, rates1[2])
        error_i += local_i
        error_w += local_w
        largest = max(largest, local)
        count += 1
        place += 1
        if place == n_steps:
            place = 0
        t, i, r, w, soc, first, rates = t1, i1, r1, w1, soc1, last, rates1
    for c, e in ((0, e0), (1, e1), (2, e2), (3, e3), (4, e4)):
        record[c] += e
    record[ERROR_CURRENT] += error_i
    record[ERROR_SPEED] += error_w
    record[LARGEST_ERROR] = max(record[LARGEST_ERROR], largest)
    record[N_ANGLE_STEPS] += count
    done = (begin + count) // half
    return t, k, turns + done, (i, w, (begin + count - done * half) * h, soc), is_coarse


@kernel()
def _is_calm(p, m, y, n_steps):
    """Whether an angle step from this dead centre would change the speed only a little."""
    if y[1] <= 0.0:
        return False
    slow = 1.0 / y[1]
    change = slow * slow * m[3] * math.fabs(y[0]) / m[5] * TWO_PI / n_steps
    drag = slow * (m[4] + p[slots.K_FC] * p[slots.RADIUS] ** 2) / m[5] * TWO_PI / n_steps
    return change < CALM and drag < CALM


@kernel()
def time_phase(  # noqa: PLR0912, PLR0915
    p, m, spline, ocv, time_s, k, t, y, turns, n_steps, tolerance, scales, ends_at_once, out, record
):
    """Time steps with error control until a dead centre is reached at a calm speed (or at any), or the end.

    A step that runs over an event is taken again so that it ends on the event: a dead centre ahead, the
    crank coming to rest, or the motor overcoming the load at rest.
    """
    end = time_s[-1]
    c = cutter(p)
    gear = p[slots.GEAR]
    cuts_odd = c[4] < 0.0
    h = 0.05 / (m[0] * m[1])
    if y[1] > 0.0:
        h = min(h * 8.0, 0.3 / y[1])
    next_h = h
    moves = 1.0
    event = NOTHING
    tries = 0
    n_taken = 0
    while t < end:
        n_taken += 1
        if n_taken > MOST_TIME_STEPS or h < 1e-14:
            return t, k, turns, y, NO_CONVERGENCE
        is_second = turns % 2 == 1
        curve = drive(m, ocv, y[3])
        place = (is_second, is_second == cuts_odd, curve)
        if moves != 0.0 and y[1] <= 0.0 and _stays(c, m, spline, place, y):
            moves = 0.0
            y = (y[0], 0.0, y[2], y[3])
        h = min(h, end - t)
        new, rates, rates1, errors, energy = time_step(c, m, spline, place, h, y, moves)
        if event == NOTHING:
            ratio = max(errors[0] / scales[0], errors[1] / scales[1]) / tolerance
            if not ratio <= 1.0:
                h *= 0.2 if not ratio < 1e6 else max(0.2, 0.9 * ratio**-0.2)
                continue
            next_h = h * min(4.0, 0.9 * max(ratio, 1e-8) ** -0.2)
        current = quintic(
            h,
            y[0],
            rates[0],
            _second(m, curve, 0.0, rates),
            new[0],
            rates1[0],
            _second(m, curve, new[3] - y[3], rates1),
        )
        path = quintic(h, y[2], moves * y[1], rates[1], new[2], moves * new[1], rates1[1])
        if event == NOTHING:
            event, part = _first_event(c, m, spline, place, y, new, moves, current, path)
            tries = 0
            if event != NOTHING:
                h *= part
                continue
        elif event == DEAD_CENTRE and tries < 4 and math.fabs(math.pi - new[2]) > 1e-13 and new[1] > 0.0:
            tries += 1
            h += (math.pi - new[2]) / new[1]
            continue
        t1 = end if h >= end - t else t + h
        path = (path[0] + turns * math.pi, path[1], path[2], path[3], path[4], path[5])
        k = emit(time_s, k, out, gear, t, t1, current, path, y[3], rates[2], new[3], rates1[2])
        for kind in range(5):
            record[kind] += energy[kind]
        record[ERROR_CURRENT] += errors[0] / scales[0]
        record[ERROR_SPEED] += errors[1] / scales[1]
        record[N_TIME_STEPS] += 1
        record[STOOD_S] += (1.0 - moves) * (t1 - t)
        y, t, h = new, t1, next_h
        if event == DEAD_CENTRE:
            turns += 1
            y = (y[0], y[1], 0.0, y[3])
            if ends_at_once or _is_calm(p, m, y, n_steps):
                return t, k, turns, y, OK
        elif event == STANDSTILL:
            y = (y[0], 0.0, y[2], y[3])
        elif event == RELEASE:
            moves = 1.0
        event = NOTHING
    return t, k, turns, y, OK if moves != 0.0 else STALLED


@kernel()
def _first_event(c, m, spline, place, y, new, moves, current, path):
    """Find the event a step ran over, and the part of the step at which it happens."""
    if moves == 0.0:
        held = max(load(c, m, spline, place[0], y[2], place[1])[3], 0.0)
        if m[3] * new[0] > held:
            return RELEASE, _root(current, held / m[3], False)
    elif new[1] < 0.0:
        return STANDSTILL, _root(path, 0.0, True)
    elif new[2] > math.pi:
        return DEAD_CENTRE, _root(path, math.pi, False)
    return NOTHING, 1.0


@kernel()
def _stays(c, m, spline, place, y):
    """Whether a crank at rest stays there: a load only holds, it never drives the crank back."""
    torque = m[3] * y[0] - max(load(c, m, spline, place[0], y[2], place[1])[3], 0.0)
    return torque < 0.0 or (torque == 0.0 and max(m[9], m[8] * m[10]) <= 0.0)


@kernel()
def _root(path, level, of_slope):
    """Part of a step at which a quintic, or its slope falling, passes a level; bisection."""
    low, high = 0.0, 1.0
    for _ in range(52):
        u = 0.5 * (low + high)
        is_past = slope_at(path, u) < level if of_slope else at(path, u) > level
        if is_past:
            high = u
        else:
            low = u
    return high


@kernel(parallel=True)
def simulate_many(vectors, spline, ocv, time_s, starts, n_steps, tolerances, outs, codes):
    """`simulate_baseline` for every row of `vectors`, on all cores; `outs` has shape (n_cases, 4, n)."""
    for case in numba.prange(len(vectors)):
        record = np.empty(N_RECORD)
        codes[case] = simulate_baseline(
            vectors[case], spline, ocv, time_s, starts[case], n_steps, tolerances, outs[case], record
        )
