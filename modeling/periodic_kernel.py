"""The periodic stroke of the baseline machine: Newton's method on the stroke map."""

from __future__ import annotations

import math

import numba
import numpy as np

from modeling import slots
from modeling.compilation import kernel
from modeling.dormand_prince import FRACTIONS, angle_rate, angle_step
from modeling.frozen_effects import add_effects
from modeling.machine import TWO_PI, drive, fill_tables, machine, open_circuit, source_slopes
from modeling.stroke_map import tangent_stroke

PERIODIC, NO_DRIVE, NOT_CONVERGED = 0, 1, 2
# Columns of a result row.
START_CURRENT, START_SPEED, PERIOD, MOTOR_CHARGE, BATTERY_CHARGE, SQUARE, N_STROKES, LOCAL_ERROR, STEPS = range(9)
N_PERIODIC = 9
MOST_NEWTON_STEPS = 30
MOST_STEPS = 4096
ACCEPT = 3e-4  # residual whose last Newton correction leaves an error of its square


@kernel()
def guess(m, tables, curve):
    """Guess current and crank speed at angle 0, A and rad/s; 0 where the mean torques balance at no speed.

    The mean torque balance, and on top of it the linear response to the first two harmonics of the load.
    """
    n_steps = len(tables)
    per_speed = 0.0
    constant = 0.0
    for n in range(n_steps):
        per_speed += tables[n, 0, 2]
        constant += tables[n, 0, 3]
    per_speed /= n_steps
    constant /= n_steps
    voltage = min(m[9], curve[0]) - m[19] if m[7] == slots.HELD_VOLTAGE else curve[0]
    speed = (voltage - m[0] * constant / m[3]) / (m[2] + m[0] * per_speed / m[3])
    if not speed > 0.0:
        return 0.0, 0.0
    current = (constant + per_speed * speed) / m[3]
    turn_re, turn_im = math.cos(TWO_PI / n_steps), math.sin(TWO_PI / n_steps)
    start_i, start_w = current, speed
    step = complex(turn_re, -turn_im)
    for harmonic in (1, 2):
        step = step if harmonic == 1 else step * step
        place = complex(2.0 / n_steps, 0.0)
        torque = complex(0.0, 0.0)
        for n in range(n_steps):
            torque += place * (tables[n, 0, 2] * speed + tables[n, 0, 3] + tables[n, 0, 1] * speed * speed)
            place *= step
        rate = complex(0.0, harmonic * speed)
        impedance = m[0] + rate / m[1]
        ripple = -torque / (rate / tables[0, 0, 0] + per_speed + m[3] * m[2] / impedance)
        start_w += ripple.real
        start_i -= (m[2] * ripple / impedance).real
    return start_i, max(start_w, 0.2 * speed)


@kernel()
def solve_periodic(m, tables, curve, i, w, accept, result):
    """Newton iteration from (i, W) at angle 0; fills `result`, shape (N_PERIODIC,), returns a status."""
    n_steps = len(tables)
    h = TWO_PI / n_steps
    if not w > 0.0:
        return NO_DRIVE
    r = 1.0 / w
    scale_i = math.fabs(i) + 1e-3
    for count in range(MOST_NEWTON_STEPS):
        y, q, worst_i, worst_r = tangent_stroke(m, tables, curve, h, i, r)
        miss_i, miss_r = y[0] - i, y[1] - r
        a, b, c, d = 1.0 - y[2], -y[3], -y[4], 1.0 - y[5]
        determinant = a * d - b * c
        step_i = (d * miss_i - b * miss_r) / determinant
        step_r = (a * miss_r - c * miss_i) / determinant
        if not (y[1] > 0.0 and math.fabs(step_i) < 1e300 and math.fabs(step_r) < 1e300):
            # The stroke did not get round: start faster.
            r *= 0.5
            if r * scale_i < 1e-12:
                return NO_DRIVE
            continue
        relative = max(math.fabs(step_r) / r, math.fabs(step_i) / scale_i)
        if relative < accept:
            result[START_CURRENT] = i + step_i
            result[START_SPEED] = 1.0 / (r + step_r)
            more_time = q[3] * step_i + q[4] * step_r
            more_charge = q[5] * step_i + q[6] * step_r
            mean = q[1] / q[0]
            _, at_mean, _, slope = source_slopes(m, curve, mean)
            result[PERIOD] = q[0] + more_time
            result[MOTOR_CHARGE] = q[1] + more_charge
            result[BATTERY_CHARGE] = q[2] + at_mean * more_time + slope * (more_charge - mean * more_time)
            result[LOCAL_ERROR] = max(worst_i / scale_i, worst_r / r)
            result[STEPS] = n_steps
            result[N_STROKES] = count + 1
            return PERIODIC
        damping = min(1.0, 0.5 / relative)
        i += damping * step_i
        r += damping * step_r
    return NOT_CONVERGED


