"""How the crank turns within the stroke, from the mean of all strokes: what the tracker smooths away comes back.

A tracker that follows noisy displacement from moment to moment must smooth, and takes part of the ripple of the
speed with the noise. That ripple repeats with every stroke, so regressing what the displacement leaves on

    y - r (1 - cos phi) = c_0 + c_1 cos phi + r sin phi (d + sum_k a_k cos k phi + b_k sin k phi)

over the whole settled part finds the missing wave d(phi) of the angle with the noise of one mean stroke. What is
left uncertain is handed on, to be counted as an error of the model.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.processed import CrankAngle
from bench.recording import Floats
from diagnosis.reduction import first_motion_s, steady_part
from diagnosis.state import TWO_PI

N_RIPPLE = 8
# Prior standard deviation of the wave's k-th harmonic, rad: that over k^3, as torques of the mechanism make it.
_RIPPLE_RAD = 0.02
_SETTLE_S = 0.8
_FADE_S = 0.03
_LEAST_SAMPLES = 2000
_LEAST_TURNS = 4.0
# Prior standard deviation of offset and radius, as a share of the radius, and of the angle's zero, rad.
_OFF_SHARE = 0.1
_OUTLIER = 6.0
_MAD = 1.4826
_LEAST_NOISE_M = 1e-9


def restore_ripple(angle: CrankAngle, time_s: Floats, displacement_m: Floats) -> tuple[CrankAngle, Floats]:
    """Add to a tracked angle what the mean stroke of the displacement still holds.

    Parameters
    ----------
    angle : CrankAngle
    time_s, displacement_m : ndarray, shape (n,)

    Returns
    -------
    angle : CrankAngle
        Angle and speed with the ripple, faded in about half a second after the first motion; as it was where the
        steady part is too short.
    std_rad : ndarray, shape (8,)
        Standard uncertainty of the wave's harmonics, zeros where nothing was regressed.

    Notes
    -----
    Bias: harmonics that are not certain are drawn to what the tracker found; where the displacement's noise is
    coloured, `std_rad` is too small.
    """
    start_s, end_s = steady_part(angle, first_motion_s(angle))
    settled_s = start_s + _SETTLE_S
    inside = (time_s > settled_s) & (time_s < end_s) & np.isfinite(displacement_m)
    turns_made = float(np.diff(np.interp([settled_s, end_s], angle.time_s, angle.angle_rad))[0]) / TWO_PI
    if inside.sum() < _LEAST_SAMPLES or turns_made < _LEAST_TURNS:
        return angle, np.zeros(N_RIPPLE)
    order = np.arange(1, N_RIPPLE + 1)
    turned = np.interp(time_s[inside], angle.time_s, angle.angle_rad)
    found, variance = _regress(angle.radius_m, *_columns(angle.radius_m, turned, displacement_m[inside]))
    turns = np.outer(angle.angle_rad, order)
    cosine, sine = found[3 : 3 + N_RIPPLE], found[3 + N_RIPPLE :]
    wave = found[2] + np.cos(turns) @ cosine + np.sin(turns) @ sine
    slope = np.cos(turns) @ (order * sine) - np.sin(turns) @ (order * cosine)
    faded_in = 0.5 * (1.0 + np.tanh(0.5 * (angle.time_s - settled_s + 0.4 * _SETTLE_S) / _FADE_S))
    restored = replace(
        angle,
        angle_rad=np.maximum.accumulate(angle.angle_rad + faded_in * wave),
        speed_rad_s=angle.speed_rad_s * (1.0 + faded_in * slope),
    )
    return restored, np.sqrt(variance.mean(axis=0))


def _regress(radius_m: float, design: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Coefficients, and variance of the wave's, shape (2, k); once more without outliers."""
    order = np.arange(1.0, N_RIPPLE + 1)
    known = np.array([_OFF_SHARE * radius_m, _OFF_SHARE * radius_m, _OFF_SHARE])
    precision = np.diag(np.concatenate([known**-2.0, np.tile((_RIPPLE_RAD / order**3) ** -2, 2)]))

    def solve(kept: np.ndarray, noise: float) -> tuple[Floats, Floats, float]:
        scaled = design[kept] / noise
        covariance = np.linalg.inv(scaled.T @ scaled + precision)
        found = covariance @ (scaled.T @ target[kept]) / noise
        return (
            found,
            np.asarray(covariance.diagonal(), dtype=np.float64),
            max(_MAD * float(np.median(np.abs(target - design @ found))), _LEAST_NOISE_M),
        )

    noise = max(_MAD * float(np.median(np.abs(target - np.median(target)))), _LEAST_NOISE_M)
    found, _, noise = solve(np.ones(len(target), dtype=bool), noise)
    found, variance, _ = solve(np.abs(target - design @ found) <= _OUTLIER * noise, noise)
    return found, variance[3:].reshape(2, -1)


def _columns(radius_m: float, turned: Floats, displacement_m: Floats) -> tuple[Floats, Floats]:
    """Columns {1, cos, r sin, r sin cos k, r sin sin k} at the samples, and what the tracked angle leaves."""
    sine, cosine = radius_m * np.sin(turned), np.cos(turned)
    turns = np.outer(turned, np.arange(1, N_RIPPLE + 1))
    columns = [np.stack([np.ones_like(turned), cosine, sine], axis=1)]
    columns += [sine[:, None] * np.cos(turns), sine[:, None] * np.sin(turns)]
    return np.hstack(columns), displacement_m - radius_m * (1.0 - cosine)
