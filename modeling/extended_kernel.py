"""Integrate the extended machine over time: error control, every change of law an event that a step ends on.

Dormand-Prince 5(4) with steps that end on the dead centres, on the angles where the blade engages or a
backlash is crossed, and where the current limit takes hold or lets go. Between steps the pair's own
fourth-order interpolant.
"""

from __future__ import annotations

import math

import numpy as np

from modeling import slots
from modeling.compilation import kernel
from modeling.dormand_prince import (
    A21,
    A31,
    A32,
    A41,
    A42,
    A43,
    A51,
    A52,
    A53,
    A54,
    A61,
    A62,
    A63,
    A64,
    A65,
    B1,
    B3,
    B4,
    B5,
    B6,
    E1,
    E3,
    E4,
    E5,
    E6,
    E7,
)
from modeling.extended_physics import (
    ANGLE,
    CURRENT,
    FORCE,
    N_ALL,
    N_SEEN,
    N_STATES,
    SOC,
    SPEED,
    STILL,
    extended_rates,
    observe,
)
from modeling.machine import cutter
from modeling.turn_segments import breaks, place_at

OK, STALLED, NO_CONVERGENCE, EMPTY = 0, 1, 2, 3
MOST_STEPS = 5_000_000
MOST_TURN = 0.35  # rad of crank in one step
STEEP = 0.004  # rad of crank in the first and last steps of a half turn where the laws are steep
# Interpolant of the pair: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.6.
D1, D3, D4 = -12715105075 / 11282082432, 87487479700 / 32700410799, -10690763975 / 1880347072
D5, D6, D7 = 701980252875 / 199316789632, -1453857185 / 822651844, 69997945 / 29380423
# What `record` holds: steps, stood, limited (s), error sum of the current, largest steps a turn.
N_STEPS, LIMITED_S, ERROR_CURRENT, TURN_S, SCALE_CURRENT, SCALE_SPEED = range(6)
N_RECORD = 6


@kernel()
def chip_factor(p, turn_s):
    """Gain of the cutting force from the chip thickness, feed a stroke, of the turn before."""
    if p[slots.CHIP_EXPONENT] == 0.0:
        return 1.0
    return (p[slots.FEED] * turn_s / p[slots.CHIP_REFERENCE]) ** p[slots.CHIP_EXPONENT]


@kernel()
def extended_step(p, c, spline, ocv, place, t, h, y, frozen, is_frozen, k, new, scratch):  # noqa: PLR0912
    """One step from `y` to `new`, stages in `k`, shape (7, N_ALL)."""
    for stage in range(7):
        if stage == 0:
            for n in range(N_ALL):
                scratch[n] = y[n]
        elif stage == 1:
            for n in range(N_ALL):
                scratch[n] = y[n] + h * A21 * k[0, n]
        elif stage == 2:
            for n in range(N_ALL):
                scratch[n] = y[n] + h * (A31 * k[0, n] + A32 * k[1, n])
        elif stage == 3:
            for n in range(N_ALL):
                scratch[n] = y[n] + h * (A41 * k[0, n] + A42 * k[1, n] + A43 * k[2, n])
        elif stage == 4:
            for n in range(N_ALL):
                scratch[n] = y[n] + h * (A51 * k[0, n] + A52 * k[1, n] + A53 * k[2, n] + A54 * k[3, n])
        elif stage == 5:
            for n in range(N_ALL):
                scratch[n] = y[n] + h * (A61 * k[0, n] + A62 * k[1, n] + A63 * k[2, n] + A64 * k[3, n] + A65 * k[4, n])
        else:
            for n in range(N_ALL):
                new[n] = y[n] + h * (B1 * k[0, n] + B3 * k[2, n] + B4 * k[3, n] + B5 * k[4, n] + B6 * k[5, n])
                scratch[n] = new[n]
        at = t
        if not is_frozen:
            at += h * (0.0, 0.2, 0.3, 0.8, 8.0 / 9.0, 1.0, 1.0)[stage]
        extended_rates(p, c, spline, ocv, place, at, scratch, frozen if is_frozen else scratch, k[stage])


@kernel()
def local_error(h, k, scale_i, scale_w, scale_f):
    """Largest embedded error of current, speed and force over their scales."""
    worst = 0.0
    for n, scale in ((CURRENT, scale_i), (SPEED, scale_w), (FORCE, scale_f)):
        e = E1 * k[0, n] + E3 * k[2, n] + E4 * k[3, n] + E5 * k[4, n] + E6 * k[5, n] + E7 * k[6, n]
        worst = max(worst, math.fabs(h * e) / scale)
    return worst


