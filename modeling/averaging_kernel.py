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

import numpy as np
from sawbench.modeling.compilation import kernel
from sawbench.modeling.discharge_kernel import COARSE, FAILED, start_up
from sawbench.modeling.machine import drive, load_tables, machine, open_circuit
from sawbench.modeling.stroke_kernel import (
    ACCEPT,
    PERIODIC,
    drifting_stroke,
    guess,
    is_too_coarse,
    solve_periodic,
    to_rest,
)
from sawbench.modeling.transient_kernel import NO_CONVERGENCE

# Columns of the node table: what there is of the stroke whose middle is at the node, at its start and over it.
SOC, PERIOD, SHARE, CHARGE, CURRENT, SLOWNESS, BATTERY = range(7)
N_COLUMNS = 7
# What `result` holds.
RUNTIME, STROKES, START_TIME, START_SOC, END_SOC, MOTOR_CHARGE, LOCAL_ERROR = range(7)
N_RESULT = 7
N_START_STROKES = 5
MOST_CUTOFF_ROUNDS = 12
CUTOFF_TOLERANCE = 1e-8


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
def _solve_nodes(m, tables, ocv, places, weights, table):
    """Fill the node table; returns the largest local error (1e300 where a node fails) and the first node's stroke."""
    n = len(places)
    barycentric(places, weights)
    i, r = guess(m, tables, drive(m, ocv, places[0]))
    worst = 0.0
    strokes = np.empty((n, 13))
    for k in range(n):
        if k > 1:  # straight on from the two nodes before
            ahead = (places[k] - places[k - 1]) / (places[k - 1] - places[k - 2])
            i = table[k - 1, CURRENT] + ahead * (table[k - 1, CURRENT] - table[k - 2, CURRENT])
            r = table[k - 1, SLOWNESS] + ahead * (table[k - 1, SLOWNESS] - table[k - 2, SLOWNESS])
        status, i, r, y, _, _, local, _ = solve_periodic(m, tables, drive(m, ocv, places[k]), i, r, ACCEPT)
        if status != PERIODIC:
            return 1e300, strokes[0]
        worst = max(worst, local)
        table[k, SOC], table[k, CURRENT], table[k, SLOWNESS] = places[k], i, r
        table[k, SHARE] = y[8] * m.per_capacity
        for c in range(13):
            strokes[k, c] = y[c]
    changes = np.empty((n, 2))
    for k in range(n):
        # The drifting stroke whose middle is at the node.
        i, r, share, y = table[k, CURRENT], table[k, SLOWNESS], table[k, SHARE], strokes[k]
        end_i, end_r, end_soc, period, charge, _ = drifting_stroke(m, tables, ocv, i, r, places[k] + 0.5 * share, -1.0)
        miss_i = end_i - i + share * slope(places, weights, table[:, CURRENT], k)
        miss_r = end_r - r + share * slope(places, weights, table[:, SLOWNESS], k)
        step_i, step_r = to_rest(y, miss_i, miss_r)
        more = y[11] * step_i + y[12] * step_r
        share = places[k] + 0.5 * share - end_soc
        table[k, PERIOD] = period + y[9] * step_i + y[10] * step_r
        table[k, SHARE] = share * (1.0 + more / charge)
        table[k, CHARGE] = charge + more
        table[k, BATTERY] = table[k, SHARE] / m.per_capacity / table[k, PERIOD]
        changes[k, 0], changes[k, 1] = step_i, step_r
    for k in range(n):
        table[k, CURRENT] += changes[k, 0]
        table[k, SLOWNESS] += changes[k, 1]
    return worst, strokes[0]


@kernel()
def _voltage(m, ocv, places, weights, table, soc, end):
    """Battery voltage at a state of charge, V; only the current is interpolated, and held beyond `end`."""
    current = interpolate(places, weights, table[:, BATTERY], max(soc, end))
    return open_circuit(m, ocv, soc)[0] - m.battery_resistance * current


@kernel()
def _last_stroke(m, tables, ocv, places, weights, table, part, stop):
    """Time that the unfinished stroke takes from its start, less the `part` of a mean stroke that it stands for."""
    period = interpolate(places, weights, table[:, PERIOD], stop)
    i = interpolate(places, weights, table[:, CURRENT], stop)
    r = interpolate(places, weights, table[:, SLOWNESS], stop)
    soc = stop + part * interpolate(places, weights, table[:, SHARE], stop)
    _, _, reached, took, _, _ = drifting_stroke(m, tables, ocv, i, r, soc, stop)
    return 0.0 if reached > stop else took - part * period