@kernel()
def periodic_state(p, spline, ocv, soc, n_steps, tolerance, accept, result):
    """Periodic stroke of one parameter vector at a state of charge, from a cold start.

    Begins with `n_steps` steps a turn and doubles them until the largest local error, relative to current
    and speed, is below the tolerance. The Newton step that is below `accept` is the last: it leaves an error
    of its square.
    """
    m = machine(p)
    curve = drive(m, ocv, soc)
    tables = np.empty((n_steps, 6, 4))
    fill_tables(p, m, spline, n_steps, FRACTIONS, tables)
    add_effects(p, n_steps, FRACTIONS, tables)
    i, w = guess(m, tables, curve)
    status = solve_periodic(m, tables, curve, i, w, accept, result)
    while status == PERIODIC and result[LOCAL_ERROR] > tolerance and 2 * n_steps <= MOST_STEPS:
        n_steps *= 2
        tables = np.empty((n_steps, 6, 4))
        fill_tables(p, m, spline, n_steps, FRACTIONS, tables)
        add_effects(p, n_steps, FRACTIONS, tables)
        before = result[N_STROKES]
        status = solve_periodic(m, tables, curve, result[START_CURRENT], result[START_SPEED], accept, result)
        result[N_STROKES] += before
    return status


@kernel()
def waveform(p, spline, ocv, soc, n_steps, i, w, current, speed):
    """Fill current and crank speed at the angles 2*pi*j/n_steps of a stroke from (i, W); returns its error.

    The error is the largest embedded local error of the steps, relative to the largest current and speed.
    """
    m = machine(p)
    tables = np.empty((n_steps, 6, 4))
    fill_tables(p, m, spline, n_steps, FRACTIONS, tables)
    add_effects(p, n_steps, FRACTIONS, tables)
    curve = drive(m, ocv, soc)
    h = TWO_PI / n_steps
    r = 1.0 / w
    largest_i = 1e-3
    worst_i = 0.0
    worst_r = 0.0
    first = angle_rate(m, tables[0, 0], curve, i, r, 0.0)
    for n in range(n_steps):
        current[n], speed[n] = i, 1.0 / r
        largest_i = max(largest_i, math.fabs(i))
        i, r, _, first, _, _, error_i, error_r = angle_step(m, tables[n], curve, h, i, r, first)
        worst_i = max(worst_i, math.fabs(h * error_i))
        worst_r = max(worst_r, math.fabs(h * error_r) / r)
    return max(worst_i / largest_i, worst_r)


@kernel(parallel=True)
def periodic_states(vectors, spline, ocv, soc, n_steps, tolerance, results, statuses):
    """`periodic_state` for every row of `vectors`, on all cores."""
    for case in numba.prange(len(vectors)):
        statuses[case] = periodic_state(
            vectors[case], spline, ocv, soc[case], n_steps, tolerance, ACCEPT, results[case]
        )


@kernel()
def open_circuit_voltage(p, ocv, soc):
    """Open-circuit voltage of the battery in a vector, V."""
    return open_circuit(machine(p), ocv, soc)[0]


@kernel()
def lag_gains(p, spline, ocv, soc, n_steps, i, w):
    """Return what a lag of the state behind the periodic one costs: sums over the strokes it takes to settle.

    Time and motor charge by current (s/A, A s/A), then by inverse speed (s/(s/rad), A s/(s/rad)): the
    derivatives of a stroke's integrals times the inverse of 1 less the map's derivative.
    """
    m = machine(p)
    tables = np.empty((n_steps, 6, 4))
    fill_tables(p, m, spline, n_steps, FRACTIONS, tables)
    add_effects(p, n_steps, FRACTIONS, tables)
    y, q, _, _ = tangent_stroke(m, tables, drive(m, ocv, soc), TWO_PI / n_steps, i, 1.0 / w)
    a, b, c, d = 1.0 - y[2], -y[3], -y[4], 1.0 - y[5]
    determinant = a * d - b * c
    return (
        (q[3] * d - q[4] * c) / determinant,
        (q[5] * d - q[6] * c) / determinant,
        (q[4] * a - q[3] * b) / determinant,
        (q[6] * a - q[5] * b) / determinant,
    )
