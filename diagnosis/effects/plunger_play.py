"""How a plunger with play moves, and what a tracker of the crank angle makes of its displacement."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bench.recording import Floats
from diagnosis.reduction import angle_derivative
from diagnosis.state import TWO_PI

_FINE = 4
_TURNS = 3
# Stiffness of a tracker that follows displacement with a noise of 5 um a knot and a jerk ripple of 0.3, m^2.
_TRACKER_STIFFNESS_M2 = (5e-6) ** 2 * (TWO_PI / 128) / 0.3**2
_TRACKER_PASSES = 6


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
    is_held: bool,
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
    is_held : bool
        True: guide friction holds the plunger while the pin crosses the gap (slow machines); false: it flies
        freely, as its own inertia and the cut will have it.

    Returns
    -------
    Motion
        Impacts do not bounce.
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
        free = 0.0 if is_held else v + steps[k] * resist / mass_kg
        ahead = x + steps[k] * free - pin[k]
        if abs(ahead) > half:
            x = pin[k] + (half if ahead > 0 else -half)
            force = mass_kg * (pin_velocity[k] - v) / steps[k] - resist
            v = pin_velocity[k]
        else:
            x, v, force = x + steps[k] * free, free, 0.0
        out[:, k] = x, v, force
    return Motion(
        **dict(zip(("position_m", "velocity_m_s", "pin_force_n"), _bin(out, n_points), strict=True))
    )


def _bin(rows: Floats, n_points: int) -> Floats:
    return rows.reshape(len(rows), n_points, _FINE).mean(axis=-1)


def tracked_angle(position_m: Floats) -> Floats:
    """Deviation of the crank angle that a smooth tracker reads off a displacement, rad, shape (n_points,).

    Offset and radius come from the turning points, as in any tracker that knows neither; then the smoothest
    trajectory that explains the displacement (third derivative penalised).
    """
    n = len(position_m)
    angle = (np.arange(n) + 0.5) * TWO_PI / n
    low, high = position_m.min(), position_m.max()
    radius = 0.5 * (high - low)
    penalty = _TRACKER_STIFFNESS_M2 * _third_derivative_square(n)
    deviation = np.zeros(n)
    for _ in range(_TRACKER_PASSES):
        read = angle + deviation
        slope = radius * np.sin(read)
        missing = position_m - low - radius * (1.0 - np.cos(read))
        deviation = np.linalg.solve(np.diag(slope**2) + penalty, slope * (missing + slope * deviation))
    return deviation


@lru_cache(maxsize=4)
def _third_derivative_square(n: int) -> Floats:
    third = angle_derivative(angle_derivative(angle_derivative(np.eye(n))))
    return third @ third.T
