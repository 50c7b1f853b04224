"""One step of the Dormand-Prince 5(4) pair for the baseline machine, over the angle and over time.

Source of the coefficients: Dormand, Prince, J. Comput. Appl. Math. 6 (1980) 19, RK5(4)7M. The last stage of a step is
the first of the next. Integrals for the energy balance use the same fifth-order weights.
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
def angle_rate(m, inverse_j, bend, per_speed, constant, i, w, soc):
    """Rates over the crank angle: di/da, dW/da, dsoc/da, and dt/da, e."""
    slow = 1.0 / w
    e, battery_current = source(m, soc, i)
    di = ((e - m[0] * i) * slow - m[2]) * m[1]
    dw = inverse_j * ((m[3] * i - constant) * slow - per_speed - bend * w)
    return di, dw, -battery_current * m[16] * slow, slow, e


@kernel()
def angle_step(m, rows, h, i, w, soc, first, energy):
    """One step h over the crank angle; `rows` holds `load` at the six stages, `energy` gathers the integrals.

    Returns i, W, soc at the end, the duration, the rates there, and the estimated local errors of i and W.
    """
    a1, b1, c1, r1, e1 = first
    a2, b2, c2, _, _ = angle_rate(
        m, rows[1, 0], rows[1, 1], rows[1, 2], rows[1, 3],
        i + h * A21 * a1, w + h * A21 * b1, soc + h * A21 * c1,
    )  # fmt: skip
    i3 = i + h * (A31 * a1 + A32 * a2)
    w3 = w + h * (A31 * b1 + A32 * b2)
    a3, b3, c3, r3, e3 = angle_rate(
        m, rows[2, 0], rows[2, 1], rows[2, 2], rows[2, 3], i3, w3, soc + h * (A31 * c1 + A32 * c2)
    )
    i4 = i + h * (A41 * a1 + A42 * a2 + A43 * a3)
    w4 = w + h * (A41 * b1 + A42 * b2 + A43 * b3)
    a4, b4, c4, r4, e4 = angle_rate(
        m, rows[3, 0], rows[3, 1], rows[3, 2], rows[3, 3],
        i4, w4, soc + h * (A41 * c1 + A42 * c2 + A43 * c3),
    )  # fmt: skip
    i5 = i + h * (A51 * a1 + A52 * a2 + A53 * a3 + A54 * a4)
    w5 = w + h * (A51 * b1 + A52 * b2 + A53 * b3 + A54 * b4)
    a5, b5, c5, r5, e5 = angle_rate(
        m, rows[4, 0], rows[4, 1], rows[4, 2], rows[4, 3],
        i5, w5, soc + h * (A51 * c1 + A52 * c2 + A53 * c3 + A54 * c4),
    )  # fmt: skip
    i6 = i + h * (A61 * a1 + A62 * a2 + A63 * a3 + A64 * a4 + A65 * a5)
    w6 = w + h * (A61 * b1 + A62 * b2 + A63 * b3 + A64 * b4 + A65 * b5)
    a6, b6, c6, r6, e6 = angle_rate(
        m, rows[5, 0], rows[5, 1], rows[5, 2], rows[5, 3],
        i6, w6, soc + h * (A61 * c1 + A62 * c2 + A63 * c3 + A64 * c4 + A65 * c5),
    )  # fmt: skip
    i7 = i + h * (B1 * a1 + B3 * a3 + B4 * a4 + B5 * a5 + B6 * a6)
    w7 = w + h * (B1 * b1 + B3 * b3 + B4 * b4 + B5 * b5 + B6 * b6)
    s7 = soc + h * (B1 * c1 + B3 * c3 + B4 * c4 + B5 * c5 + B6 * c6)
    duration = h * (B1 * r1 + B3 * r3 + B4 * r4 + B5 * r5 + B6 * r6)
    last = angle_rate(m, rows[5, 0], rows[5, 1], rows[5, 2], rows[5, 3], i7, w7, s7)
    error_i = h * (E1 * a1 + E3 * a3 + E4 * a4 + E5 * a5 + E6 * a6 + E7 * last[0])
    error_w = h * (E1 * b1 + E3 * b3 + E4 * b4 + E5 * b5 + E6 * b6 + E7 * last[1])
    x = m[17]
    energy[0] += h * (
        B1 * (e1 - x * i) * i * r1 + B3 * (e3 - x * i3) * i3 * r3 + B4 * (e4 - x * i4) * i4 * r4
        + B5 * (e5 - x * i5) * i5 * r5 + B6 * (e6 - x * i6) * i6 * r6
    )  # fmt: skip
    energy[1] += h * (
        B1 * i * i * r1 + B3 * i3 * i3 * r3 + B4 * i4 * i4 * r4 + B5 * i5 * i5 * r5 + B6 * i6 * i6 * r6
    )
    energy[2] += h * (B1 * i + B3 * i3 + B4 * i4 + B5 * i5 + B6 * i6)
    energy[3] += h * (B1 * w + B3 * w3 + B4 * w4 + B5 * w5 + B6 * w6)
    damping = m[4]
    energy[4] += h * (
        B1 * (rows[0, 3] + (rows[0, 2] - damping) * w) + B3 * (rows[2, 3] + (rows[2, 2] - damping) * w3)
        + B4 * (rows[3, 3] + (rows[3, 2] - damping) * w4) + B5 * (rows[4, 3] + (rows[4, 2] - damping) * w5)
        + B6 * (rows[5, 3] + (rows[5, 2] - damping) * w6)
    )  # fmt: skip
    return i7, w7, s7, duration, last, error_i, error_w


@kernel()
def time_rate(p, m, spline, base, is_cutting, i, w, angle, soc):
    """Rates over time at `base` + `angle` (rad): di/dt, dW/dt, da/dt, dsoc/dt, then e and the cutting torque."""
    inverse_j, bend, per_speed, constant = load(p, m, spline, base + angle, is_cutting)
    e, battery_current = source(m, soc, i)
    di = (e - m[0] * i - m[2] * w) * m[1]
    dw = inverse_j * (m[3] * i - constant - per_speed * w - bend * w * w)
    return di, dw, w, -battery_current * m[16], e, constant + (per_speed - m[4]) * w


@kernel()
def time_step(p, m, spline, base, is_cutting, h, y, is_held, rates, new, energy):
    """One step h over time from y = (i, W, a, soc), the angle counted from `base`; fills `new` and `energy`.

    With `is_held` the crank stands. Returns the estimated local error of i and W and fills `rates`, shape (7, 6).
    """
    weights = ((A21, 0.0, 0.0, 0.0, 0.0, 0.0), (A31, A32, 0.0, 0.0, 0.0, 0.0), (A41, A42, A43, 0.0, 0.0, 0.0),
               (A51, A52, A53, A54, 0.0, 0.0), (A61, A62, A63, A64, A65, 0.0), (B1, 0.0, B3, B4, B5, B6))  # fmt: skip
    last = (B1, 0.0, B3, B4, B5, B6)
    for k in range(5):
        energy[k] = 0.0
    for stage in range(7):
        i, w, angle, soc = y[0], y[1], y[2], y[3]
        if stage > 0:
            for s in range(stage):
                a = h * weights[stage - 1][s]
                i += a * rates[s, 0]
                w += a * rates[s, 1]
                angle += a * rates[s, 2]
                soc += a * rates[s, 3]
        values = time_rate(p, m, spline, base, is_cutting, i, w, angle, soc)
        for c in range(6):
            rates[stage, c] = values[c]
        if is_held:
            rates[stage, 1] = 0.0
            rates[stage, 2] = 0.0
        if stage < 6:
            b = h * last[stage]
            energy[0] += b * (rates[stage, 4] - m[17] * i) * i
            energy[1] += b * i * i
            energy[2] += b * i * w
            energy[3] += b * w * w
            energy[4] += b * rates[stage, 5] * w
        else:
            new[0], new[1], new[2], new[3] = i, w, angle, soc
    error_i = 0.0
    error_w = 0.0
    for s, e in ((0, E1), (2, E3), (3, E4), (4, E5), (5, E6), (6, E7)):
        error_i += e * rates[s, 0]
        error_w += e * rates[s, 1]
    return math.fabs(h * error_i), math.fabs(h * error_w)
