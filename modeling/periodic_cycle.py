"""The periodic stroke over the crank angle, for many parameter vectors at once: what a fit iterates on.

State: motor current i and crank speed W over the crank angle a (Equations 12 and 13, the time eliminated by
dt = da / W). With the gear ratio G and the lever g(a) = (dy/da) / r_c:

    di/da = (U - R i - k_e G W) / (L W)
    dW/da = (G k_m i - b G^2 W - k_Fc r_c^2 g^2 W [cutting]) / (J W) - J' W / (2 J)
    J(a)  = J_m G^2 + J_c + m_a r_c^2 g^2

Range: W > 0 throughout the stroke; a stroke that would stop is reported, not stepped over.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from modeling.compilation import kernel

Floats = NDArray[np.float64]
CuttingHalf = Literal["pi_to_2pi", "zero_to_pi"]

PLANT_NAMES: Final = (
    "resistance_ohm",
    "inductance_h",
    "back_emf_constant_v_s_per_rad",
    "torque_constant_n_m_per_a",
    "rotor_inertia_kg_m2",
    "yoke_inertia_kg_m2",
    "reciprocating_mass_kg",
    "crank_radius_m",
    "motor_damping_n_m_s_per_rad",
)
COLUMNS: Final = (*PLANT_NAMES, "k_fc_n_s_per_m", "voltage_v")
N_STEPS: Final = 64
MOST_NEWTON_STEPS: Final = 30

Lever = Callable[[Floats], Floats]


def periodic_cycles(
    values: Floats,
    *,
    gear_ratio: float,
    cutting_half: CuttingHalf = "pi_to_2pi",
    rod_length_m: float | None = None,
    n_steps: int = N_STEPS,
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Periodic current and crank speed at equally spaced crank angles, one row a parameter vector.

    Classical Runge-Kutta of fourth order in the angle, steps aligned with the dead centres, inside a Newton
    iteration on the stroke map. With the default 64 steps the error is below 1e-6 relative for the jigsaw.

    Parameters
    ----------
    values : ndarray, shape (n_cases, 11)
        Columns as in `COLUMNS`, SI units; the voltage is what drives R, so a battery's resistance is in R.
    gear_ratio : float
        Motor turns a crank turn.
    cutting_half : {"pi_to_2pi", "zero_to_pi"}
    rod_length_m : float, optional
        Length of the connecting rod of a slider-crank; None is a Scotch yoke.
    n_steps : int
        Even number of steps a turn.

    Returns
    -------
    current_a, crank_speed_rad_s : ndarray, shape (n_cases, n_steps)
        At angles 2*pi*j/n_steps.
    is_periodic : ndarray of bool, shape (n_cases,)
        False where the stroke stops or the iteration does not settle; the row then holds zeros.
    """
    values = np.ascontiguousarray(values, dtype=np.float64)
    angle = np.linspace(0.0, 2.0 * np.pi, 2 * n_steps + 1)
    rod = 0.0 if rod_length_m is None else float(rod_length_m)
    cuts = np.sin(angle) < 0 if cutting_half == "pi_to_2pi" else np.sin(angle) > 0
    return _solve(values, np.sin(angle), np.cos(angle), cuts.astype(np.float64), gear_ratio, rod, n_steps)


@kernel()
def _levers(sine, cosine, radius, rod):  # pragma: no cover - compiled
    """G and dg/da of the mechanism; the rod is 0 for a Scotch yoke."""
    lever = sine.copy()
    slope = cosine.copy()
    if rod > 0.0:
        ratio = radius / rod
        for j in range(len(sine)):
            root = np.sqrt(1.0 - (ratio * sine[j]) ** 2)
            lever[j] = sine[j] * (1.0 + ratio * cosine[j] / root)
            slope[j] = cosine[j] + ratio * (
                (cosine[j] ** 2 - sine[j] ** 2) / root + (ratio * sine[j] * cosine[j]) ** 2 / root**3
            )
    return lever, slope


