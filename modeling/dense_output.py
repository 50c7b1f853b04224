"""Values between the steps: quintic Hermite polynomials in time.

Both ends of a step give value, first and second derivative of the current (Eq. 12 once more differentiated)
and of the angle (whose derivatives are speed and acceleration), so the polynomials cost no evaluation of the
model. The speed is the derivative of the angle's polynomial.
"""

from __future__ import annotations

from sawbench.modeling.compilation import kernel


@kernel()
def quintic(h, y0, d0, s0, y1, d1, s1):
    """Coefficients over u in [0, 1] of the quintic with given values, slopes and curvatures at its ends."""
    a1 = h * d0
    a2 = 0.5 * h * h * s0
    rise = y1 - y0 - a1 - a2
    slope = h * d1 - a1 - 2.0 * a2
    curve = h * h * s1 - 2.0 * a2
    return (
        y0,
        a1,
        a2,
        10.0 * rise - 4.0 * slope + 0.5 * curve,
        -15.0 * rise + 7.0 * slope - curve,
        6.0 * rise - 3.0 * slope + 0.5 * curve,
    )


@kernel()
def mean(c):
    """Mean of a quintic over [0, 1]."""
    return c[0] + c[1] / 2.0 + c[2] / 3.0 + c[3] / 4.0 + c[4] / 5.0 + c[5] / 6.0


@kernel()
def at(c, u):
    """Value of a quintic."""
    return c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))))


@kernel()
def slope_at(c, u):
    """Differentiate a quintic with respect to u."""
    return c[1] + u * (2.0 * c[2] + u * (3.0 * c[3] + u * (4.0 * c[4] + u * 5.0 * c[5])))


# Size: compiled, so what it takes and gives are numbers and arrays, each on its own.
@kernel()
def emit(time_s, k, out, gear, t0, t1, current, angle, soc0, soc_rate0, soc1, soc_rate1):
    """Write every sample with time <= t1 from place k on; returns the next place.

    `out` has the rows motor current, motor speed, crank angle, state of charge.
    """
    n = len(time_s)
    if k >= n or time_s[k] > t1:
        return k
    h = t1 - t0
    per = 1.0 / h
    bend2 = 3.0 * (soc1 - soc0) - h * (2.0 * soc_rate0 + soc_rate1)
    bend3 = -2.0 * (soc1 - soc0) + h * (soc_rate0 + soc_rate1)
    while k < n and time_s[k] <= t1:
        u = (time_s[k] - t0) * per
        out[0, k] = at(current, u)
        out[1, k] = gear * per * slope_at(angle, u)
        out[2, k] = at(angle, u)
        out[3, k] = soc0 + u * (h * soc_rate0 + u * (bend2 + u * bend3))
        k += 1
    return k
