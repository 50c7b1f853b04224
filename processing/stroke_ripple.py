"""How the crank turns within the stroke, from the mean of all strokes: what the tracker smooths away comes back.

A tracker that follows noisy displacement from moment to moment must smooth, and takes part of the ripple of the
speed with the noise. That ripple repeats with every stroke, so regressing what the displacement leaves on

    y - x(phi) = c_0 + c_1 (1 - x(phi) / r) + x'(phi) (d + sum_k a_k cos k phi + b_k sin k phi)

with the mechanism's displacement x and lever x' over the whole settled part finds the missing wave d(phi) of the
angle with the noise of one mean stroke; c_0 and c_1 take an offset and a gain of the sensor. What is left
uncertain is handed on, to be counted as an error of the model.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.processed import CrankAngle, SteadyPart
from sawbench.bench.recording import Floats
from sawbench.bench.spread import robust_std
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.processing.binning import AngleGrid
from sawbench.processing.settled import SETTLE_S, TWO_PI

N_RIPPLE = 8
# Samples are pooled in so many cells of the crank angle: the wave turns by less than 0.03 rad within one.
_CELLS = 2048
# Prior standard deviation of the wave's k-th harmonic, rad: that over k^3, as torques of the mechanism make it.
_RIPPLE_RAD = 0.02
_FADE_S = 0.03
_LEAST_SAMPLES = 100
_LEAST_TURNS = 4.0
# Prior standard deviation of offset and gain, as a share of the radius, and of the angle's zero, rad.
_OFF_SHARE = 0.1
_OUTLIER = 6.0
_LEAST_NOISE_M = 1e-9


def restore_ripple(angle: CrankAngle, steady: SteadyPart, time_s: Floats, displacement_m: Floats) -> CrankAngle:
    """Add to a tracked angle what the mean stroke of the displacement still holds.

    Parameters
    ----------
    angle : CrankAngle
    steady : SteadyPart
    time_s, displacement_m : ndarray, shape (n,)

    Returns
    -------
    CrankAngle
        Angle and speed with the ripple, faded in about half a second after the first motion, and the standard
        uncertainty of its harmonics 1 to 8; as it was, with zeros for the uncertainty, where the settled part
        is too short.

    Notes
    -----
    Bias: harmonics that are not certain are drawn to what the tracker found; where the displacement's noise is
    coloured, `ripple_std_rad` is too small.
    """
    inside = (time_s > steady.settled_s) & (time_s < steady.end_s)
    ends_rad = np.interp([steady.settled_s, steady.end_s], angle.time_s, angle.angle_rad)
    if inside.sum() < _LEAST_SAMPLES or float(np.diff(ends_rad)[0]) < _LEAST_TURNS * TWO_PI:
        return replace(angle, ripple_std_rad=np.zeros(N_RIPPLE))
    crank = Mechanism(radius_m=angle.radius_m, rod_length_m=angle.rod_length_m)
    turned = np.interp(time_s[inside], angle.time_s, angle.angle_rad)
    found, variance = _regress(crank, turned, displacement_m[inside] - crank.displacement(turned))
    # Powers of exp(i phi), summed by Horner's rule: sum_k (a_k cos k phi + b_k sin k phi), and its derivative.
    turning = np.exp(1j * angle.angle_rad)
    waves = found[3 : 3 + N_RIPPLE] - 1j * found[3 + N_RIPPLE :]
    wave, slope = np.zeros_like(turning), np.zeros_like(turning)
    for k in range(N_RIPPLE, 0, -1):
        wave = (wave + waves[k - 1]) * turning
        slope = (slope + 1j * k * waves[k - 1]) * turning
    faded_in = 0.5 * (1.0 + np.tanh(0.5 * (angle.time_s - steady.settled_s + 0.4 * SETTLE_S) / _FADE_S))
    return replace(
        angle,
        angle_rad=np.maximum.accumulate(angle.angle_rad + faded_in * (found[2] + np.real(wave))),
        speed_rad_s=angle.speed_rad_s * (1.0 + faded_in * np.real(slope)),
        ripple_std_rad=np.sqrt(variance.mean(axis=0)),
    )


def wave_seen(crank: Mechanism, at_rad: Floats, off_m: Floats, n_harmonics: int = N_RIPPLE) -> Floats:
    """Wave of the angle that a plunger shows which is off by as much in every stroke: what a regression finds in it.

    Parameters
    ----------
    crank : Mechanism
    at_rad : ndarray, shape (n_points,)
        Evenly over one turn.
    off_m : ndarray, shape (n_points,)
    n_harmonics : int
        Those of the regression here where noise hides the wave from the tracker, more where it follows that itself.

    Returns
    -------
    ndarray, shape (n_points,)
        rad, of the first harmonics and without a mean.
    """
    return _seen_by_regression(crank, float(at_rad[0]), len(at_rad), n_harmonics) @ off_m


@lru_cache(maxsize=8)
def _seen_by_regression(crank: Mechanism, first_rad: float, n_points: int, n_harmonics: int) -> Floats:
    """What `wave_seen` makes of a unit at each of the even angles: a column each, rad/m, shape (n_points, n_points)."""
    at_rad = first_rad + np.arange(n_points) * TWO_PI / n_points
    fitted = np.linalg.pinv(_columns(crank, at_rad, n_harmonics))[3:]
    turns = np.outer(at_rad, np.arange(1, n_harmonics + 1))
    return np.asarray(np.hstack([np.cos(turns), np.sin(turns)]) @ fitted, dtype=np.float64)


def _regress(crank: Mechanism, turned_rad: Floats, left_m: Floats) -> tuple[Floats, Floats]:
    """Coefficients, and variance of the wave's, shape (2, k); once more without outliers."""
    grid = AngleGrid.over_one_turn(turned_rad, _CELLS)
    cell = grid.place(turned_rad)
    design = _columns(crank, grid.middles_rad)
    order = np.arange(1.0, N_RIPPLE + 1)
    known = np.array([_OFF_SHARE * crank.radius_m, _OFF_SHARE * crank.radius_m, _OFF_SHARE])
    precision = np.diag(np.concatenate([known**-2.0, np.tile((_RIPPLE_RAD / order**3) ** -2, 2)]))

    def solve(kept: NDArray[np.bool_], noise_m: float) -> tuple[Floats, Floats]:
        total_m, count = grid.sums(np.where(kept, cell, -1), left_m)
        covariance = np.linalg.inv((design.T * count[0]) @ design / noise_m**2 + precision)
        return covariance @ (design.T @ total_m[0]) / noise_m**2, np.asarray(covariance.diagonal(), dtype=np.float64)

    noise_m = _spread(left_m - np.median(left_m))
    found, _ = solve(np.ones(len(cell), dtype=bool), noise_m)
    off_m = left_m - (design @ found)[cell]
    noise_m = _spread(off_m)
    found, variance = solve(np.abs(off_m) <= _OUTLIER * noise_m, noise_m)
    return found, variance[3:].reshape(2, -1)


def _spread(off_m: Floats) -> float:
    return max(robust_std(off_m), _LEAST_NOISE_M)


def _columns(crank: Mechanism, at_rad: Floats, n_harmonics: int = N_RIPPLE) -> Floats:
    """Columns {1, 1 - x/r, x', x' cos k, x' sin k} at some angles, shape (n, 3 + 2 n_harmonics)."""
    displacement_m, lever_m = crank.position(at_rad)
    turns = np.outer(at_rad, np.arange(1, n_harmonics + 1))
    columns = [np.stack([np.ones(len(at_rad)), 1.0 - displacement_m / crank.radius_m, lever_m], axis=1)]
    columns += [lever_m[:, None] * np.cos(turns), lever_m[:, None] * np.sin(turns)]
    return np.hstack(columns)