@kernel()
def _slope(i, w, inverse_inertia, half_slope, drag, p):  # pragma: no cover - compiled
    di = (p[0] - p[1] * i - p[2] * w) * p[3] / w
    dw = (p[4] * i / w - drag) * inverse_inertia - half_slope * inverse_inertia * w
    return di, dw


@kernel()
def _stroke(i, w, tables, p, step, current, speed):  # pragma: no cover - compiled
    """One turn from (i, w); False where the crank would stop."""
    n_steps = len(current)
    for n in range(n_steps):
        current[n] = i
        speed[n] = w
        k = 2 * n
        a1, b1 = _slope(i, w, tables[0, k], tables[1, k], tables[2, k], p)
        w2 = w + 0.5 * step * b1
        if not w2 > 0.0:
            return i, w, False
        a2, b2 = _slope(i + 0.5 * step * a1, w2, tables[0, k + 1], tables[1, k + 1], tables[2, k + 1], p)
        w3 = w + 0.5 * step * b2
        if not w3 > 0.0:
            return i, w, False
        a3, b3 = _slope(i + 0.5 * step * a2, w3, tables[0, k + 1], tables[1, k + 1], tables[2, k + 1], p)
        w4 = w + step * b3
        if not w4 > 0.0:
            return i, w, False
        a4, b4 = _slope(i + step * a3, w4, tables[0, k + 2], tables[1, k + 2], tables[2, k + 2], p)
        i += step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        w += step / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
        if not w > 0.0:
            return i, w, False
    return i, w, True


@kernel()
def _solve(values, sine, cosine, cuts, gear, rod, n_steps):  # pragma: no cover - compiled
    n_cases = len(values)
    current = np.zeros((n_cases, n_steps))
    speed = np.zeros((n_cases, n_steps))
    is_periodic = np.zeros(n_cases, dtype=np.bool_)
    scratch_i = np.zeros(n_steps)
    scratch_w = np.zeros(n_steps)
    tables = np.zeros((3, len(sine)))
    p = np.zeros(5)
    step = 2.0 * np.pi / n_steps
    for m in range(n_cases):
        r, inductance, ke, km, jm, jc, mass, radius, damping, kfc, voltage = values[m]
        lever, slope = _levers(sine, cosine, radius, rod)
        for j in range(len(sine)):
            tables[0, j] = 1.0 / (jm * gear**2 + jc + mass * (radius * lever[j]) ** 2)
            tables[1, j] = mass * radius**2 * lever[j] * slope[j]
            tables[2, j] = damping * gear**2 + kfc * (radius * lever[j]) ** 2 * cuts[j]
        p[0], p[1], p[2], p[3], p[4] = voltage, r, ke * gear, 1.0 / inductance, gear * km
        drag = tables[2, :-1].mean()
        w = voltage / (ke * gear + r * drag / (gear * km))
        i = drag * w / (gear * km)
        for _ in range(MOST_NEWTON_STEPS):
            end_i, end_w, runs = _stroke(i, w, tables, p, step, current[m], speed[m])
            if not runs:
                break
            miss_i, miss_w = end_i - i, end_w - w
            if abs(miss_i) < 1e-11 * (abs(i) + 1.0) and abs(miss_w) < 1e-11 * w:
                is_periodic[m] = True
                break
            small_i, small_w = 1e-5 * (abs(i) + 1.0), 1e-5 * w
            ii, wi, runs_i = _stroke(i + small_i, w, tables, p, step, scratch_i, scratch_w)
            iw, ww, runs_w = _stroke(i, w + small_w, tables, p, step, scratch_i, scratch_w)
            if not (runs_i and runs_w):
                break
            a = (ii - end_i) / small_i - 1.0
            c = (wi - end_w) / small_i
            b = (iw - end_i) / small_w
            d = (ww - end_w) / small_w - 1.0
            determinant = a * d - b * c
            i -= (d * miss_i - b * miss_w) / determinant
            w = max(w - (a * miss_w - c * miss_i) / determinant, 0.2 * w)
        if not is_periodic[m]:
            current[m, :] = 0.0
            speed[m, :] = 0.0
    return current, speed, is_periodic
