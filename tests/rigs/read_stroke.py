"""A displacement that is off in every stroke alike, as the program that tracks the angle sees it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from sawbench.bench.processed import SteadyPart
from sawbench.processing.crank_angle import track_crank_angle
from sawbench.processing.stroke_ripple import restore_ripple

from tests.rigs.jigsaw_in_time import N_POINTS, RADIUS

# Of every state of the machine that is integrated in time.
ANGLE = (np.arange(N_POINTS) + 0.5) * 2 * np.pi / N_POINTS
ORDERS = np.arange(1, 9)
GRID = 2 * np.pi * np.arange(4000) / 4000


def turning(state):
    """Times at the angles of `GRID` in the mean stroke, and at its end, s."""
    slowness = np.interp(GRID, ANGLE, 1.0 / state.speed_rad_s.mean(axis=0), period=2 * np.pi)
    return np.append(0.0, np.cumsum(0.5 * (slowness + np.roll(slowness, -1)))) * GRID[1]


def tracked_ahead(state, off_m, std_m=1e-5):
    """Harmonics of the angle by which a program that tracks the displacement is ahead, which has noise of `std_m`."""
    time_s, ends_s = np.arange(0.0, 4.0, 1e-4), turning(state)
    turns, within_s = np.divmod(time_s, ends_s[-1])
    turned = 2 * np.pi * turns + np.interp(within_s, ends_s, np.append(GRID, 2 * np.pi))
    noise_m = std_m * np.random.default_rng(8).normal(size=len(time_s))
    shown_m = RADIUS * (1.0 - np.cos(turned)) + np.interp(turned, ANGLE, off_m, period=2 * np.pi) + noise_m
    steady = SteadyPart(first_motion_s=0.0, start_s=0.1, settled_s=0.3, end_s=3.9)
    track = restore_ripple(track_crank_angle(time_s, shown_m), steady, time_s, shown_m)
    kept = (track.time_s > 0.5) & (track.time_s < 3.5)
    at = np.interp(track.time_s[kept], time_s, turned)
    weights = np.gradient(at)
    ahead = weights * (track.angle_rad[kept] - at)
    return 2.0 * np.array([np.sum(ahead * np.exp(-1j * k * at)) for k in ORDERS]) / np.sum(weights)


def read_ahead(state, off_m):
    """The state as it is seen through a displacement that is off in every stroke."""
    found = tracked_ahead(state, off_m) - tracked_ahead(state, 0.0 * off_m)
    waves = np.exp(1j * ORDERS[:, None] * ANGLE)
    ahead, slope, bend = (np.real(((1j * ORDERS) ** k * found) @ waves) for k in range(3))
    names = ("force_n", "current_a", "current_rate_a_s", "battery_voltage_v", "motor_voltage_v", "battery_current_a")
    seen = {name: getattr(state, name) for name in names}
    seen["speed_rad_s"] = state.speed_rad_s * (1.0 + slope)
    seen["acceleration_rad_s2"] = state.acceleration_rad_s2 * (1.0 + slope) + state.speed_rad_s**2 * bend
    shown = ANGLE + ahead
    return replace(
        state,
        **{
            name: np.array([np.interp(ANGLE, shown, wave, period=2 * np.pi) for wave in waves])
            for name, waves in seen.items()
        },
    )
