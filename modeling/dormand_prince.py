"""One step of the Dormand-Prince 5(4) pair for the baseline machine, over the angle and over time.

Source of the coefficients: Dormand, Prince, J. Comput. Appl. Math. 6 (1980) 19, RK5(4)7M. The last stage of
a step is the first of the next. The sums put the newest stage last: it is the only one the next stage has to
wait for.

Over the angle the speed is carried as its inverse r = dt/da, which turns Eqs. 12 and 13 into polynomials:

    di/da = ((e - R_x i) r - k_e G) / L
    dr/da = -r (r ((G k_m i - F s g) r - (b G^2 + k_Fc g^2)) - m_a g g') / J
"""

from __future__ import annotations

import math

import numpy as np

from modeling.compilation import kernel
from modeling.machine import load, source

FRACTIONS = np.array([0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0])
A21 = 1 / 5
A31, A32 = 3 / 40, 9 / 40
A41, A42, A43 = 44 / 45, -56 / 15, 32 / 9
A51, A52, A53, A54 = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
A61, A62, A63, A64, A65 = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
B1, B3, B4, B5, B6 = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
E1, E3, E4, E5, E6, E7 = 71 / 57600, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40


@kernel()
def angle_rate(m, row, curve, i, r, away):
    """Rates over the crank angle: di/da, dr/da, dsoc/da, then e; `row` is `load` at this angle."""
    e, battery_current = source(m, curve, away, i)
    di = ((e - m[0] * i) * r - m[2]) * m[1]
    dr = -row[0] * r * (r * ((m[3] * i - row[3]) * r - row[2]) - row[1])
    return di, dr, -battery_current * m[16] * r, e


@kernel()
def angle_step(m, rows, curve, h, i, r, first):
    """Take one step h over the crank angle.

    `rows`, shape (6, 4), holds `load` at the stages, `curve` is `drive` at the start.

    Returns the end (i, r, and the change of the charge), its rates, the duration, the stages (i, r, e each,
    of the weights that are not 0) and the sums for the local error estimate of i and r, up to the factor h.
    """
    i1, r1, c1, e1 = first
    i2, r2, c2, _ = angle_rate(m, rows[1], curve, i + h * A21 * i1, r + h * A21 * r1, h * A21 * c1)
    y3 = (i + h * A31 * i1) + h * A32 * i2
    z3 = (r + h * A31 * r1) + h * A32 * r2
    i3, r3, c3, e3 = angle_rate(m, rows[2], curve, y3, z3, h * (A31 * c1 + A32 * c2))
    y4 = (i + h * (A41 * i1 + A42 * i2)) + h * A43 * i3
    z4 = (r + h * (A41 * r1 + A42 * r2)) + h * A43 * r3
    i4, r4, c4, e4 = angle_rate(m, rows[3], curve, y4, z4, h * (A41 * c1 + A42 * c2 + A43 * c3))
    y5 = (i + h * (A51 * i1 + A52 * i2 + A53 * i3)) + h * A54 * i4
    z5 = (r + h * (A51 * r1 + A52 * r2 + A53 * r3)) + h * A54 * r4
    i5, r5, c5, e5 = angle_rate(m, rows[4], curve, y5, z5, h * (A51 * c1 + A52 * c2 + A53 * c3 + A54 * c4))
    y6 = (i + h * (A61 * i1 + A62 * i2 + A63 * i3 + A64 * i4)) + h * A65 * i5
    z6 = (r + h * (A61 * r1 + A62 * r2 + A63 * r3 + A64 * r4)) + h * A65 * r5
    i6, r6, c6, e6 = angle_rate(m, rows[5], curve, y6, z6, h * (A61 * c1 + A62 * c2 + A63 * c3 + A64 * c4 + A65 * c5))
    end_i = (i + h * (B1 * i1 + B3 * i3 + B4 * i4 + B5 * i5)) + h * B6 * i6
    end_r = (r + h * (B1 * r1 + B3 * r3 + B4 * r4 + B5 * r5)) + h * B6 * r6
    away = h * (B1 * c1 + B3 * c3 + B4 * c4 + B5 * c5 + B6 * c6)
    duration = h * (B1 * r + B3 * z3 + B4 * z4 + B5 * z5 + B6 * z6)
    last = angle_rate(m, rows[5], curve, end_i, end_r, away)
    stages = ((i, r, e1), (y3, z3, e3), (y4, z4, e4), (y5, z5, e5), (y6, z6, e6))
    error_i = E1 * i1 + E3 * i3 + E4 * i4 + E5 * i5 + E6 * i6 + E7 * last[0]
    error_r = E1 * r1 + E3 * r3 + E4 * r4 + E5 * r5 + E6 * r6 + E7 * last[1]
    return end_i, end_r, away, last, duration, stages, error_i, error_r


@kernel()
def angle_energy(m, rows, h, stages):
    """Integrals of U i, i^2, i W, W^2 and cutting power over an angle step, with the step's own weights."""
    supplied = copper = converted = damped = cut = 0.0
    for (current, slow, e), weight, row in (
        (stages[0], B1, rows[0]),
        (stages[1], B3, rows[2]),
        (stages[2], B4, rows[3]),
        (stages[3], B5, rows[4]),
        (stages[4], B6, rows[5]),
    ):
        speed = 1.0 / slow
        supplied += weight * (e - m[17] * current) * current * slow
        copper += weight * current * current * slow
        converted += weight * current
        damped += weight * speed
        cut += weight * (row[3] + (row[2] - m[4]) * speed)
    return h * supplied, h * copper, h * converted, h * damped, h * cut


