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
