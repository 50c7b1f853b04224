"""Periodic strokes of many parameter vectors, eight at a time in the lanes of a vector register.

The same Newton iteration as `periodic_kernel`, for the case that batches consist of: a linear force, a
Scotch yoke, an ideal source or a fixed duty, no effect on the load. Other rows, and rows that do not settle,
are left to the caller. Every loop over the lanes is free of branches and runs over unsigned indices, else it
would not vectorise.
"""

from __future__ import annotations

import math

import numba
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
    FRACTIONS,
)
from modeling.frozen_effects import changes_load
from modeling.machine import TWO_PI, drive, machine
from modeling.periodic_kernel import (
    ACCEPT,
    BATTERY_CHARGE,
    LOCAL_ERROR,
    MOTOR_CHARGE,
    N_STROKES,
    PERIOD,
    PERIODIC,
    START_CURRENT,
    START_SPEED,
    STEPS,
)

LANES = 8
UNDECIDED, TOO_COARSE = -1, -2
MOST_ROUNDS = 6
WIDTH = np.uint64(LANES)
# Where the rows of a block begin in its one array (one, so that the compiler need not fear that arrays
# overlap): constants, then the state (i, r and its four derivatives), then the integrals, the
# largest local errors, and the start.
R_X, PER_L, K_E, K_M, E, INERTIA, MASS, DRAG, CUT, SHARE = (np.uint64(n * LANES) for n in range(10))
Y0, Y1, Y2, Y3, Y4, Y5 = (np.uint64(n * LANES) for n in range(10, 16))
Q0, Q1, Q2, Q3, Q4, Q5 = (np.uint64(n * LANES) for n in range(16, 22))
WORST_I, WORST_R, START_I, START_R = (np.uint64(n * LANES) for n in range(22, 26))
N_ROWS = 26


@kernel()
def fits_lanes(p):
    """Whether a vector is of the kind this kernel takes."""
    return (
        p[slots.MODE] != slots.HELD_VOLTAGE
        and p[slots.ROD] == 0.0
        and p[slots.FORCE_SCALE] == 0.0
        and not changes_load(p)
    )


@kernel()
def _rate(r_x, per_l, k_e, k_m, e, inverse_j, bend, drag, y):
    """Rates over the angle of (i, r) and of the four derivatives by the start; no branches."""
    i, r, ii, ir, ri, rr = y
    over = e - r_x * i
    di = (over * r - k_e) * per_l
    push = k_m * i * r
    dr = -inverse_j * r * (r * (push - drag) - bend)
    i_i = -r_x * r * per_l
    i_r = over * per_l
    r_i = -inverse_j * k_m * r * r * r
    r_r = -inverse_j * (r * (3.0 * push - 2.0 * drag) - bend)
    return di, dr, i_i * ii + i_r * ri, i_i * ir + i_r * rr, r_i * ii + r_r * ri, r_i * ir + r_r * rr


@kernel()
def _add(y, a, k):
    return (
        y[0] + a * k[0],
        y[1] + a * k[1],
        y[2] + a * k[2],
        y[3] + a * k[3],
        y[4] + a * k[4],
        y[5] + a * k[5],
    )


