"""A displacement sensor whose mount rings with the force that moves the plunger: no gap, and no play of the yoke."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.diagnosis.inference.beyond.sensor_mount import SENSOR_MOUNT
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.posterior import judge

from tests.rigs.jigsaw_in_time import BASELINE, MASS, RADIUS, Machine, gap
from tests.rigs.read_stroke import ANGLE, GRID, read_ahead, turning
from tests.rigs.scattered_strokes import problem_of, strokes

pytestmark = pytest.mark.pipeline

INTACT = Machine().run()
# Of the mount, and of what the law is stated for.
MOUNT_KG, ORDINARY_KG = 3.0, 2.5


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