@kernel()
def _stop_at_voltage(m, ocv, places, weights, table, level, span):
    """State of charge, between the first of `span` and a little below its second, at which the voltage is `level`."""
    high, low = span[0], max(span[1] - 0.05 * (span[0] - span[1]), 0.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        if _voltage(m, ocv, places, weights, table, middle, span[1]) > level:
            high = middle
        else:
            low = middle
    return high


@kernel()
def discharge_averaged(p, spline, ocv, start, settings, gauss, table, result):
    """Runtime to a cut-off; fills `table`, shape (n_nodes, N_COLUMNS), and `result`; returns how it ended.

    `settings` as in `discharge_kernel.brute_force`; `gauss`, shape (2, n_nodes), holds nodes that descend from 1 to -1
    and their weights. BY_SOC 0, BY_VOLTAGE 1, FAILED 4, COARSE 5 as in `discharge_kernel`: coarse steps are to be
    halved; where it failed the discharge has to be run stroke by stroke.
    """
    n_steps, tolerance, cutoff_soc, cutoff_voltage = settings
    m = machine(p)
    tables = load_tables(m, spline, n_steps)
    t0, i0, r0, soc0, _, n_started, status = start_up(
        m, spline, ocv, (start[0], start[1], start[2], start[3]), n_steps, tolerance, True
    )
    if status != 0:
        return COARSE if status == NO_CONVERGENCE else FAILED
    if is_too_coarse(m, n_steps, r0):
        return COARSE
    for _ in range(N_START_STROKES):
        i0, r0, soc0, took, _, _ = drifting_stroke(m, tables, ocv, i0, r0, soc0, -1.0)
        t0 += took
        n_started += 1
    places, weights = np.empty(gauss.shape[1]), np.empty(gauss.shape[1])
    stop, ended, first = cutoff_soc, 0, np.zeros(13)
    for n_round in range(MOST_CUTOFF_ROUNDS + 1):
        if not soc0 > stop or n_round == MOST_CUTOFF_ROUNDS:
            return FAILED
        for k in range(len(places)):
            places[k] = 0.5 * (soc0 + stop) + 0.5 * (soc0 - stop) * gauss[0, k]
        result[LOCAL_ERROR], first = _solve_nodes(m, tables, ocv, places, weights, table)
        if not result[LOCAL_ERROR] < 1e299:
            return FAILED
        if cutoff_voltage <= 0.0:
            break
        reached = _voltage(m, ocv, places, weights, table, stop, stop)
        is_met = math.fabs(reached - cutoff_voltage) < CUTOFF_TOLERANCE * cutoff_voltage
        if is_met or (ended == 0 and reached > cutoff_voltage):
            break
        ended = 1
        stop = _stop_at_voltage(m, ocv, places, weights, table, cutoff_voltage, (soc0, stop))
    runtime = strokes = charge = 0.0
    for k in range(len(places)):
        per_share = 0.5 * (soc0 - stop) * gauss[1, k] / table[k, SHARE]
        runtime += per_share * table[k, PERIOD]
        strokes += per_share
        charge += per_share * table[k, CHARGE]
    # What is left of the start-up: geometric series of the stroke map at the first node.
    left_i = i0 - interpolate(places, weights, table[:, CURRENT], soc0)
    left_r = r0 - interpolate(places, weights, table[:, SLOWNESS], soc0)
    sum_i, sum_r = to_rest(first, left_i, left_r)
    more = (first[11] * sum_i + first[12] * sum_r) / table[0, CHARGE]
    runtime += first[9] * sum_i + first[10] * sum_r - more * table[0, PERIOD]
    strokes -= more
    if ended == 0:
        # The last stroke begins where a whole number of strokes is done; a cut-off by mean voltage has no such phase.
        runtime += _last_stroke(m, tables, ocv, places, weights, table, strokes - math.floor(strokes), stop)
    result[RUNTIME], result[STROKES], result[MOTOR_CHARGE] = t0 + runtime, n_started + strokes, charge
    result[START_TIME], result[START_SOC], result[END_SOC] = t0, soc0, stop
    return ended
