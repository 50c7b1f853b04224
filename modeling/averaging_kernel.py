"""A whole discharge from periodic strokes at a few states of charge.

The charge of one stroke is some 6e-5 of the battery's, so the machine runs close to the stroke that would be
periodic at a frozen charge. With T(s) and q(s) the duration and the charge fraction of the stroke whose
middle is at s,

    runtime = t_0 + integral of T/q over s,    strokes = integral of 1/q,

by Gauss-Legendre nodes. Four small terms bring the error from 2e-4 to 1e-6: the strokes of the start-up are
simulated, what is left of it decays with the stroke map's own eigenvalues and is summed in closed form; the
strokes at the nodes drift, P_drift(X) - X = -q dX*/ds; and the last, unfinished stroke is simulated.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from modeling import slots
from modeling.compilation import kernel
from modeling.discharge_kernel import FAILED, drifting_stroke, start_up
from modeling.dormand_prince import FRACTIONS, angle_rate, angle_step
from modeling.frozen_effects import add_effects
from modeling.machine import TWO_PI, drive, fill_tables, machine, open_circuit
from modeling.periodic_kernel import guess
from modeling.stroke_map import tangent_stroke

OK, STALLED = 0, 1
# Columns of the node table.
SOC, PERIOD, SHARE, CHARGE, CURRENT, SLOWNESS, VOLTAGE, BATTERY = range(8)
N_COLUMNS = 8
# What `result` holds.
RUNTIME, STROKES, START_TIME, START_SOC, END_SOC, START_CHARGE, MOTOR_CHARGE, LOCAL_ERROR = range(8)
N_RESULT = 8
N_START_STROKES = 8
GOOD_ENOUGH = 1e-5


@kernel()
def interpolate(nodes, weights, values, at):
    """Barycentric interpolation of values at nodes."""
    top = 0.0
    bottom = 0.0
    for k in range(len(nodes)):
        away = at - nodes[k]
        if away == 0.0:
            return values[k]
        part = weights[k] / away
        top += part * values[k]
        bottom += part
    return top / bottom


@kernel()
def barycentric(nodes, weights):
    """Fill the barycentric weights of nodes."""
    n = len(nodes)
    scale = 4.0 / (nodes[0] - nodes[n - 1])
    for k in range(n):
        product = 1.0
        for j in range(n):
            if j != k:
                product *= scale * (nodes[k] - nodes[j])
        weights[k] = 1.0 / product


@kernel()
def slope(nodes, weights, values, k):
    """Differentiate the interpolant at node k."""
    total = 0.0
    for j in range(len(nodes)):
        if j != k:
            total += weights[j] / weights[k] / (nodes[k] - nodes[j]) * (values[j] - values[k])
    return total


@kernel()
def _frozen(m, tables, curve, h, i, r):
    """Find a periodic stroke from a near start: (i, r), the derivatives of map and integrals, local error."""
    y = (i, r, 0.0, 0.0, 0.0, 0.0)
    q = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for _ in range(30):
        y, q, worst_i, worst_r = tangent_stroke(m, tables, curve, h, i, r)
        a, b, c, d = 1.0 - y[2], -y[3], -y[4], 1.0 - y[5]
        determinant = a * d - b * c
        miss_i, miss_r = y[0] - i, y[1] - r
        step_i = (d * miss_i - b * miss_r) / determinant
        step_r = (a * miss_r - c * miss_i) / determinant
        relative = max(math.fabs(step_r) / r, math.fabs(step_i) / (math.fabs(i) + 1e-3))
        if not relative < 1e300 or not y[1] > 0.0:
            return i, r, y, q, 1e300
        if relative < 3e-4:
            local = max(worst_i / (math.fabs(i) + 1e-3), worst_r / r)
            return i + step_i, r + step_r, y, q, local
        damping = min(1.0, 0.5 / relative)
        i += damping * step_i
        r += damping * step_r
    return i, r, y, q, 1e300


@kernel()
def _strokes_of_start(p, m, spline, ocv, tables, h, start, tolerance):
    """Run the start-up and some strokes: time, i, r, soc and motor charge at angle 0, and a status."""
    n_steps = len(tables)
    t, y, turns, status = start_up(p, m, spline, ocv, start, n_steps, tolerance, False)
    i, r, soc = y[0], 0.0, y[3]
    charge = 0.0
    if status != 0:
        return t, i, r, soc, charge, status
    r = 1.0 / y[1]
    if turns % 2:
        half = n_steps // 2
        first = angle_rate(m, tables[half, 0], drive(m, ocv, soc), i, r, 0.0)
        for n in range(half, n_steps):
            i, r, away, first, duration, _, _, _ = angle_step(m, tables[n], drive(m, ocv, soc), h, i, r, first)
            t += duration
            soc += away
    for _ in range(N_START_STROKES):
        i, r, soc, duration, _ = drifting_stroke(m, tables, ocv, h, i, r, soc, -1.0)
        t += duration
    return t, i, r, soc, charge, 0


@kernel()
def _solve_nodes(m, tables, ocv, h, places, table, tangents, weights):
    """Fill the node table; returns the largest local error, 1e300 where a node fails."""
    n = len(places)
    worst = 0.0
    i, w = guess(m, tables, drive(m, ocv, places[0]))
    if not w > 0.0:
        return 1e300
    r = 1.0 / w
    for k in range(n):
        i, r, y, q, local = _frozen(m, tables, drive(m, ocv, places[k]), h, i, r)
        if not local < 1e299:
            return 1e300
        worst = max(worst, local)
        table[k, SOC], table[k, CURRENT], table[k, SLOWNESS] = places[k], i, r
        table[k, SHARE] = q[2] * m[16]
        for c in range(4):
            tangents[k, c] = y[2 + c]
        for c in range(4):
            tangents[k, 4 + c] = q[3 + c]
    barycentric(places, weights)
    for k in range(n):
        # The drifting stroke whose middle is at the node.
        i, r = table[k, CURRENT], table[k, SLOWNESS]
        share = table[k, SHARE]
        end_i, end_r, end_soc, period, charge = drifting_stroke(m, tables, ocv, h, i, r, places[k] + 0.5 * share, -1.0)
        s = tangents[k]
        a, b, c, d = 1.0 - s[0], -s[1], -s[2], 1.0 - s[3]
        determinant = a * d - b * c
        miss_i = end_i - i + share * slope(places, weights, table[:, CURRENT], k)
        miss_r = end_r - r + share * slope(places, weights, table[:, SLOWNESS], k)
        step_i = (d * miss_i - b * miss_r) / determinant
        step_r = (a * miss_r - c * miss_i) / determinant
        more = s[6] * step_i + s[7] * step_r
        share = places[k] + 0.5 * share - end_soc
        table[k, PERIOD] = period + s[4] * step_i + s[5] * step_r
        table[k, SHARE] = share * (1.0 + more / charge)
        table[k, CHARGE] = charge + more
        tangents[k, 8], tangents[k, 9] = step_i, step_r
    for k in range(n):
        table[k, CURRENT] += tangents[k, 8]
        table[k, SLOWNESS] += tangents[k, 9]
    return worst


@kernel()
def _voltage(m, ocv, resistance, places, weights, table, soc):
    """Battery voltage at a state of charge, V; only the current is interpolated."""
    return open_circuit(m, ocv, soc)[0] - resistance * interpolate(places, weights, table[:, BATTERY], soc)


@kernel()
def discharge_averaged(  # noqa: PLR0912, PLR0915 - one state in registers
    p,
    spline,
    ocv,
    start,
    n_steps,
    tolerance,
    cutoff_soc,
    cutoff_voltage,
    gauss_nodes,
    gauss_weights,
    table,
    result,
):
    """Runtime to a cut-off; fills `table`, shape (n_nodes, N_COLUMNS), and `result`; returns how it ended.

    `gauss_nodes` descend from 1 to -1. BY_SOC 0, BY_VOLTAGE 1, BY_STALL 2, FAILED 4 as in
    `discharge_kernel`; where it says 2 or 4 the discharge has to be run stroke by stroke.
    """
    m = machine(p)
    tables = np.empty((n_steps, 6, 4))
    fill_tables(p, m, spline, n_steps, FRACTIONS, tables)
    add_effects(p, n_steps, FRACTIONS, tables)
    h = TWO_PI / n_steps
    begin = (start[0], start[1], start[2], start[3])
    t0, i0, r0, soc0, _, status = _strokes_of_start(p, m, spline, ocv, tables, h, begin, tolerance)
    if status != 0:
        return FAILED
    n = len(gauss_nodes)
    places = np.empty(n)
    weights = np.empty(n)
    tangents = np.empty((n, 10))
    stop = cutoff_soc
    ended = 0
    half = 0.0
    for _ in range(6):
        if not soc0 > stop:
            return FAILED
        middle, half = 0.5 * (soc0 + stop), 0.5 * (soc0 - stop)
        for k in range(n):
            places[k] = middle + half * gauss_nodes[k]
        worst = _solve_nodes(m, tables, ocv, h, places, table, tangents, weights)
        if not worst < 1e299:
            return FAILED
        result[LOCAL_ERROR] = worst
        resistance = p[slots.BATTERY_RESISTANCE]
        for k in range(n):
            current = table[k, SHARE] / m[16] / table[k, PERIOD]
            table[k, BATTERY] = current
            table[k, VOLTAGE] = open_circuit(m, ocv, places[k])[0] - resistance * current
        if cutoff_voltage <= 0.0:
            break
        reached = _voltage(m, ocv, resistance, places, weights, table, stop)
        if ended == 0 and reached > cutoff_voltage:
            break
        if ended == 1 and math.fabs(reached - cutoff_voltage) < 1e-9 * cutoff_voltage:
            break
        ended = 1
        low, high = max(stop - 0.1 * half, 0.0), soc0
        for _ in range(60):
            guess_soc = 0.5 * (low + high)
            if _voltage(m, ocv, resistance, places, weights, table, guess_soc) > cutoff_voltage:
                high = guess_soc
            else:
                low = guess_soc
        stop = high
    runtime = 0.0
    strokes = 0.0
    charge = 0.0
    for k in range(n):
        runtime += half * gauss_weights[k] * table[k, PERIOD] / table[k, SHARE]
        strokes += half * gauss_weights[k] / table[k, SHARE]
        charge += half * gauss_weights[k] * table[k, CHARGE] / table[k, SHARE]
    # What is left of the start-up: geometric series of the stroke map at the first node.
    s = tangents[0]
    a, b, c, d = 1.0 - s[0], -s[1], -s[2], 1.0 - s[3]
    determinant = a * d - b * c
    left_i = i0 - interpolate(places, weights, table[:, CURRENT], soc0)
    left_r = r0 - interpolate(places, weights, table[:, SLOWNESS], soc0)
    sum_i = (d * left_i - b * left_r) / determinant
    sum_r = (a * left_r - c * left_i) / determinant
    more_time = s[4] * sum_i + s[5] * sum_r
    more_share = (s[6] * sum_i + s[7] * sum_r) / table[0, CHARGE] * table[0, SHARE]
    runtime += more_time - more_share * table[0, PERIOD] / table[0, SHARE]
    strokes -= more_share / table[0, SHARE]
    result[STROKES] = strokes
    if ended == 0:
        # The last stroke begins where a whole number of strokes is done; a cut-off by mean voltage has no
        # such phase.
        part = strokes - math.floor(strokes)
        share = interpolate(places, weights, table[:, SHARE], stop)
        period = interpolate(places, weights, table[:, PERIOD], stop)
        i1 = interpolate(places, weights, table[:, CURRENT], stop)
        r1 = interpolate(places, weights, table[:, SLOWNESS], stop)
        runtime -= part * period
        took = 0.0
        soc = stop + part * share
        if part > 0.0:
            _, _, reached_soc, took, _ = drifting_stroke(m, tables, ocv, h, i1, r1, soc, stop)
            if reached_soc > stop:
                took = part * period
        runtime += took
    result[RUNTIME] = t0 + runtime
    result[START_TIME], result[START_SOC], result[END_SOC] = t0, soc0, stop
    result[MOTOR_CHARGE] = charge
    return ended


@kernel(parallel=True)
def runtimes(vectors, spline, ocv, n_steps, tolerance, cutoff_soc, cutoff_voltage, gauss_nodes, gauss_weights, out):
    """Fill the runtime of every row of `vectors`, full and at rest, s; NaN where it cannot be averaged."""
    for case in numba.prange(len(vectors)):
        table = np.zeros((len(gauss_nodes), N_COLUMNS))
        result = np.zeros(N_RESULT)
        start = np.array([0.0, 0.0, 0.0, 1.0])
        code = discharge_averaged(
            vectors[case], spline, ocv, start, n_steps, tolerance, cutoff_soc, cutoff_voltage, gauss_nodes,
            gauss_weights, table, result,
        )  # fmt: skip
        out[case] = result[RUNTIME] if code <= 1 else np.nan


@kernel()
def open_circuit_at(p, ocv, soc):
    """Open-circuit voltage of the battery in a vector, V."""
    return open_circuit(machine(p), ocv, soc)[0]
