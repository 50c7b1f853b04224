"""Transient of the machine: time steps while the crank is slow, angle steps once it turns.

From rest, and wherever the speed changes much within one angle step, Dormand-Prince steps in time with error
control; they end exactly on the dead centres. Between dead centres the crank angle takes over as the
independent variable: the trigonometry and the load are tabulated at the stages of equal steps, no step ever
straddles a reversal.
"""

from __future__ import annotations

import math

import numpy as np
from sawbench.modeling import slots
from sawbench.modeling.compilation import kernel
from sawbench.modeling.dense_output import at, emit, mean, quintic, slope_at
from sawbench.modeling.dormand_prince import compiled_step
from sawbench.modeling.machine import TWO_PI, drive, load, load_tables, machine, source, source_rate
from sawbench.modeling.parts.crank import acceleration
from sawbench.modeling.parts.dc_motor import inductive_voltage
from sawbench.modeling.stroke_kernel import CALM, angle_rate

OK = 0
STALLED = 1
NO_CONVERGENCE = 2
EMPTY = 3

# What `record` holds at the end: five integrals, end state, and the charge through the motor in time steps.
E_SUPPLIED, E_COPPER, E_CONVERTED, E_DAMPED, E_CUT = 0, 1, 2, 3, 4
END_CURRENT, END_SPEED, END_ANGLE = 5, 6, 7
MOTOR_CHARGE = 8
N_RECORD = 9
MOST_STEPS_PER_TURN = 4096

MOST_TIME_STEPS = 2_000_000
NOTHING, DEAD_CENTRE, STANDSTILL, RELEASE = 0, 1, 2, 3


# Size: compiled, so what it takes and gives are numbers and arrays, each on its own.
@kernel()
def simulate_transient(p, spline, ocv, time_s, start, n_steps, tolerances, out, record):
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
    tables = np.empty((0, 6, 4))
    record[:] = 0.0
    turns = math.floor(start[2] / math.pi)  # half turns done; the angle is kept from the last dead centre on
    y = (start[0], start[1], start[2] - turns * math.pi, start[3])
    t = 0.0
    k = 0
    end = time_s[-1]
    voltage = max(m.voltage, m.duty * m.nominal_voltage)
    scales = (
        max(voltage / m.resistance, math.fabs(y[0]), 1e-3),
        max(voltage / m.back_emf, math.fabs(y[1]), 1e-3),
    )
    while k < len(time_s) and time_s[k] <= 0.0:
        out[0, k], out[1, k], out[2, k], out[3, k] = y[0], m.gear * y[1], start[2], y[3]
        k += 1
    status = OK
    is_coarse = False
    while t < end and status == OK:
        if not is_coarse:
            t, k, turns, y, status = time_phase(
                m, spline, ocv, time_s, k, t, y, turns, n_steps, tolerances[1], scales, False, out, record
            )
        if t < end and status == OK:
            if len(tables) != n_steps:
                tables = load_tables(m, spline, n_steps)
            t, k, turns, y, is_coarse = _angle_phase(
                m, tables, ocv, time_s, k, t, y, turns, tolerances[0], scales, out, record
            )
            if is_coarse:
                n_steps *= 2
    record[END_CURRENT], record[END_SPEED], record[END_ANGLE] = y[0], y[1], turns * math.pi + y[2]
    if status == OK and y[3] <= 0.0 and m.mode != slots.FIXED_VOLTAGE:
        status = EMPTY
    return status


@kernel()
def _second(m, curve, away, rates):
    """Second derivative of the current over time, A/s^2: Eq. 12 differentiated."""
    return inductive_voltage(m.resistance, m.back_emf, source_rate(m, curve, away, rates[2]), rates[0], rates[1]) * (
        m.per_inductance
    )


@kernel()
def _over_time(w, rates):
    """Rates over time (di, dW, dsoc) from rates over the angle (di, dr, dsoc, ...): dW = -W^2 dr."""
    return rates[0] * w, -rates[1] * w * w * w, rates[2] * w


@kernel()
def _energies(m, row, e, i, w):
    """Powers U i, i^2, i W, W^2 and that of cutting."""
    return (e - m.source_resistance * i) * i, i * i, i * w, w * w, (row[3] + (row[2] - m.damping) * w) * w