@kernel()
def _lane_stroke(c, sines, cosines, cuts, h):
    """One stroke of every lane of a block."""
    n_steps = len(cuts)
    for n in range(n_steps):
        cut = cuts[n]
        s2, s3, s4, s5, s6 = sines[n, 1], sines[n, 2], sines[n, 3], sines[n, 4], sines[n, 5]
        c2, c3, c4, c5, c6 = cosines[n, 1], cosines[n, 2], cosines[n, 3], cosines[n, 4], cosines[n, 5]
        s1, c1 = sines[n, 0], cosines[n, 0]
        for lane in range(WIDTH):
            r_x, per_l, k_e, k_m, e = (
                c[R_X + lane],
                c[PER_L + lane],
                c[K_E + lane],
                c[K_M + lane],
                c[E + lane],
            )
            inertia, mass, base = c[INERTIA + lane], c[MASS + lane], c[DRAG + lane]
            extra = cut * c[CUT + lane]
            y1 = (
                c[Y0 + lane],
                c[Y1 + lane],
                c[Y2 + lane],
                c[Y3 + lane],
                c[Y4 + lane],
                c[Y5 + lane],
            )
            j1 = 1.0 / (inertia + mass * s1 * s1)
            k1 = _rate(r_x, per_l, k_e, k_m, e, j1, mass * s1 * c1, base + extra * s1 * s1, y1)
            j2 = 1.0 / (inertia + mass * s2 * s2)
            d2, b2 = base + extra * s2 * s2, mass * s2 * c2
            k2 = _rate(r_x, per_l, k_e, k_m, e, j2, b2, d2, _add(y1, h * A21, k1))
            y3 = _add(_add(y1, h * A31, k1), h * A32, k2)
            j3 = 1.0 / (inertia + mass * s3 * s3)
            k3 = _rate(r_x, per_l, k_e, k_m, e, j3, mass * s3 * c3, base + extra * s3 * s3, y3)
            y4 = _add(_add(_add(y1, h * A41, k1), h * A42, k2), h * A43, k3)
            j4 = 1.0 / (inertia + mass * s4 * s4)
            k4 = _rate(r_x, per_l, k_e, k_m, e, j4, mass * s4 * c4, base + extra * s4 * s4, y4)
            y5 = _add(_add(_add(_add(y1, h * A51, k1), h * A52, k2), h * A53, k3), h * A54, k4)
            j5 = 1.0 / (inertia + mass * s5 * s5)
            k5 = _rate(r_x, per_l, k_e, k_m, e, j5, mass * s5 * c5, base + extra * s5 * s5, y5)
            y6 = _add(_add(_add(_add(_add(y1, h * A61, k1), h * A62, k2), h * A63, k3), h * A64, k4), h * A65, k5)
            j6 = 1.0 / (inertia + mass * s6 * s6)
            k6 = _rate(r_x, per_l, k_e, k_m, e, j6, mass * s6 * c6, base + extra * s6 * s6, y6)
            w1, w3, w4, w5, w6 = h * B1, h * B3, h * B4, h * B5, h * B6
            c[Q0 + lane] += w1 * y1[1] + w3 * y3[1] + w4 * y4[1] + w5 * y5[1] + w6 * y6[1]
            c[Q1 + lane] += (
                w1 * y1[0] * y1[1] + w3 * y3[0] * y3[1] + w4 * y4[0] * y4[1] + w5 * y5[0] * y5[1] + w6 * y6[0] * y6[1]
            )
            c[Q2 + lane] += w1 * y1[4] + w3 * y3[4] + w4 * y4[4] + w5 * y5[4] + w6 * y6[4]
            c[Q3 + lane] += w1 * y1[5] + w3 * y3[5] + w4 * y4[5] + w5 * y5[5] + w6 * y6[5]
            c[Q4 + lane] += (
                w1 * (y1[2] * y1[1] + y1[0] * y1[4])
                + w3 * (y3[2] * y3[1] + y3[0] * y3[4])
                + w4 * (y4[2] * y4[1] + y4[0] * y4[4])
                + w5 * (y5[2] * y5[1] + y5[0] * y5[4])
                + w6 * (y6[2] * y6[1] + y6[0] * y6[4])
            )
            c[Q5 + lane] += (
                w1 * (y1[3] * y1[1] + y1[0] * y1[5])
                + w3 * (y3[3] * y3[1] + y3[0] * y3[5])
                + w4 * (y4[3] * y4[1] + y4[0] * y4[5])
                + w5 * (y5[3] * y5[1] + y5[0] * y5[5])
                + w6 * (y6[3] * y6[1] + y6[0] * y6[5])
            )
            end = _add(_add(_add(_add(_add(y1, w1, k1), w3, k3), w4, k4), w5, k5), w6, k6)
            k7 = _rate(r_x, per_l, k_e, k_m, e, j6, mass * s6 * c6, base + extra * s6 * s6, end)
            error_i = math.fabs(E1 * k1[0] + E3 * k3[0] + E4 * k4[0] + E5 * k5[0] + E6 * k6[0] + E7 * k7[0])
            error_r = math.fabs(E1 * k1[1] + E3 * k3[1] + E4 * k4[1] + E5 * k5[1] + E6 * k6[1] + E7 * k7[1])
            worst_i, worst_r = c[WORST_I + lane], c[WORST_R + lane]
            c[WORST_I + lane] = error_i if error_i > worst_i else worst_i
            c[WORST_R + lane] = error_r if error_r > worst_r else worst_r
            c[Y0 + lane], c[Y1 + lane], c[Y2 + lane] = end[0], end[1], end[2]
            c[Y3 + lane], c[Y4 + lane], c[Y5 + lane] = end[3], end[4], end[5]


@kernel()
def _trigonometry(n_steps, sines, cosines):
    step = TWO_PI / n_steps
    for n in range(n_steps):
        for s in range(6):
            angle = (n + FRACTIONS[s]) * step
            sines[n, s], cosines[n, s] = math.sin(angle), math.cos(angle)


@kernel()
def _begin(c, lane, sign):
    """Start of a lane: mean torque balance and the response to the load's first two harmonics."""
    # sin^2 on one half turn: mean 1/4, first harmonic -+4/(3 pi) sin, second -1/4 cos.
    mean = c[DRAG + lane] + 0.25 * c[CUT + lane]
    speed = c[E + lane] / (c[K_E + lane] + c[R_X + lane] * mean / c[K_M + lane])
    current = mean * speed / c[K_M + lane]
    start_i, start_w = current, speed
    for harmonic in (1, 2):
        cut = c[CUT + lane] * speed
        torque = complex(0.0, -sign * 4.0 / (3.0 * math.pi) * cut) if harmonic == 1 else complex(-0.25 * cut, 0.0)
        if harmonic == 2:
            torque += complex(0.0, -0.5 * c[MASS + lane] * speed * speed)
        rate = complex(0.0, harmonic * speed)
        impedance = c[R_X + lane] + rate / c[PER_L + lane]
        ripple = -torque / (rate * c[INERTIA + lane] + mean + c[K_M + lane] * c[K_E + lane] / impedance)
        start_w += ripple.real
        start_i -= (c[K_E + lane] * ripple / impedance).real
    c[START_I + lane] = start_i
    c[START_R + lane] = 1.0 / max(start_w, 0.2 * speed)