@kernel()
def between(u, h, y, new, k, out):
    """Fill `out` with the state at the fraction u of a step."""
    for n in range(N_STATES):
        rise = new[n] - y[n]
        bend = h * k[0, n] - rise
        more = rise - h * k[6, n] - bend
        high = h * (D1 * k[0, n] + D3 * k[2, n] + D4 * k[3, n] + D5 * k[4, n] + D6 * k[5, n] + D7 * k[6, n])
        out[n] = y[n] + u * (rise + (1.0 - u) * (bend + u * (more + (1.0 - u) * high)))


@kernel()
def _first_change(p, y, new, k, h, until, is_limited, free_rate):
    """Find the first event of a step (0 none, 1 angle, 2 limit reached, 3 limit let go) and its fraction."""
    event = 0
    part = 1.0
    if new[ANGLE] > until:
        event = 1
        part = _root(h, y, new, k, ANGLE, until)
    limit = p[slots.CURRENT_LIMIT]
    if limit > 0.0 and not is_limited and new[CURRENT] > limit and y[CURRENT] <= limit:
        at = _root(h, y, new, k, CURRENT, limit)
        if at < part:
            event, part = 2, at
    if is_limited and free_rate < 0.0 and event == 0:
        event = 3
    return event, part


@kernel()
def _root(h, y, new, k, n, level):
    """Fraction of a step at which component n rises through a level."""
    low, high = 0.0, 1.0
    rise = new[n] - y[n]
    bend = h * k[0, n] - rise
    more = rise - h * k[6, n] - bend
    steep = h * (D1 * k[0, n] + D3 * k[2, n] + D4 * k[3, n] + D5 * k[4, n] + D6 * k[5, n] + D7 * k[6, n])
    for _ in range(50):
        u = 0.5 * (low + high)
        value = y[n] + u * (rise + (1.0 - u) * (bend + u * (more + (1.0 - u) * steep)))
        if value > level:
            high = u
        else:
            low = u
    return high


@kernel()
def _free_rate(p, c, spline, ocv, place, t, y, slow, k):
    """Rate of the current if the limit were lifted, A/s."""
    free = (place[0], place[1], place[2], place[3], False, place[5])
    extended_rates(p, c, spline, ocv, free, t, y, slow, k)
    return k[CURRENT]


