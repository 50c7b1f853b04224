"""Strokes over the crank angle: one stroke, its derivatives, the periodic one by Newton's method.

The speed is carried as its inverse r = dt/da, which turns Eqs. 12 and 13 into polynomials; both are homogeneous, so
they are evaluated with voltage, current and torque per unit of speed, at speed 1. The derivatives of a stroke's end and
of its integrals by its start are stepped along by the same formula: they are exactly those of the discrete map, and
Newton's method converges quadratically.
"""

from __future__ import annotations

import math

from sawbench.modeling import slots
from sawbench.modeling.compilation import kernel
from sawbench.modeling.dormand_prince import compiled_step
from sawbench.modeling.machine import TWO_PI, drive, load_tables, machine, source, source_slopes
from sawbench.modeling.parts.crank import acceleration
from sawbench.modeling.parts.dc_motor import inductive_voltage

PERIODIC, NO_DRIVE, NOT_CONVERGED = 0, 1, 2
# Columns of a result row.
START_CURRENT, START_SPEED, PERIOD, MOTOR_CHARGE, BATTERY_CHARGE, N_STROKES, LOCAL_ERROR, STEPS = range(8)
N_PERIODIC = 8
MOST_NEWTON_STEPS = 30
MOST_STEPS = 4096
MOST_STEPS_TO_SETTLE = 1024  # with more, a stroke that there is has been found
STABLE = 3.0  # largest share of the fastest decay within one step that the formula of the steps bears
CALM = 0.15  # largest relative change of speed within one angle step
ACCEPT = 3e-4  # relative Newton step that is the last: it leaves an error of its square


@kernel()
def angle_rate(place, stage, y):
    """Rates over the crank angle of (i, r, change of the charge, time, motor charge).

    `place` is (machine, `load_at` at the stages of the step, `drive` at its start).
    """
    m, rows, curve = place
    row = rows[stage]
    i, r = y[0], y[1]
    e, battery_current = source(m, curve, y[2], i)
    di = inductive_voltage(m.resistance, m.back_emf, e * r, i * r, 1.0) * m.per_inductance
    dr = -r * acceleration(row[0], (m.torque_constant * i - row[3]) * r * r, row[2] * r, row[1], 1.0)
    return di, dr, -battery_current * m.per_capacity * r, r, i * r


@kernel()
def add5(y, a, k):
    """Add `a` times the rates `k` to five components."""
    return (y[0] + a * k[0], y[1] + a * k[1], y[2] + a * k[2], y[3] + a * k[3], y[4] + a * k[4])


angle_step = compiled_step(angle_rate, add5)


@kernel()
def tangent_rate(place, stage, y):
    """Rates over the angle of a stroke at a frozen charge, with its derivatives by the start (i0, r0).

    `y` holds i, r, di/di0, di/dr0, dr/di0, dr/dr0; then the integrals of dt, i dt and i_b dt, and the derivatives of
    the first two. `place` as in `angle_rate`.
    """
    m, rows, curve = place
    row = rows[stage]
    i, r, i_i, i_r, r_i, r_r = y[0], y[1], y[2], y[3], y[4], y[5]
    e, battery_current = source(m, curve, 0.0, i)
    e_slope = 0.0
    if m.mode == slots.HELD_VOLTAGE and e != m.voltage:
        e_slope = -m.sag_resistance
    torque = m.torque_constant * i - row[3]
    left = inductive_voltage(m.resistance, m.back_emf, e, i, 0.0)
    di = inductive_voltage(m.resistance, m.back_emf, e * r, i * r, 1.0) * m.per_inductance
    dr = -r * acceleration(row[0], torque * r * r, row[2] * r, row[1], 1.0)
    di_di, di_dr = (e_slope - m.resistance) * r * m.per_inductance, left * m.per_inductance
    dr_di = -row[0] * m.torque_constant * r * r * r
    dr_dr = -row[0] * (r * (3.0 * torque * r - 2.0 * row[2]) - row[1])
    return (
        di,
        dr,
        di_di * i_i + di_dr * r_i,
        di_di * i_r + di_dr * r_r,
        dr_di * i_i + dr_dr * r_i,
        dr_di * i_r + dr_dr * r_r,
        r,
        i * r,
        battery_current * r,
        r_i,
        r_r,
        i_i * r + i * r_i,
        i_r * r + i * r_r,
    )


