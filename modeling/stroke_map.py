"""One stroke of the baseline machine at a fixed state of charge, with the exact derivative of its end.

The state is (i, r), current and inverse crank speed at the dead centre at angle 0. The stroke's end and its
integrals are differentiated by the variational equations, stepped along with the state by the same
Dormand-Prince formula, so that the derivative is exactly that of the discrete map and a Newton
iteration converges quadratically.
"""

from __future__ import annotations

import math

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
from modeling.machine import source


@kernel()
def tangent_rate(m, row, curve, y):
    """Rates over the angle of y = (i, r, di/di0, di/dr0, dr/di0, dr/dr0), and the battery current."""
    i, r = y[0], y[1]
    e, battery_current = source(m, curve, 0.0, i)
    e_slope = 0.0
    if m[7] == slots.HELD_VOLTAGE and e != m[9] - m[19]:
        e_slope = -m[13]
    torque = m[3] * i - row[3]
    i_i = (e_slope - m[0]) * r * m[1]
    i_r = (e - m[0] * i) * m[1]
    r_i = -row[0] * m[3] * r * r * r
    r_r = -row[0] * (r * (3.0 * torque * r - 2.0 * row[2]) - row[1])
    return (
        (i_r * r - m[2] * m[1]),
        -row[0] * r * (r * (torque * r - row[2]) - row[1]),
        i_i * y[2] + i_r * y[4],
        i_i * y[3] + i_r * y[5],
        r_i * y[2] + r_r * y[4],
        r_i * y[3] + r_r * y[5],
        battery_current,
    )


@kernel()
def _plus(y, a, k):
    return (
        y[0] + a * k[0],
        y[1] + a * k[1],
        y[2] + a * k[2],
        y[3] + a * k[3],
        y[4] + a * k[4],
        y[5] + a * k[5],
    )


@kernel()
def _gather(q, weight, y, k):
    """Integrals of dt, i dt and i_b dt, and the derivatives of the first two by i0 and r0."""
    i, r = y[0], y[1]
    return (
        q[0] + weight * r,
        q[1] + weight * i * r,
        q[2] + weight * k[6] * r,
        q[3] + weight * y[4],
        q[4] + weight * y[5],
        q[5] + weight * (y[2] * r + i * y[4]),
        q[6] + weight * (y[3] * r + i * y[5]),
    )


@kernel()
def tangent_stroke(m, tables, curve, h, i, r):
    """One stroke from (i, r) with derivatives.

    Returns the end y (as in `tangent_rate`), the integrals (as in `_gather`), and the largest local errors
    of i and r.
    """
    y = (i, r, 1.0, 0.0, 0.0, 1.0)
    q = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    worst_i = 0.0
    worst_r = 0.0
    k1 = tangent_rate(m, tables[0, 0], curve, y)
    for n in range(len(tables)):
        rows = tables[n]
        k2 = tangent_rate(m, rows[1], curve, _plus(y, h * A21, k1))
        y3 = _plus(_plus(y, h * A31, k1), h * A32, k2)
        k3 = tangent_rate(m, rows[2], curve, y3)
        y4 = _plus(_plus(_plus(y, h * A41, k1), h * A42, k2), h * A43, k3)
        k4 = tangent_rate(m, rows[3], curve, y4)
        y5 = _plus(_plus(_plus(_plus(y, h * A51, k1), h * A52, k2), h * A53, k3), h * A54, k4)
        k5 = tangent_rate(m, rows[4], curve, y5)
        y6 = _plus(_plus(_plus(_plus(_plus(y, h * A61, k1), h * A62, k2), h * A63, k3), h * A64, k4), h * A65, k5)
        k6 = tangent_rate(m, rows[5], curve, y6)
        q = _gather(q, h * B1, y, k1)
        q = _gather(q, h * B3, y3, k3)
        q = _gather(q, h * B4, y4, k4)
        q = _gather(q, h * B5, y5, k5)
        q = _gather(q, h * B6, y6, k6)
        y = _plus(_plus(_plus(_plus(_plus(y, h * B1, k1), h * B3, k3), h * B4, k4), h * B5, k5), h * B6, k6)
        k7 = tangent_rate(m, rows[5], curve, y)
        error_i = E1 * k1[0] + E3 * k3[0] + E4 * k4[0] + E5 * k5[0] + E6 * k6[0] + E7 * k7[0]
        error_r = E1 * k1[1] + E3 * k3[1] + E4 * k4[1] + E5 * k5[1] + E6 * k6[1] + E7 * k7[1]
        worst_i = max(worst_i, math.fabs(error_i))
        worst_r = max(worst_r, math.fabs(error_r))
        k1 = k7
    return y, q, h * worst_i, h * worst_r
