"""Kalman filter and smoother of a turning crank, seen through its plunger's displacement.

State: angle, speed, acceleration; the jerk is white noise of spectral density `jerk_density`. Measurement: y
= c + x(angle) + noise, linearised about a given trajectory, so that repeating the smoother is a Gauss-Newton
search for the most probable trajectory (iterated extended Kalman smoother, Bell 1994). The backward pass is
the modified Bryson-Frazier one: no matrix is inverted, so a measurement without information (at a dead centre
dx/dangle = 0) does no harm.
"""

from __future__ import annotations

from math import log

import numpy as np
from numba import njit
from sawbench.bench.recording import Floats
from sawbench.modeling.parts.mechanism import Mechanism


def linearise(mechanism: Mechanism, about_rad: Floats, above_m: Floats, variance_m2: Floats) -> tuple[Floats, Floats]:
    """Measurement rows of the smoother: slope * angle = target.

    Parameters
    ----------
    mechanism : Mechanism
    about_rad : ndarray, shape (n,)
        Trajectory to linearise about.
    above_m : ndarray, shape (n,)
        Measured displacement above the dead centre at angle 0.
    variance_m2 : ndarray, shape (n,)
        Of the noise; infinite marks a sample to be left out.

    Returns
    -------
    slope, target : ndarray, shape (n,)
        m/rad and m; both 0 where the sample is left out.
    """
    displacement_m, lever_m = mechanism.position(about_rad)
    is_used = np.isfinite(variance_m2)
    return np.where(is_used, lever_m, 0.0), np.where(is_used, above_m - displacement_m + lever_m * about_rad, 0.0)


# Size: compiled, so what it takes and gives are numbers and arrays, each on its own.
@njit(cache=True, nogil=True)
def smooth(time, slope, target, variance, is_rest, start, start_std, jerk_density, rest_std, out):
    """One forward and one backward pass over linear measurements of the angle.

    Every second sample at rest measures "speed is 0" instead of the displacement. The filter step is written out
    for its three states: it is called most.

    Parameters
    ----------
    time : ndarray, shape (n,), s
    slope, target, variance : ndarray, shape (n,)
        Rows of `linearise`: m/rad, m, m^2.
    is_rest : ndarray of bool, shape (n,)
    start, start_std : ndarray, shape (3,)
        Prior of angle, speed, acceleration at the first sample: rad, rad/s, rad/s^2.
    jerk_density : float
        rad^2/s^5.
    rest_std : float
        Standard deviation of "speed is 0", rad/s.
    out : ndarray, shape (n, 3)
        Written: angle (rad), speed (rad/s), variance of the angle (rad^2).

    Returns
    -------
    float
        Log-likelihood of the rows.
    """
    n = len(time)
    predicted = np.empty((n, 9))  # state 3, covariance 00 01 02 11 12 22
    innovation = np.zeros((n, 4))  # row: h0, h1, innovation, 1/S
    x0, x1, x2 = start[0], start[1], start[2]
    p00, p11, p22 = start_std[0] ** 2, start_std[1] ** 2, start_std[2] ** 2
    p01 = p02 = p12 = 0.0
    likelihood = 0.0
    for k in range(n):
        if k > 0:
            d = time[k] - time[k - 1]
            e = 0.5 * d * d
            x0 += d * x1 + e * x2
            x1 += d * x2
            # P <- F P F' + Q
            a0, a1, a2 = p00 + d * p01 + e * p02, p01 + d * p11 + e * p12, p02 + d * p12 + e * p22
            b1, b2 = p11 + d * p12, p12 + d * p22
            q = jerk_density * d
            p00 = a0 + d * a1 + e * a2 + q * d**4 / 20.0
            p01 = a1 + d * a2 + q * d**3 / 8.0
            p02 = a2 + q * d * d / 6.0
            p11 = b1 + d * b2 + q * d * d / 3.0
            p12 = b2 + 0.5 * q * d
            p22 = p22 + q
        row = predicted[k]
        row[0], row[1], row[2] = x0, x1, x2
        row[3], row[4], row[5], row[6], row[7], row[8] = p00, p01, p02, p11, p12, p22
        if is_rest[k] and k % 2 == 1:
            h0, h1, z, r = 0.0, 1.0, 0.0, rest_std * rest_std
        else:
            h0, h1, z, r = slope[k], 0.0, target[k], variance[k]
            if h0 == 0.0:
                continue
        g0, g1, g2 = h0 * p00 + h1 * p01, h0 * p01 + h1 * p11, h0 * p02 + h1 * p12
        s = h0 * g0 + h1 * g1 + r
        w = 1.0 / s
        v = z - h0 * x0 - h1 * x1
        likelihood -= 0.5 * (log(s) + v * v * w)
        x0 += g0 * w * v
        x1 += g1 * w * v
        x2 += g2 * w * v
        p00 -= g0 * g0 * w
        p01 -= g0 * g1 * w
        p02 -= g0 * g2 * w
        p11 -= g1 * g1 * w
        p12 -= g1 * g2 * w
        p22 -= g2 * g2 * w
        innovation[k, 0], innovation[k, 1], innovation[k, 2], innovation[k, 3] = h0, h1, v, w
    _backward(time, predicted, innovation, out)
    return likelihood


