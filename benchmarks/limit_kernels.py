"""How fast the hardware lets these equations go: kernels that do one case, one output and nothing else.

Written only to be measured against; no part of the product uses them. Constants are folded in, nothing is
checked, no energy is gathered, no event is found. Equation numbers are the paper's.
"""

from __future__ import annotations

import math

import numba
import numpy as np

FAST = {"contract", "nsz", "arcp", "reassoc", "afn"}
R, L, KE, KM, B = 0.176, 3.21e-3, 7.383e-3, 5.632e-3, 3.4274e-6
JM, JC, MA, RC, GEAR = 2.4e-5, 2.38e-5, 0.239, 0.01, 56.0 / 6.0
V0, QAS = 18.0, 1.5 * 3600.0
J0 = JM + JC / GEAR**2
J2 = MA * (RC / GEAR) ** 2


@numba.njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True)
def _rates(i, w, s, c, u, kfc, cuts):
    drag = B + cuts * kfc * (RC / GEAR) ** 2 * s * s
    inertia = J0 + J2 * s * s
    di = (u - R * i - KE * w) / L
    dw = (KM * i - drag * w - J2 / GEAR * s * c * w * w) / inertia
    return di, dw


@numba.njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True)
def one_second_rotations(u, kfc, n, out):
    """RK4 at 1 ms over `n` steps; sine and cosine turn along by small-angle rotations (Eqs. 12, 13)."""
    h = 1e-3
    i = 0.0
    w = 0.0
    s, c = 0.0, 1.0
    out[0] = 0.0
    per = 1.0 / GEAR
    for k in range(1, n):
        i1, w1 = _rates(i, w, s, c, u, kfc, 1.0 if s < 0.0 else 0.0)
        v2 = w + 0.5 * h * w1
        d = 0.5 * h * w * per
        s2, c2 = _turn(s, c, d)
        i2, w2 = _rates(i + 0.5 * h * i1, v2, s2, c2, u, kfc, 1.0 if s2 < 0.0 else 0.0)
        v3 = w + 0.5 * h * w2
        d = 0.5 * h * v2 * per
        s3, c3 = _turn(s, c, d)
        i3, w3 = _rates(i + 0.5 * h * i2, v3, s3, c3, u, kfc, 1.0 if s3 < 0.0 else 0.0)
        v4 = w + h * w3
        d = h * v3 * per
        s4, c4 = _turn(s, c, d)
        i4, w4 = _rates(i + h * i3, v4, s4, c4, u, kfc, 1.0 if s4 < 0.0 else 0.0)
        d = h / 6.0 * (w + 2.0 * v2 + 2.0 * v3 + v4) * per
        s, c = _turn(s, c, d)
        i += h / 6.0 * (i1 + 2.0 * i2 + 2.0 * i3 + i4)
        w += h / 6.0 * (w1 + 2.0 * w2 + 2.0 * w3 + w4)
        out[k] = i


@numba.njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True)
def _turn(s, c, d):
    q = d * d
    sine = d * (1.0 - q * (1.0 / 6.0 - q * (1.0 / 120.0 - q / 5040.0)))
    cosine = 1.0 - q * (0.5 - q * (1.0 / 24.0 - q * (1.0 / 720.0 - q / 40320.0)))
    return s * cosine + c * sine, c * cosine - s * sine


@numba.njit(cache=True, error_model="numpy", nogil=True)
def one_second_naive(u, kfc, n, out):
    """RK4 at 1 ms as one would write it first, sin and cos at every stage."""
    h = 1e-3
    y = np.zeros(3)
    rates = np.zeros((4, 3))
    out[0] = 0.0
    for k in range(1, n):
        for stage in range(4):
            a = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
            i, w, angle = y[0], y[1], y[2]
            if stage > 0:
                i += a * rates[stage - 1, 0]
                w += a * rates[stage - 1, 1]
                angle += a * rates[stage - 1, 2]
            s, c = math.sin(angle / GEAR), math.cos(angle / GEAR)
            di, dw = _rates(i, w, s, c, u, kfc, 1.0 if s < 0.0 else 0.0)
            rates[stage, 0], rates[stage, 1], rates[stage, 2] = di, dw, w
        for j in range(3):
            y[j] += h / 6.0 * (rates[0, j] + 2.0 * rates[1, j] + 2.0 * rates[2, j] + rates[3, j])
        out[k] = y[0]