@kernel()
def _run_rate(place, stage, y):
    """`angle_rate` with the integrals of `_energies`."""
    m, rows, curve = place
    k = angle_rate(place, stage, y)
    e, _ = source(m, curve, y[2], y[0])
    power = _energies(m, rows[stage], e, y[0], 1.0 / y[1])
    r = y[1]
    return k[0], k[1], k[2], k[3], power[0] * r, power[1] * r, power[2] * r, power[3] * r, power[4] * r


@kernel()
def _time_rate(place, stage, y):
    """Rates over time of (i, W, a, soc) and of `_energies`.

    `place` is (machine, spline, is_second, is_cutting, `drive` and the charge it is for, 1.0 for a crank that moves).
    """
    m, spline, is_second, is_cutting, curve, soc, moves = place
    i, w = y[0], y[1]
    row = load(m, spline, is_second, y[2], is_cutting)
    e, battery_current = source(m, curve, y[3] - soc, i)
    di = inductive_voltage(m.resistance, m.back_emf, e, i, w) * m.per_inductance
    dw = acceleration(row[0], m.torque_constant * i - row[3], row[2], row[1], w)
    power = _energies(m, row, e, i, w)
    return (
        di,
        moves * dw,
        moves * w,
        -battery_current * m.per_capacity,
        power[0],
        power[1],
        power[2],
        power[3],
        power[4],
    )


@kernel()
def _add9(y, a, k):
    """Add `a` times the rates `k` to nine components."""
    return (
        y[0] + a * k[0],
        y[1] + a * k[1],
        y[2] + a * k[2],
        y[3] + a * k[3],
        y[4] + a * k[4],
        y[5] + a * k[5],
        y[6] + a * k[6],
        y[7] + a * k[7],
        y[8] + a * k[8],
    )


_run_step = compiled_step(_run_rate, _add9)
_time_step = compiled_step(_time_rate, _add9)


