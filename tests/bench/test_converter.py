"""What a range cuts off, and what only looks like it: coarse steps at turning points and at rest."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.converter import clipped_levels, step_of

pytestmark = pytest.mark.unit

RATE_HZ = 10_000.0
TIME_S = np.arange(0.0, 5.0, 1.0 / RATE_HZ)


def stroke(noise=0.0):
    """Displacement in mm, from a rest of half a second at its end."""
    angle = 2 * np.pi * 14.0 * np.maximum(TIME_S - 0.5, 0.0)
    return 10.0 * (1.0 - np.cos(angle)) + noise * np.random.default_rng(1).standard_normal(len(TIME_S))


def stepped(values, step):
    return np.round(values / step) * step


@pytest.mark.parametrize("step", [0.005, 0.02, 0.078, 0.4])
@pytest.mark.parametrize("noise", [0.0, 0.006, 0.03])
@pytest.mark.parametrize("phase", [0.0, 0.21, 0.5])
def test_a_coarse_displacement_is_not_cut_off_at_its_dead_centres(step, noise, phase):
    assert clipped_levels(stepped(stroke(noise) + phase * step, step)) == {}


@pytest.mark.parametrize("step", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("share", [0.5, 0.8])
def test_a_range_that_is_exceeded_every_stroke_is_found(step, share):
    limit = 20.0 * share
    values = np.minimum(stroke(0.02), limit)
    values = stepped(values, step) if step else values
    found = clipped_levels(values)
    assert list(found) == [pytest.approx(limit)]
    assert found[max(found)] == pytest.approx(np.sum(stroke(0.02) > limit), rel=0.05)


def test_a_battery_at_rest_that_flickers_between_two_codes_is_not_cut_off():
    """At rest, the highest codes that there are; then it works, 20 codes lower."""
    rng = np.random.default_rng(3)
    volts = np.where(TIME_S < 1.0, 18.046, 17.1 + 0.2 * np.sin(2 * np.pi * 28.0 * TIME_S))
    read = stepped(volts + 0.02 * rng.standard_normal(len(TIME_S)), 0.05)
    assert clipped_levels(np.minimum(read, 18.05)) == {}


def test_the_step_is_found_in_a_channel_that_hardly_moves():
    read = np.full(20_000, 18.0672)
    read[300:900] = 17.9688
    assert step_of(read) == pytest.approx(0.0984)
    assert step_of(stepped(stroke(), 0.078)) == pytest.approx(0.078)
    assert step_of(stroke(0.02)) == 0.0
    assert step_of(np.full(100, 3.0)) == 0.0


@pytest.mark.parametrize("step", [0.001, 0.003, 0.01, 0.03, 0.1])
@pytest.mark.parametrize("seed", range(8))
def test_equal_samples_that_come_by_chance_are_no_coarse_step(step, seed):
    """A force of 0.66 N noise in steps of a hundredth of it: neighbours are equal now and then, anywhere in 150 N."""
    rng = np.random.default_rng(seed)
    force = 150.0 * np.maximum(np.sin(2 * np.pi * 21.0 * TIME_S[:20_000]), 0.0) + 0.66 * rng.standard_normal(20_000)
    assert step_of(stepped(force, step)) < 0.66


@pytest.mark.parametrize("seed", range(20))
def test_a_standstill_and_one_pair_of_equal_samples_are_no_step(seed):
    """A current on a slow bus: at rest before the start, then 800 values in steps of a twentieth of its noise."""
    rng = np.random.default_rng(seed)
    current = np.concatenate([np.zeros(20), 14.0 + 5.0 * rng.standard_normal(800)])
    assert step_of(stepped(current, 0.02)) < 0.1


def test_three_levels_are_a_converter():
    assert step_of(np.repeat([17.9, 18.0, 17.9, 17.8, 17.9, 18.0], 50)) == pytest.approx(0.1)
