"""A displacement sensor whose mount rings with the force that moves the plunger: no gap, and no play of the yoke."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.processed import SteadyPart
from sawbench.diagnosis.inference.beyond.sensor_mount import SENSOR_MOUNT
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.posterior import judge
from sawbench.processing.crank_angle import track_crank_angle
from sawbench.processing.stroke_ripple import restore_ripple

from tests.rigs.jigsaw_in_time import BASELINE, MASS, RADIUS, Machine, gap
from tests.rigs.scattered_strokes import problem_of, strokes

pytestmark = pytest.mark.pipeline

INTACT = Machine().run()
ANGLE = INTACT.angle_rad[0]
ORDERS = np.arange(1, 9)
# Of the mount, and of what the law is stated for.
MOUNT_KG, ORDINARY_KG = 3.0, 2.5
GRID = 2 * np.pi * np.arange(4000) / 4000


def turning(state):
    """Times at the angles of `GRID` in the mean stroke, and at its end, s."""
    slowness = np.interp(GRID, ANGLE, 1.0 / state.speed_rad_s.mean(axis=0), period=2 * np.pi)
    return np.append(0.0, np.cumsum(0.5 * (slowness + np.roll(slowness, -1)))) * GRID[1]


def ringing(state, *, frequency_hz, damping=0.02, mass_kg=MOUNT_KG):
    """How far a sensor's mount, a mass on a spring and a damper, is beyond where a slow force would hold it, m.

    In many small steps, until every turn is as the one before.
    """
    natural, steps_s = 2 * np.pi * frequency_hz, np.diff(turning(state))
    velocity = RADIUS * np.sin(GRID) * np.interp(GRID, ANGLE, state.speed_rad_s.mean(axis=0), period=2 * np.pi)
    inertia_n = MASS * (np.roll(velocity, -1) - np.roll(velocity, 1)) / (steps_s + np.roll(steps_s, 1))
    cut_n = BASELINE.cutting_sign * np.interp(GRID, ANGLE, state.force_n.mean(axis=0), period=2 * np.pi)
    pushed = -(inertia_n + cut_n) / mass_kg
    at, speed, way = 0.0, 0.0, np.zeros(len(GRID))
    for _ in range(60):
        for k, step_s in enumerate(steps_s.tolist()):
            speed += step_s * (pushed[k] - natural**2 * at - 2 * damping * natural * speed)
            at += step_s * speed
            way[k] = at
    return np.interp(ANGLE, GRID, way - pushed / natural**2, period=2 * np.pi)


def tracked_ahead(state, off_m):
    """Harmonics of the angle by which a program that tracks the displacement is ahead, which is off in every stroke."""
    time_s, ends_s = np.arange(0.0, 4.0, 1e-4), turning(state)
    turns, within_s = np.divmod(time_s, ends_s[-1])
    turned = 2 * np.pi * turns + np.interp(within_s, ends_s, np.append(GRID, 2 * np.pi))
    noise_m = 1e-5 * np.random.default_rng(8).normal(size=len(time_s))
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


@pytest.mark.parametrize("frequency_hz", [101.0, 110.0, 180.0])
def test_a_mount_that_rings_leaves_what_its_law_says(frequency_hz):
    """But for a twentieth, and of the size of that mass but for three tenths: the tracker follows a part by itself."""
    intact = gap(INTACT)
    seen = gap(read_ahead(INTACT, ringing(INTACT, frequency_hz=frequency_hz)))
    shape = {"frequency_hz": frequency_hz, "damping": 0.02, "harmonics": 8.0}
    ((said,),) = SENSOR_MOUNT.signatures_of(BASELINE, INTACT, [shape])
    for equation in ("electrical", "mechanical", "cutting"):
        change, wave = seen[equation] - intact[equation], said[equation]
        size = np.sum(wave * change) / np.sum(wave**2)
        assert size == pytest.approx(ORDINARY_KG / MOUNT_KG, rel=0.3)
        assert np.sum((change - size * wave) ** 2) < 0.05 * np.sum(change**2)


@pytest.mark.parametrize(("frequency_hz", "mass_kg"), [(112.0, 12.0), (118.0, 5.0), (150.0, 3.0)])
def test_a_mount_that_rings_is_no_gap(frequency_hz, mass_kg):
    """As seen: it was play of the yoke, with hundreds of nats, on an intact bench and beside teeth."""
    states = [read_ahead(s, ringing(s, frequency_hz=frequency_hz, mass_kg=mass_kg)) for s in strokes()]
    problem = problem_of(states)
    assert judge(problem, effect_columns(problem)).verdict == "no_gap"