# Size: compiled; one state in registers: what one step leaves, the next one takes.
@kernel()
def _angle_phase(m, tables, ocv, time_s, k, t, y, turns, tolerance, scales, out, record):
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
    first = _run_rate((m, tables[place], drive(m, ocv, soc)), 0, (i, r, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    start_angle = turns * math.pi + begin * h
    count = 0
    is_coarse = False
    rates = _over_time(w, first)
    e0 = e1 = e2 = e3 = e4 = 0.0
    while True:
        curve = drive(m, ocv, soc)
        y1, last, error_i, error_r = _run_step(
            (m, tables[place], curve), h, (i, r, 0.0, 0.0, e0, e1, e2, e3, e4), first
        )
        i1, r1, t1, w1 = y1[0], y1[1], t + y1[3], 1.0 / y1[1]
        if not (math.fabs(r1 - r) < CALM * r and t1 <= end):
            break
        if max(error_i / scales[0], error_r * w1 * w1 / scales[1]) > tolerance and n_steps < MOST_STEPS_PER_TURN:
            is_coarse = True
            break
        rates1 = _over_time(w1, last)
        soc1 = soc + y1[2]
        if k < n_samples and time_s[k] <= t1:
            angle = start_angle + count * h
            second, second1 = _second(m, curve, 0.0, rates), _second(m, curve, y1[2], rates1)
            current = quintic(y1[3], i, rates[0], second, i1, rates1[0], second1)
            path = quintic(y1[3], angle, w, rates[1], angle + h, w1, rates1[1])
            k = emit(time_s, k, out, m.gear, t, t1, current, path, soc, rates[2], soc1, rates1[2])
        e0, e1, e2, e3, e4 = y1[4], y1[5], y1[6], y1[7], y1[8]
        count += 1
        place += 1
        if place == n_steps:
            place = 0
        t, i, r, w, soc, first, rates = t1, i1, r1, w1, soc1, last, rates1
    for c, e in ((0, e0), (1, e1), (2, e2), (3, e3), (4, e4)):
        record[c] += e
    done = (begin + count) // half
    return t, k, turns + done, (i, w, (begin + count - done * half) * h, soc), is_coarse


@kernel()
def is_calm(m, y, n_steps):
    """Whether an angle step from this dead centre would change the speed only a little."""
    if y[1] <= 0.0:
        return False
    part = TWO_PI / n_steps / (y[1] * m.rotating_inertia)
    change = m.torque_constant * math.fabs(y[0]) / y[1] * part
    return change < CALM and (m.damping + m.k_fc * m.radius**2) * part < CALM


# Size: compiled; one state in registers: what one step leaves, the next one takes.
@kernel()
def time_phase(  # noqa: PLR0912, PLR0915
    m, spline, ocv, time_s, k, t, y, turns, n_steps, tolerance, scales, ends_at_once, out, record
):
    """Time steps with error control until a dead centre is reached at a calm speed (or at any), or the end.

    A step that runs over an event is taken again so that it ends on the event: a dead centre ahead, the
    crank coming to rest, or the motor overcoming the load at rest.
    """
    end = time_s[-1]
    h = 0.05 / (m.resistance * m.per_inductance)
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
        is_cutting = is_second == (m.cutting_sign < 0.0)
        if moves != 0.0 and y[1] <= 0.0 and _stays(m, spline, is_second, is_cutting, y):
            moves = 0.0
            y = (y[0], 0.0, y[2], y[3])
        h = min(h, end - t)
        curve = drive(m, ocv, y[3])
        place = (m, spline, is_second, is_cutting, curve, y[3], moves)
        begin = (y[0], y[1], y[2], y[3], 0.0, 0.0, 0.0, 0.0, 0.0)
        rates = _time_rate(place, 0, begin)
        new, rates1, error_i, error_w = _time_step(place, h, begin, rates)
        if event == NOTHING:
            ratio = max(error_i / scales[0], error_w / scales[1]) / tolerance
            if not ratio <= 1.0:
                h *= 0.2 if not ratio < 1e6 else max(0.2, 0.9 * ratio**-0.2)
                continue
            next_h = h * min(4.0, 0.9 * max(ratio, 1e-8) ** -0.2)
        second = _second(m, curve, 0.0, (rates[0], rates[1], rates[3]))
        second1 = _second(m, curve, new[3] - y[3], (rates1[0], rates1[1], rates1[3]))
        current = quintic(h, y[0], rates[0], second, new[0], rates1[0], second1)
        path = quintic(h, y[2], moves * y[1], rates[1], new[2], moves * new[1], rates1[1])
        if event == NOTHING:
            held = max(load(m, spline, is_second, y[2], is_cutting)[3], 0.0)
            event, part = _first_event(m, held, new, moves, current, path)
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
        k = emit(time_s, k, out, m.gear, t, t1, current, path, y[3], rates[3], new[3], rates1[3])
        for kind in range(5):
            record[kind] += new[4 + kind]
        record[MOTOR_CHARGE] += (t1 - t) * mean(current)
        y, t, h = (new[0], new[1], new[2], new[3]), t1, next_h
        if event == DEAD_CENTRE:
            turns += 1
            y = (y[0], y[1], 0.0, y[3])
            if ends_at_once or is_calm(m, y, n_steps):
                return t, k, turns, y, OK
        elif event == STANDSTILL:
            y = (y[0], 0.0, y[2], y[3])
        elif event == RELEASE:
            moves = 1.0
        event = NOTHING
    return t, k, turns, y, OK if moves != 0.0 else STALLED


@kernel()
def _first_event(m, held, new, moves, current, path):
    """Find the event a step ran over, and the part of the step at which it happens."""
    if moves == 0.0:
        if m.torque_constant * new[0] > held:
            return RELEASE, _root(current, held / m.torque_constant, False)
    elif new[1] < 0.0:
        return STANDSTILL, _root(path, 0.0, True)
    elif new[2] > math.pi:
        return DEAD_CENTRE, _root(path, math.pi, False)
    return NOTHING, 1.0


@kernel()
def _stays(m, spline, is_second, is_cutting, y):
    """Whether a crank at rest stays there: a load only holds, it never drives the crank back."""
    torque = m.torque_constant * y[0] - max(load(m, spline, is_second, y[2], is_cutting)[3], 0.0)
    return torque < 0.0 or (torque == 0.0 and max(m.voltage, m.duty * m.nominal_voltage) <= 0.0)


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
