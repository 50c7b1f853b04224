"""Synthetic jigsaw trials from an integrator of its own: shares no code with `modeling`'s solvers.

Equations 12, 13 and 16 in the time domain by the classical Runge-Kutta method with a fixed step, the cutting
coefficient drawn again for every stroke, plant constants drawn around their nominals, sensors with gains, offsets and
noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit

NOMINAL = {
    "resistance_ohm": (0.176, 0.05),
    "inductance_h": (0.00321, 0.1),
    "back_emf_constant_v_s_per_rad": (0.007383, 0.02),
    "torque_constant_n_m_per_a": (0.005632, 0.03),
    "rotor_inertia_kg_m2": (2.4e-05, 0.05),
    "yoke_inertia_kg_m2": (2.38e-05, 0.05),
    "reciprocating_mass_kg": (0.239, 0.02),
    "crank_radius_m": (0.01, 0.003),
    "motor_damping_n_m_s_per_rad": (3.4274e-06, 0.3),
}
GEAR_RATIO = 56 / 6
_LONGEST_STEP_S = 5e-5


@dataclass(frozen=True, kw_only=True)
class SyntheticTrial:
    """What the sensors read, and the truth."""

    true_k_fc: float
    true_plant: dict[str, float]
    duty: float
    angle_time_s: np.ndarray
    angle_rad: np.ndarray
    speed_rad_s: np.ndarray
    channels: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)


def draw_plant(rng: np.random.Generator, scale: float = 1.0) -> dict[str, float]:
    """Plant constants around their nominals, `scale` standard deviations wide."""
    return {name: value * (1 + scale * std * rng.normal()) for name, (value, std) in NOMINAL.items()}


def stroke_coefficients(rng, n_strokes, mean, spread, correlation):
    """k_Fc of each stroke: a first-order autoregressive series about its mean."""
    series = np.empty(n_strokes)
    value = rng.normal()
    for n in range(n_strokes):
        series[n] = value
        value = correlation * value + np.sqrt(1 - correlation**2) * rng.normal()
    return mean * (1 + spread * series)


@njit(cache=True)
def _slope(state, constants, k_per_stroke, duty, cell, out):
    """Rate of change of motor current, motor speed, motor angle and charge taken."""
    r, ind, ke, km, jm, jc, ma, rc, b = constants
    capacity_a_s, beta, r_b = cell
    current, omega, theta, charge = state
    k = 1.0 / GEAR_RATIO
    sine, cosine = np.sin(theta * k), np.cos(theta * k)
    soc = 1.0 - charge / capacity_a_s
    u = duty * (18.0 * soc / (1.0 - beta * (1.0 - soc)) - r_b * duty * current)
    cutting = 0.0
    if sine < 0.0:
        stroke = min(int(theta * k // (2.0 * np.pi)), len(k_per_stroke) - 1)
        cutting = k_per_stroke[stroke] * (rc * k * sine) ** 2 * omega
    inertia = jm + jc * k**2 + ma * (rc * k * sine) ** 2
    out[0] = (u - r * current - ke * omega) / ind
    out[1] = (km * current - cutting - b * omega - ma * rc**2 * k**3 * sine * cosine * omega**2) / inertia
    out[2] = omega
    out[3] = duty * current


@njit(cache=True)
def _integrate(constants, k_per_stroke, duty, cell, n_samples, steps, step_s):
    """States at `n_samples` times, `steps` steps of `step_s` apart, shape (n_samples, 4)."""
    found = np.zeros((n_samples, 4))
    state, k1, k2, k3, k4 = np.zeros((5, 4))
    for n in range(1, n_samples):
        for _ in range(steps):
            _slope(state, constants, k_per_stroke, duty, cell, k1)
            _slope(state + 0.5 * step_s * k1, constants, k_per_stroke, duty, cell, k2)
            _slope(state + 0.5 * step_s * k2, constants, k_per_stroke, duty, cell, k3)
            _slope(state + step_s * k3, constants, k_per_stroke, duty, cell, k4)
            state += step_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        found[n] = state
    return found


def simulate(plant, k_per_stroke, duty, seconds, rate_hz, *, capacity_ah=1.5, beta=0.99, r_b=0.02):
    """Time, motor current, motor speed, crank angle, force, battery voltage and current, from rest."""
    time_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    steps = int(np.ceil(1.0 / rate_hz / _LONGEST_STEP_S))
    constants = tuple(float(plant[name]) for name in NOMINAL)
    cell = (3600.0 * capacity_ah, beta, r_b)
    coefficients = np.asarray(k_per_stroke, dtype=float)
    states = _integrate(constants, coefficients, duty, cell, len(time_s), steps, 1.0 / rate_hz / steps)
    current, omega, theta, charge = states.T
    crank = theta / GEAR_RATIO
    stroke = np.clip((crank // (2 * np.pi)).astype(int), 0, len(coefficients) - 1)
    blade_m_s = plant["crank_radius_m"] * omega / GEAR_RATIO * np.maximum(-np.sin(crank), 0.0)
    soc = 1 - charge / (3600.0 * capacity_ah)
    voltage = 18.0 * soc / (1 - beta * (1 - soc)) - r_b * duty * current
    return time_s, current, omega, crank, coefficients[stroke] * blade_m_s, voltage, duty * current


def synthetic_trial(
    seed: int,
    *,
    seconds: float = 8.0,
    k_fc: float = 240.0,
    spread: float = 0.045,
    correlation: float = 0.3,
    duty: float = 0.4375,
    plant: dict[str, float] | None = None,
    sensor_gain_std: float = 0.005,
    voltage_gain_std: float = 0.002,
    angle_zero_std_rad: float = 0.01,
    force_offset_std_n: float = 2.0,
    noise: tuple[float, float, float] = (0.15, 2.0, 0.02),
) -> SyntheticTrial:
    """One trial: plant, stroke variation and sensors drawn with `seed`."""
    rng = np.random.default_rng(seed)
    true_plant = draw_plant(rng) if plant is None else plant
    strokes = stroke_coefficients(rng, int(40 * seconds), k_fc, spread, correlation)
    rate_hz = 5000.0
    time_s, current, omega, crank, force, voltage, battery = simulate(true_plant, strokes, duty, seconds, rate_hz)
    gain = 1 + sensor_gain_std * rng.normal(size=2)
    slow = slice(None, None, 5)
    offset = force_offset_std_n * rng.normal()
    return SyntheticTrial(
        true_k_fc=k_fc,
        true_plant=true_plant,
        duty=duty,
        angle_time_s=time_s,
        angle_rad=np.maximum.accumulate(crank + angle_zero_std_rad * rng.normal()),
        speed_rad_s=omega / GEAR_RATIO,
        channels={
            "force_n": (time_s, gain[1] * force + offset + noise[1] * rng.normal(size=len(time_s))),
            "motor_current_a": (
                time_s[slow],
                gain[0] * current[slow] + noise[0] * rng.normal(size=len(time_s[slow])),
            ),
            "battery_voltage_v": (
                time_s[slow],
                (1 + voltage_gain_std * rng.normal()) * voltage[slow] + noise[2] * rng.normal(size=len(time_s[slow])),
            ),
            "battery_current_a": (time_s[slow], battery[slow]),
        },
    )
