"""How a plunger with play moves, and what a tracker of the crank angle makes of its displacement."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import copysign

import numpy as np

from bench.recording import Floats
from diagnosis.state import TWO_PI

_FINE = 4
_TURNS = 3
# A tracker that takes 5 um of noise a knot and its largest jerk ripple, 1 (processing.crank_angle), m^2.
_TRACKER_STIFFNESS_M2 = (5e-6) ** 2 * TWO_PI / 128
_TRACKER_PASSES = 6
_TRACKER_HARMONICS = 24
_FIT_HALF_WIDTH_RAD = 0.7


@dataclass(frozen=True, kw_only=True, slots=True)
class Motion:
    """One settled turn, on equally spaced crank angles (middle of bins), shape (n_points,).

    Attributes
    ----------
    position_m, velocity_m_s : ndarray
        Of the plunger.
    pin_force_n : ndarray
        From the pin on the plunger, positive away from the dead centre at angle 0; an impact fills a bin.
    """

    position_m: Floats
    velocity_m_s: Floats
    pin_force_n: Floats


def plunger_motion(
    speed_rad_s: Floats,
    *,
    gap_m: float,
    radius_m: float,
    mass_kg: float,
    damping_n_s_per_m: float,
    cutting_sign: int,
    friction_n: float,
) -> Motion:
    """Carry the plunger through a few turns of the crank by contact time-stepping.

    Parameters
    ----------
    speed_rad_s : ndarray, shape (n_points,)
        Crank speed over one turn.
    gap_m : float
        Width of the slot less the width of the pin.
    radius_m, mass_kg, damping_n_s_per_m, cutting_sign
        Of mechanism and cut.
    friction_n : float
        Guide friction while the pin crosses the gap: 0 lets the plunger fly as inertia and cut will have
        it, a large one holds it where it is.

    Returns
    -------
    Motion
        Impacts do not bounce. The pin force is without the friction.
    """
    n_points = len(speed_rad_s)
    n = n_points * _FINE
    fine = (np.arange(n) + 0.5) * TWO_PI / n
    coarse = (np.arange(n_points) + 0.5) * TWO_PI / n_points
    speed = np.interp(fine, coarse, speed_rad_s, period=TWO_PI)
    steps = (TWO_PI / n / speed).tolist()
    pin = (radius_m * (1.0 - np.cos(fine))).tolist()
    pin_velocity = (radius_m * speed * np.sin(fine)).tolist()
    out = np.empty((3, n))
    half, x, v = 0.5 * gap_m, pin[0], pin_velocity[0]
    for step in range(_TURNS * n):
        k = step % n
        resist = -cutting_sign * damping_n_s_per_m * max(cutting_sign * v, 0.0)
        pulled = v + steps[k] * resist / mass_kg
        free = copysign(max(abs(pulled) - steps[k] * friction_n / mass_kg, 0.0), pulled)
        ahead = x + steps[k] * free - pin[k]
        if abs(ahead) > half:
            x = pin[k] + (half if ahead > 0 else -half)
            force = mass_kg * (pin_velocity[k] - v) / steps[k] - resist
            v = pin_velocity[k]
        else:
            x, v, force = x + steps[k] * free, free, 0.0
        out[:, k] = x, v, force
    return Motion(**dict(zip(("position_m", "velocity_m_s", "pin_force_n"), _bin(out, n_points), strict=True)))


def _bin(rows: Floats, n_points: int) -> Floats:
    return rows.reshape(len(rows), n_points, _FINE).mean(axis=-1)


def tracked_angle(position_m: Floats) -> Floats:
    """Deviation of the crank angle that a smooth tracker reads off a displacement, rad, shape (n_points,).

    Offset and radius come from the dead centres, as in any tracker that knows neither; then the smoothest
    trajectory that explains the displacement (third derivative penalised) by Gauss-Newton.
    """
    n = len(position_m)
    angle = (np.arange(n) + 0.5) * TWO_PI / n
    low = _dead_centre(position_m, int(np.argmin(position_m)))
    high = _dead_centre(position_m, int(np.argmax(position_m)))
    radius = 0.5 * (high - low)
    basis, penalty = _smooth_waves(n)
    deviation = np.zeros(n)
    for _ in range(_TRACKER_PASSES):
        read = angle + deviation
        slope = radius * np.sin(read)
        missing = position_m - low - radius * (1.0 - np.cos(read)) + slope * deviation
        sloped = basis * slope[:, None]
        weights = np.linalg.solve(sloped.T @ sloped + np.diag(penalty), sloped.T @ missing)
        deviation = basis @ weights
    return deviation


@lru_cache(maxsize=4)
def _smooth_waves(n_points: int) -> tuple[Floats, Floats]:
    """Fourier waves over a turn, shape (n_points, 2 h + 1), and the penalty of each (third derivative)."""
    angle = (np.arange(n_points) + 0.5) * TWO_PI / n_points
    orders = np.arange(1, _TRACKER_HARMONICS + 1)
    waves = angle[:, None] * orders
    basis = np.concatenate([np.ones((n_points, 1)), np.cos(waves), np.sin(waves)], axis=1)
    third = 0.5 * n_points * orders.astype(float) ** 6
    return basis, _TRACKER_STIFFNESS_M2 * np.concatenate([[1.0], third, third])


def _dead_centre(position_m: Floats, middle: int) -> float:
    """Extreme of a fourth-order polynomial through a dead centre: a plateau of play lies inside of it."""
    n = len(position_m)
    half = round(_FIT_HALF_WIDTH_RAD / TWO_PI * n)
    offset = np.arange(-half, half + 1)
    fitted = np.polynomial.Polynomial.fit(offset, position_m[(middle + offset) % n], 4)
    near = fitted(np.linspace(-0.5 * half, 0.5 * half, 101))
    is_top = position_m[middle] > np.mean(position_m)
    return float(near.max() if is_top else near.min())