@kernel()
def simulate_extended(  # noqa: PLR0912, PLR0915
    p, spline, ocv, time_s, start, turns, stop_turns, frozen, tolerance, out, seen, end, record
):
    """Integrate from `start` (shape (N_ALL,), angle since the last of `turns` half turns) to the last sample.

    Parameters
    ----------
    stop_turns : int
        Ends there instead, at that many half turns; -1 for none.
    frozen : ndarray, shape (N_ALL,) or (0,)
        Slow quantities held at these values; their rates still add up in the state.
    tolerance : float
        Local error relative to stall current, no-load speed and working force.
    out : ndarray, shape (4, n)
        Motor current, motor speed, crank angle, state of charge.
    seen : ndarray, shape (N_SEEN, n)
    end : ndarray, shape (N_ALL,)
        The state at the end, its angle since the last dead centre.
    record : ndarray, shape (N_RECORD,)
        In: `TURN_S`, duration of the turn before; `SCALE_CURRENT`, `SCALE_SPEED`. Out: all of it.

    Returns
    -------
    time, half turns done, status
    """
    c = cutter(p)
    is_frozen = len(frozen) > 0
    edges = np.empty((2, 2))
    breaks(p, edges)
    k = np.zeros((7, N_ALL))
    new = np.empty(N_ALL)
    scratch = np.empty(N_ALL)
    sample = np.empty(N_ALL)
    watched = np.empty(N_SEEN)
    y = start.copy()
    chip = chip_factor(p, record[TURN_S])
    limit = p[slots.CURRENT_LIMIT]
    is_limited = limit > 0.0 and y[CURRENT] >= limit
    scale_i, scale_w = record[SCALE_CURRENT], record[SCALE_SPEED]
    scale_f = max(p[slots.K_FC] * p[slots.RADIUS] * scale_w * 0.5, 1.0)
    last = time_s[-1]
    t = 0.0
    turn_began = -1.0
    n = 0
    # A power law or a Stribeck dip is steep next to the dead centres, in a part of the turn that steps would
    # jump.
    is_steep = p[slots.EXPONENT] != 1.0 or p[slots.GUIDE_STATIC] > p[slots.GUIDE_COULOMB]
    h = 0.02 * p[slots.INDUCTANCE] / p[slots.RESISTANCE]
    next_h = h
    event = 0
    tries = 0
    place, until = place_at(p, edges, turns, y[ANGLE], is_limited, chip)
    for _ in range(MOST_STEPS):
        while n < len(time_s) and time_s[n] <= t and t == 0.0:
            observe(p, c, spline, ocv, place, t, y, watched)
            _write(p, y, turns, watched, n, out, seen)
            n += 1
        if t >= last:
            break
        h = min(h, last - t)
        if y[SPEED] > 0.0 and event == 0:
            h = min(h, MOST_TURN / y[SPEED])
            if is_steep:
                h = min(h, max(0.5 * min(math.pi - y[ANGLE], 4.0 * y[ANGLE]), STEEP) / y[SPEED])
        extended_step(p, c, spline, ocv, place, t, h, y, frozen, is_frozen, k, new, scratch)
        if event == 0:
            ratio = local_error(h, k, scale_i, scale_w, scale_f) / tolerance
            if not ratio <= 1.0:
                h *= 0.2 if not ratio < 1e6 else max(0.2, 0.9 * ratio**-0.2)
                if h < 1e-13:
                    end[:] = y
                    return t, turns, NO_CONVERGENCE
                continue
            next_h = h * min(4.0, 0.9 * max(ratio, 1e-8) ** -0.2)
            free = 0.0
            if is_limited:
                free = _free_rate(p, c, spline, ocv, place, t + h, new, frozen if is_frozen else new, scratch)
            event, part = _first_change(p, y, new, k, h, until, is_limited, free)
            tries = 0
            if event in (1, 2):
                h *= part
                continue
            if event == 3 and h > 1e-7:
                # Where the limit lets go the current leaves with no jump: close in by halving.
                event = 0
                h *= 0.5
                continue
        elif event == 1 and tries < 4 and math.fabs(until - new[ANGLE]) > 1e-13 and new[SPEED] > 0.0:
            tries += 1
            h += (until - new[ANGLE]) / new[SPEED]
            continue
        t1 = last if h >= last - t else t + h
        while n < len(time_s) and time_s[n] <= t1:
            between((time_s[n] - t) / h, h, y, new, k, sample)
            observe(p, c, spline, ocv, place, time_s[n], sample, watched)
            _write(p, sample, turns, watched, n, out, seen)
            n += 1
        record[N_STEPS] += 1
        if is_limited:
            record[LIMITED_S] += t1 - t
        t = t1
        for m in range(N_ALL):
            y[m] = new[m]
        h = next_h
        if event == 1:
            y[ANGLE] = until
            if until >= math.pi:
                turns += 1
                y[ANGLE] = 0.0
                if turns == stop_turns:
                    if turn_began < 0.0 and turns % 2 == 0:
                        record[TURN_S] = t
                    break
                if turns % 2 == 0:
                    if turn_began >= 0.0:
                        record[TURN_S] = t - turn_began
                        if not is_frozen:
                            chip = chip_factor(p, record[TURN_S])
                    turn_began = t
        elif event == 2:
            is_limited = True
            y[CURRENT] = limit
        elif event == 3:
            is_limited = False
        if event > 0:
            place, until = place_at(p, edges, turns, y[ANGLE], is_limited, chip)
        event = 0
    else:
        end[:] = y
        return t, turns, NO_CONVERGENCE
    end[:] = y
    if y[SOC] <= 0.0 and p[slots.MODE] != slots.FIXED_VOLTAGE:
        return t, turns, EMPTY
    return t, turns, STALLED if y[SPEED] < 2.0 * STILL and t > 0.05 else OK


@kernel()
def _write(p, y, turns, watched, n, out, seen):
    out[0, n] = y[CURRENT]
    out[1, n] = y[SPEED] * p[slots.GEAR]
    out[2, n] = y[ANGLE] + turns * math.pi
    out[3, n] = y[SOC]
    for m in range(N_SEEN):
        seen[m, n] = watched[m]