@kernel()
def add13(y, a, k):
    """Add `a` times the rates `k` to thirteen components."""
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
        y[9] + a * k[9],
        y[10] + a * k[10],
        y[11] + a * k[11],
        y[12] + a * k[12],
    )


tangent_step = compiled_step(tangent_rate, add13)


@kernel()
def tangent_stroke(m, tables, curve, i, r):
    """One stroke from (i, r) at a frozen charge: the end as in `tangent_rate`, the largest local errors of i and r."""
    h = TWO_PI / len(tables)
    y = (i, r, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    worst_i = worst_r = 0.0
    k = tangent_rate((m, tables[0], curve), 0, y)
    for n in range(len(tables)):
        y, k, error_i, error_r = tangent_step((m, tables[n], curve), h, y, k)
        worst_i, worst_r = max(worst_i, error_i), max(worst_r, error_r)
    return y, worst_i, worst_r


@kernel()
def to_rest(y, miss_i, miss_r):
    """Solve (1 - derivative of the stroke map) x = miss, for (i, r)."""
    a, b, c, d = 1.0 - y[2], -y[3], -y[4], 1.0 - y[5]
    determinant = a * d - b * c
    return (d * miss_i - b * miss_r) / determinant, (a * miss_r - c * miss_i) / determinant


@kernel()
def is_too_coarse(m, n_steps, r):
    """Whether current or speed decays too fast for steps of the angle, at an inverse speed, to follow at all."""
    decay = max(m.resistance * m.per_inductance, (m.damping + m.k_fc * m.radius**2) / m.rotating_inertia)
    return decay * r * TWO_PI / n_steps > STABLE


@kernel()
def guess(m, tables, curve):
    """Guess current and inverse speed, A and s/rad, from the balance of mean torques; 0 where there is none."""
    drag = constant = 0.0
    for n in range(len(tables)):
        drag += tables[n, 0, 2] / len(tables)
        constant += tables[n, 0, 3] / len(tables)
    voltage = min(m.voltage, curve[0]) if m.mode == slots.HELD_VOLTAGE else curve[0]
    per_torque = m.resistance / m.torque_constant
    speed = (voltage - per_torque * constant) / (m.back_emf + per_torque * drag)
    if not speed > 0.0:
        return 0.0, 0.0
    return (constant + drag * speed) / m.torque_constant, 1.0 / speed


@kernel()
def solve_periodic(m, tables, curve, i, r, accept):
    """Newton's method for the periodic stroke from (i, r).

    Returns status, i, r, the last stroke as in `tangent_stroke`, the last step of i and r (included in them), the
    largest relative local error, and the strokes that it took.
    """
    scale_i = math.fabs(i) + 1e-3
    y = (i, r, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    step_i = step_r = local = 0.0
    if not r > 0.0:
        return NO_DRIVE, i, r, y, step_i, step_r, local, 0
    for count in range(MOST_NEWTON_STEPS):
        y, worst_i, worst_r = tangent_stroke(m, tables, curve, i, r)
        step_i, step_r = to_rest(y, y[0] - i, y[1] - r)
        if not (y[1] > 0.0 and math.fabs(step_i) < 1e300 and math.fabs(step_r) < 1e300):
            # The stroke did not get round: start faster.
            r *= 0.5
            if r * scale_i < 1e-12:
                return NO_DRIVE, i, r, y, step_i, step_r, local, count
            continue
        relative = max(math.fabs(step_r) / r, math.fabs(step_i) / scale_i)
        if relative < accept:
            local = max(worst_i / scale_i, worst_r / r)
            return PERIODIC, i + step_i, r + step_r, y, step_i, step_r, local, count + 1
        damping = min(1.0, 0.5 / relative)
        i += damping * step_i
        r += damping * step_r
        scale_i = math.fabs(i) + 1e-3
    return NOT_CONVERGED, i, r, y, step_i, step_r, local, MOST_NEWTON_STEPS


@kernel()
def periodic_state(p, spline, ocv, soc, n_steps, tolerance, accept, result):
    """Periodic stroke of one parameter vector at a state of charge; fills `result`, returns a status.

    Begins with `n_steps` steps a turn and doubles them until Newton's method settles and the largest local error,
    relative to current and speed, is below the tolerance. The Newton step that is below `accept` is the last: it
    leaves an error of its square.
    """
    m = machine(p)
    curve = drive(m, ocv, soc)
    i = r = 0.0
    n_strokes = 0
    while True:
        tables = load_tables(m, spline, n_steps)
        if n_strokes == 0:
            i, r = guess(m, tables, curve)
        status, i, r, y, step_i, step_r, local, count = solve_periodic(m, tables, curve, i, r, accept)
        n_strokes += count
        if status != PERIODIC:
            if not r > 0.0 or 2 * n_steps > MOST_STEPS_TO_SETTLE:
                return status
            n_steps, n_strokes = 2 * n_steps, 0
            continue
        if local <= tolerance or 2 * n_steps > MOST_STEPS:
            break
        n_steps *= 2
    more_time = y[9] * step_i + y[10] * step_r
    more_charge = y[11] * step_i + y[12] * step_r
    mean = y[7] / y[6]
    _, at_mean, _, slope = source_slopes(m, curve, mean)
    result[START_CURRENT], result[START_SPEED] = i, 1.0 / r
    result[PERIOD] = y[6] + more_time
    result[MOTOR_CHARGE] = y[7] + more_charge
    result[BATTERY_CHARGE] = y[8] + at_mean * more_time + slope * (more_charge - mean * more_time)
    result[LOCAL_ERROR], result[STEPS], result[N_STROKES] = local, n_steps, n_strokes
    return status


# Size: compiled, so what it takes and gives are numbers and arrays, each on its own.
@kernel()
def waveform(p, spline, ocv, soc, n_steps, i, w, current, speed):
    """Fill current and crank speed at the angles 2*pi*j/n_steps of a stroke from (i, W)."""
    m = machine(p)
    tables = load_tables(m, spline, n_steps)
    curve = drive(m, ocv, soc)
    y = (i, 1.0 / w, 0.0, 0.0, 0.0)
    k = angle_rate((m, tables[0], curve), 0, y)
    for n in range(n_steps):
        current[n], speed[n] = y[0], 1.0 / y[1]
        y, k, _, _ = angle_step((m, tables[n], curve), TWO_PI / n_steps, y, k)


@kernel()
def drifting_stroke(m, tables, ocv, i, r, soc, until):
    """One stroke with the charge running down, or its part until the charge reaches `until`.

    Returns the end (i, r, soc), duration, motor charge, and whether the steps are short enough for the change of speed.
    """
    h = TWO_PI / len(tables)
    t = charge = 0.0
    k = angle_rate((m, tables[0], drive(m, ocv, soc)), 0, (i, r, 0.0, 0.0, 0.0))
    for n in range(len(tables)):
        place = (m, tables[n], drive(m, ocv, soc))
        y, last, _, _ = angle_step(place, h, (i, r, 0.0, t, charge), k)
        if not math.fabs(y[1] - r) < CALM * r:
            return i, r, soc, t, charge, False
        if soc + y[2] < until:
            part = crossing_time(y[3] - t, soc, soc + y[2], k[2] / r, last[2] / y[1], until)
            return y[0], y[1], until, t + part, charge, True
        i, r, k = y[0], y[1], last
        soc, t, charge = soc + y[2], y[3], y[4]
    return i, r, soc, t, charge, True


@kernel()
def crossing_time(duration, soc0, soc1, rate0, rate1, level):
    """Time within a step at which the charge reaches a level; `rate` is dsoc/dt at both ends."""
    rise, a, b = soc1 - soc0, duration * rate0, duration * rate1
    low, high = 0.0, 1.0
    for _ in range(50):
        u = 0.5 * (low + high)
        if soc0 + u * (a + u * (3.0 * rise - 2.0 * a - b + u * (a + b - 2.0 * rise))) > level:
            low = u
        else:
            high = u
    return duration * high