@kernel()
def time_rate(c, m, spline, place, i, w, angle, away):
    """Rates over time: di/dt, dW/dt, dsoc/dt, then e and the cutting torque.

    `c` is `cutter`; `place` is (is_second, is_cutting, curve): which half of the turn, whether it cuts,
    `drive`.
    """
    inverse_j, bend, per_speed, constant = load(c, m, spline, place[0], angle, place[1])
    e, battery_current = source(m, place[2], away, i)
    di = (e - m[0] * i - m[2] * w) * m[1]
    dw = inverse_j * (m[3] * i - constant - per_speed * w - bend * w * w)
    return di, dw, -battery_current * m[16], e, constant + (per_speed - m[4]) * w


@kernel()
def time_step(c, m, spline, place, h, y, moves):
    """Take one step h over time from y = (i, W, a, soc), a from the last dead centre.

    `moves` is 0.0 for a crank held, else 1.0.

    Returns the end, the rates at both ends (di/dt, dW/dt, dsoc/dt), the local errors of i and W, and the
    integrals of U i, i^2, i W, W^2 and cutting power.
    """
    i, w, a, soc = y
    q = 0.0
    f1 = time_rate(c, m, spline, place, i, w, a, q)
    i1, w1, q1 = f1[0], moves * f1[1], f1[2]
    v2 = w + h * A21 * w1
    f2 = time_rate(c, m, spline, place, i + h * A21 * i1, v2, a + h * A21 * moves * w, q + h * A21 * q1)
    i2, w2, q2 = f2[0], moves * f2[1], f2[2]
    u3, v3 = i + h * (A31 * i1 + A32 * i2), w + h * (A31 * w1 + A32 * w2)
    f3 = time_rate(c, m, spline, place, u3, v3, a + h * moves * (A31 * w + A32 * v2), q + h * (A31 * q1 + A32 * q2))
    i3, w3, q3 = f3[0], moves * f3[1], f3[2]
    u4 = i + h * (A41 * i1 + A42 * i2 + A43 * i3)
    v4 = w + h * (A41 * w1 + A42 * w2 + A43 * w3)
    a4 = a + h * moves * (A41 * w + A42 * v2 + A43 * v3)
    f4 = time_rate(c, m, spline, place, u4, v4, a4, q + h * (A41 * q1 + A42 * q2 + A43 * q3))
    i4, w4, q4 = f4[0], moves * f4[1], f4[2]
    u5 = i + h * (A51 * i1 + A52 * i2 + A53 * i3 + A54 * i4)
    v5 = w + h * (A51 * w1 + A52 * w2 + A53 * w3 + A54 * w4)
    a5 = a + h * moves * (A51 * w + A52 * v2 + A53 * v3 + A54 * v4)
    s5 = q + h * (A51 * q1 + A52 * q2 + A53 * q3 + A54 * q4)
    f5 = time_rate(c, m, spline, place, u5, v5, a5, s5)
    i5, w5, q5 = f5[0], moves * f5[1], f5[2]
    u6 = i + h * (A61 * i1 + A62 * i2 + A63 * i3 + A64 * i4 + A65 * i5)
    v6 = w + h * (A61 * w1 + A62 * w2 + A63 * w3 + A64 * w4 + A65 * w5)
    a6 = a + h * moves * (A61 * w + A62 * v2 + A63 * v3 + A64 * v4 + A65 * v5)
    s6 = q + h * (A61 * q1 + A62 * q2 + A63 * q3 + A64 * q4 + A65 * q5)
    f6 = time_rate(c, m, spline, place, u6, v6, a6, s6)
    i6, w6, q6 = f6[0], moves * f6[1], f6[2]
    end = (
        i + h * (B1 * i1 + B3 * i3 + B4 * i4 + B5 * i5 + B6 * i6),
        w + h * (B1 * w1 + B3 * w3 + B4 * w4 + B5 * w5 + B6 * w6),
        a + h * moves * (B1 * w + B3 * v3 + B4 * v4 + B5 * v5 + B6 * v6),
        soc + h * (B1 * q1 + B3 * q3 + B4 * q4 + B5 * q5 + B6 * q6),
    )
    f7 = time_rate(c, m, spline, place, end[0], end[1], end[2], end[3] - soc)
    last = (f7[0], moves * f7[1], f7[2])
    errors = (
        math.fabs(h * (E1 * i1 + E3 * i3 + E4 * i4 + E5 * i5 + E6 * i6 + E7 * last[0])),
        math.fabs(h * (E1 * w1 + E3 * w3 + E4 * w4 + E5 * w5 + E6 * w6 + E7 * last[1])),
    )
    supplied = copper = converted = damped = cut = 0.0
    for current, speed, f, weight in (
        (i, w, f1, B1),
        (u3, v3, f3, B3),
        (u4, v4, f4, B4),
        (u5, v5, f5, B5),
        (u6, v6, f6, B6),
    ):
        supplied += weight * (f[3] - m[17] * current) * current
        copper += weight * current * current
        converted += weight * current * speed
        damped += weight * speed * speed
        cut += weight * f[4] * speed
    energy = (h * supplied, h * copper, h * converted, h * damped, h * cut)
    return end, (i1, w1, q1), last, errors, energy
