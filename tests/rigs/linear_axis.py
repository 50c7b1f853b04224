"""A drive axis made for tests: a controlled mass with friction, integrated by scipy; no code of `diagnosis`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

RATE_HZ = 1000.0
FORCE_A_CURRENT = 25.0


@dataclass(frozen=True, kw_only=True)
class Friction:
    """LuGre friction with a share that the load presses on; bristles of `stiffness` N/m."""

    viscous: float = 60.0
    coulomb: float = 0.0
    static_ratio: float = 1.3
    stribeck_m_s: float = 0.02
    stiffness: float = 4e4
    load_share: float = 0.0


def run_axis(
    friction: Friction,
    *,
    rate_hz: float,
    load_n: float,
    seconds: float,
    seed: int,
    mass_kg: float = 4.0,
    ripple_n: float = 0.0,
) -> dict[str, np.ndarray]:
    """Columns of one trial: a sine of 40 mm stroke against a load of `load_n` that rises a little along the travel."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    turn = 2 * np.pi * rate_hz

    def wish(t):
        return 0.02 * np.sin(turn * t), 0.02 * turn * np.cos(turn * t), -0.02 * turn**2 * np.sin(turn * t)

    def load(x):
        return load_n * (1.0 + 4.0 * x)

    def drive(t, x, v):
        position, velocity, acceleration = wish(t)
        return 4.0 * acceleration + 2e5 * (position - x) + 1500.0 * (velocity - v) + load(x)

    def rubbed(x, v, z):
        normal = friction.coulomb + friction.load_share * abs(load(x))
        if normal <= 0.0:
            return friction.viscous * v, -100.0 * z
        grip = normal * (1.0 + (friction.static_ratio - 1.0) * np.exp(-((v / friction.stribeck_m_s) ** 2)))
        z_rate = v - friction.stiffness * abs(v) * z / grip
        return friction.stiffness * z + 20.0 * z_rate + friction.viscous * v, z_rate

    def rates(t, y):
        x, v, z = y
        braking, z_rate = rubbed(x, v, z)
        push = drive(t, x, v) + ripple_n * np.sin(2 * np.pi * x / 0.007)
        return [v, (push - braking - load(x)) / mass_kg, z_rate]

    found = solve_ivp(
        rates,
        (0.0, seconds),
        [0.0, wish(0.0)[1], 0.0],
        method="LSODA",
        t_eval=time,
        rtol=1e-6,
        atol=1e-9,
        max_step=0.01,
    )
    x, v, _ = found.y
    encoder_m = 2e-6
    return {
        "time_s": time,
        "displacement_mm": 1e3 * encoder_m * np.round(x / encoder_m),
        "motor_current_a": drive(time, x, v) / FORCE_A_CURRENT + rng.normal(0.0, 0.02, len(time)),
        "force_n": load(x) + rng.normal(0.0, 0.1, len(time)),
    }


def campaign(friction: Friction, *, seed: int, **more: float) -> dict[str, tuple[str, dict[str, np.ndarray]]]:
    """Seven trials, three rates with two loads, one of them repeated: (workpiece, columns) by name."""
    points = [(0.5, 0.0), (1.0, 0.0), (2.0, 0.0), (0.5, 60.0), (1.0, 60.0), (2.0, 60.0)]
    points += [(1.0, 60.0)]
    return {
        f"axis-{k:02d}": (
            f"weight of {load_n:g} N",
            run_axis(friction, rate_hz=rate, load_n=load_n, seconds=6.0, seed=100 * seed + k, **more),
        )
        for k, (rate, load_n) in enumerate(points)
    }