@numba.njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True)
def _angle_rates(i, w, soc, c, beta, duty, r_b):
    """Rates over the motor angle at a tabulated place c = (drag, 1/inertia, slope of the inertia)."""
    u = duty * V0 * soc / (1.0 - beta * (1.0 - soc)) - duty * duty * r_b * i
    slow = 1.0 / w
    di = ((u - R * i) * slow - KE) / L
    dw = (KM * i * slow - c[0] - c[2] * w) * c[1]
    return di, dw, -duty * i * slow / QAS, slow


@numba.njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True)
def discharge_every_stroke(i, w, beta, duty, r_b, kfc, cuts_first, cutoff, n):
    """Every stroke from (i, w) at a dead centre with a full battery: Dormand-Prince, n steps a stroke; seconds."""
    fractions = (0.0, 0.2, 0.3, 0.8, 8.0 / 9.0, 1.0)
    table = np.empty((n, 6, 3))
    for k in range(n):
        for s in range(6):
            angle = 2.0 * math.pi * (k + fractions[s]) / n
            sine, cosine = math.sin(angle), math.cos(angle)
            cut = kfc if (k < n // 2) == cuts_first else 0.0
            table[k, s, 0] = B + cut * (RC / GEAR) ** 2 * sine * sine
            table[k, s, 1] = 1.0 / (J0 + J2 * sine * sine)
            table[k, s, 2] = J2 / GEAR * sine * cosine
    h = 2.0 * math.pi * GEAR / n
    t, soc, k = 0.0, 1.0, 0
    i1, w1, s1, t1 = _angle_rates(i, w, soc, table[0, 0], beta, duty, r_b)
    while True:
        c = table[k]
        i2, w2, s2, _ = _angle_rates(i + h * 0.2 * i1, w + h * 0.2 * w1, soc + h * 0.2 * s1, c[1], beta, duty, r_b)
        a, b = 3 / 40, 9 / 40
        i3, w3, s3, t3 = _angle_rates(
            i + h * (a * i1 + b * i2), w + h * (a * w1 + b * w2), soc + h * (a * s1 + b * s2), c[2], beta, duty, r_b
        )
        a, b, d = 44 / 45, -56 / 15, 32 / 9
        i4, w4, s4, t4 = _angle_rates(
            i + h * (a * i1 + b * i2 + d * i3), w + h * (a * w1 + b * w2 + d * w3),
            soc + h * (a * s1 + b * s2 + d * s3), c[3], beta, duty, r_b,
        )  # fmt: skip
        a, b, d, e = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
        i5, w5, s5, t5 = _angle_rates(
            i + h * (a * i1 + b * i2 + d * i3 + e * i4), w + h * (a * w1 + b * w2 + d * w3 + e * w4),
            soc + h * (a * s1 + b * s2 + d * s3 + e * s4), c[4], beta, duty, r_b,
        )  # fmt: skip
        a, b, d, e, f = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
        i6, w6, s6, t6 = _angle_rates(
            i + h * (a * i1 + b * i2 + d * i3 + e * i4 + f * i5),
            w + h * (a * w1 + b * w2 + d * w3 + e * w4 + f * w5),
            soc + h * (a * s1 + b * s2 + d * s3 + e * s4 + f * s5), c[5], beta, duty, r_b,
        )  # fmt: skip
        a, b, d, e, f = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
        used = h * (a * s1 + b * s3 + d * s4 + e * s5 + f * s6)
        took = h * (a * t1 + b * t3 + d * t4 + e * t5 + f * t6)
        if soc + used <= cutoff:
            return t + took * (cutoff - soc) / used
        i += h * (a * i1 + b * i3 + d * i4 + e * i5 + f * i6)
        w += h * (a * w1 + b * w3 + d * w4 + e * w5 + f * w6)
        soc += used
        t += took
        i1, w1, s1, t1 = _angle_rates(i, w, soc, c[5], beta, duty, r_b)
        k = k + 1 if k + 1 < n else 0


@numba.njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True)
def strokes(i, w, u, kfc, n, count):
    """`count` strokes at a fixed voltage by the same steps; what one stroke costs, and nothing else."""
    return discharge_every_stroke(i, w, 0.0, u / V0, 0.0, kfc, False, 1.0 - count * 6.1e-5, n)