@njit(cache=True, nogil=True)
def _backward(time, predicted, innovation, out):
    """Run the modified Bryson-Frazier pass: adjoint vector l and matrix m run backwards."""
    n = len(time)
    l0 = l1 = l2 = 0.0
    m00 = m01 = m02 = m11 = m12 = m22 = 0.0
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            d = time[k + 1] - time[k]
            e = 0.5 * d * d
            # l <- F' l, m <- F' m F
            l2 += d * l1 + e * l0
            l1 += d * l0
            a1, a2 = m01 + d * m00, m02 + d * m01 + e * m00
            b2 = m12 + d * (m11 + m02) + (d * d + e) * m01 + d * e * m00
            c2 = m22 + 2.0 * d * m12 + 2.0 * e * m02 + d * d * m11 + 2.0 * d * e * m01 + e * e * m00
            m11 = m11 + 2.0 * d * m01 + d * d * m00
            m01, m02, m12, m22 = a1, a2, b2, c2
        p = predicted[k]
        h0, h1, v, w = innovation[k, 0], innovation[k, 1], innovation[k, 2], innovation[k, 3]
        if w > 0.0:
            # gain K = P h / S; C = I - K h'; l <- C' l - h v / S; m <- C' m C + h h' / S
            k0 = (h0 * p[3] + h1 * p[4]) * w
            k1 = (h0 * p[4] + h1 * p[6]) * w
            k2 = (h0 * p[5] + h1 * p[7]) * w
            kl = k0 * l0 + k1 * l1 + k2 * l2
            u0, u1, u2 = (
                m00 * k0 + m01 * k1 + m02 * k2,
                m01 * k0 + m11 * k1 + m12 * k2,
                m02 * k0 + m12 * k1 + m22 * k2,
            )
            kmk = k0 * u0 + k1 * u1 + k2 * u2
            l0 -= h0 * (kl + v * w)
            l1 -= h1 * (kl + v * w)
            g = kmk + w
            m00 += -2.0 * h0 * u0 + h0 * h0 * g
            m01 += -h0 * u1 - h1 * u0 + h0 * h1 * g
            m02 += -h0 * u2
            m11 += -2.0 * h1 * u1 + h1 * h1 * g
            m12 += -h1 * u2
        out[k, 0] = p[0] - (p[3] * l0 + p[4] * l1 + p[5] * l2)
        out[k, 1] = p[1] - (p[4] * l0 + p[6] * l1 + p[7] * l2)
        t0, t1, t2 = (
            m00 * p[3] + m01 * p[4] + m02 * p[5],
            m01 * p[3] + m11 * p[4] + m12 * p[5],
            m02 * p[3] + m12 * p[4] + m22 * p[5],
        )
        out[k, 2] = max(p[3] - (p[3] * t0 + p[4] * t1 + p[5] * t2), 0.0)