@kernel()
def _solve_block(c, sines, cosines, cuts, sign, n_steps, tolerance, count, results, statuses, first):
    """Newton iterations on one block of lanes; rows from `first` on, `count` of them."""
    h = TWO_PI / n_steps
    for lane in range(WIDTH):
        _begin(c, lane, sign)
    for round_ in range(MOST_ROUNDS):
        for place in range(Q0, START_I):
            c[place] = 0.0
        for lane in range(WIDTH):
            c[Y0 + lane], c[Y1 + lane] = c[START_I + lane], c[START_R + lane]
            c[Y2 + lane], c[Y3 + lane], c[Y4 + lane], c[Y5 + lane] = 1.0, 0.0, 0.0, 1.0
        _lane_stroke(c, sines, cosines, cuts, h)
        n_open = 0
        for lane in range(np.uint64(count)):
            a, b, d = 1.0 - c[Y2 + lane], -c[Y3 + lane], 1.0 - c[Y5 + lane]
            e = -c[Y4 + lane]
            determinant = a * d - b * e
            miss_i, miss_r = c[Y0 + lane] - c[START_I + lane], c[Y1 + lane] - c[START_R + lane]
            step_i = (d * miss_i - b * miss_r) / determinant
            step_r = (a * miss_r - e * miss_i) / determinant
            size = math.fabs(c[START_I + lane]) + 1e-3
            relative = max(math.fabs(step_r) / c[START_R + lane], math.fabs(step_i) / size)
            row = first + np.int64(lane)
            local = h * max(c[WORST_I + lane] / size, c[WORST_R + lane] / c[START_R + lane])
            if statuses[row] == UNDECIDED and relative < ACCEPT and local > tolerance:
                statuses[row] = TOO_COARSE
            if statuses[row] == UNDECIDED and relative < ACCEPT:
                statuses[row] = PERIODIC
                out = results[row]
                out[START_CURRENT] = c[START_I + lane] + step_i
                out[START_SPEED] = 1.0 / (c[START_R + lane] + step_r)
                out[PERIOD] = c[Q0 + lane] + c[Q2 + lane] * step_i + c[Q3 + lane] * step_r
                out[MOTOR_CHARGE] = c[Q1 + lane] + c[Q4 + lane] * step_i + c[Q5 + lane] * step_r
                out[BATTERY_CHARGE] = c[SHARE + lane] * out[MOTOR_CHARGE]
                out[N_STROKES], out[STEPS], out[LOCAL_ERROR] = round_ + 1, n_steps, local
            if statuses[row] == UNDECIDED and relative < 0.5:
                n_open += 1
            if relative < 0.5:
                c[START_I + lane] += step_i
                c[START_R + lane] += step_r
        if n_open == 0:
            return


@kernel(parallel=True)
def periodic_lanes(vectors, ocv, soc, n_steps, tolerance, results, statuses):
    """Fill `results` and `statuses` of the rows that fit and settle; the others keep a negative status."""
    sines = np.empty((n_steps, 6))
    cosines = np.empty((n_steps, 6))
    _trigonometry(n_steps, sines, cosines)
    n_cases = len(vectors)
    n_blocks = (n_cases + LANES - 1) // LANES
    for block in numba.prange(n_blocks):
        first = block * LANES
        count = min(LANES, n_cases - first)
        c = np.zeros(N_ROWS * LANES)
        sign = vectors[first, slots.CUTTING_SIGN]
        fits = True
        for lane in range(WIDTH):
            row = np.int64(first + min(np.int64(lane), count - 1))
            p = vectors[row]
            statuses[row] = UNDECIDED
            fits = fits and fits_lanes(p) and p[slots.CUTTING_SIGN] == sign
            m = machine(p)
            radius = p[slots.RADIUS]
            c[R_X + lane], c[PER_L + lane], c[K_E + lane], c[K_M + lane] = m[0], m[1], m[2], m[3]
            c[E + lane] = drive(m, ocv, soc[row])[0]
            c[INERTIA + lane], c[MASS + lane], c[DRAG + lane] = m[5], m[6] * radius * radius, m[4]
            c[CUT + lane], c[SHARE + lane] = p[slots.K_FC] * radius * radius, m[15]
            fits = fits and c[E + lane] > 0.0
        if fits:
            cuts = np.empty(n_steps)
            for n in range(n_steps):
                cuts[n] = 1.0 if (n < n_steps // 2) == (sign > 0.0) else 0.0
            _solve_block(c, sines, cosines, cuts, sign, n_steps, tolerance, count, results, statuses, first)
