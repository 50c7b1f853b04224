"""The ripple within the mean stroke, which a tracker smooths away, comes back with an honest uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.processed import CrankAngle
from sawbench.processing.settled import find_steady_part
from sawbench.processing.stroke_ripple import N_RIPPLE, restore_ripple

pytestmark = pytest.mark.unit

RADIUS_M, ROD_M = 0.01, 0.025
RATE_HZ = 12.0
TWO_PI = 2.0 * np.pi


def restored(angle, displacement_m):
    return restore_ripple(angle, find_steady_part(angle), angle.time_s, displacement_m)


def tracked(ripple_rad=0.01, order=2, noise_m=50e-6, seconds=6.0, rate_hz=5000.0, rod_m=None):
    """A crank with a ripple, and a tracker that saw it turn evenly."""
    time_s = np.arange(int(seconds * rate_hz)) / rate_hz
    even = TWO_PI * RATE_HZ * time_s
    true = even + ripple_rad * np.sin(order * even)
    noise = noise_m * np.random.default_rng(1).standard_normal(len(time_s))
    angle = CrankAngle(
        time_s=time_s,
        angle_rad=even,
        speed_rad_s=np.full(len(time_s), TWO_PI * RATE_HZ),
        angle_std_rad=np.full(len(time_s), 1e-3),
        radius_m=RADIUS_M,
        source="displacement_mm",
        is_absolute=True,
        rod_length_m=rod_m,
    )
    swing = 0.0 if rod_m is None else rod_m - np.sqrt(rod_m**2 - (RADIUS_M * np.sin(true)) ** 2)
    return angle, true, RADIUS_M * (1.0 - np.cos(true)) + swing + noise


@pytest.mark.parametrize("rod_m", [None, ROD_M])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_ripple_that_a_tracker_missed_comes_back(order, rod_m):
    angle, true, displacement_m = tracked(order=order, rod_m=rod_m)
    found = restored(angle, displacement_m)
    late = angle.time_s > 2.0
    before, after = (np.std((a.angle_rad - true)[late]) for a in (angle, found))
    assert before == pytest.approx(0.01 / np.sqrt(2.0), rel=0.02)
    assert after < 0.1 * before
    speed = np.gradient(true, angle.time_s)
    assert np.std((found.speed_rad_s - speed)[late]) < 0.15 * np.std((angle.speed_rad_s - speed)[late])
    assert found.ripple_std_rad.shape == (N_RIPPLE,) and 0.0 < found.ripple_std_rad[order - 1] < 1e-3


def test_the_stated_uncertainty_of_the_ripple_holds():
    errors = []
    for seed in range(40):
        angle, _, displacement_m = tracked(ripple_rad=0.0, noise_m=0.0, seconds=3.0)
        noise = 2e-4 * np.random.default_rng(seed).standard_normal(len(displacement_m))
        found = restored(angle, displacement_m + noise)
        late = angle.time_s > 2.0
        wave = (found.angle_rad - angle.angle_rad)[late]
        turns = angle.angle_rad[late]
        errors.append([2.0 * np.mean(wave * np.cos(k * turns)) / found.ripple_std_rad[k - 1] for k in (1, 2, 3)])
    assert 0.7 < np.std(errors) < 1.3


@pytest.mark.parametrize(("seconds", "rate_hz"), [(3.2, 800.0), (3.0, 400.0), (1.6, 2000.0)])
def test_few_samples_bring_the_ripple_back_too_and_say_how_well(seconds, rate_hz):
    """Some hundred settled samples: the ripple that is left out would look like a play of the yoke."""
    angle, true, displacement_m = tracked(seconds=seconds, rate_hz=rate_hz, noise_m=20e-6)
    found = restored(angle, displacement_m)
    late = angle.time_s > 0.75 * seconds
    off = np.std((found.angle_rad - true)[late])
    assert off < 0.1 * np.std((angle.angle_rad - true)[late])
    assert off < 4.0 * np.sqrt(np.sum(found.ripple_std_rad**2))


def test_a_short_trial_keeps_its_angle():
    angle, _, displacement_m = tracked(seconds=1.0)
    found = restored(angle, displacement_m)
    assert np.array_equal(found.angle_rad, angle.angle_rad)
    assert not found.ripple_std_rad.any()


def test_a_blade_that_stands_says_nothing_of_the_ripple():
    angle, _, displacement_m = tracked(ripple_rad=0.0)
    still = angle.time_s > 3.0
    stopped = float(angle.angle_rad[~still][-1])
    halted = replace(
        angle,
        angle_rad=np.where(still, stopped, angle.angle_rad),
        speed_rad_s=np.where(still, 0.0, angle.speed_rad_s),
    )
    displacement_m = np.where(still, displacement_m[~still][-1] + 3e-4, displacement_m)
    found = restored(halted, displacement_m)
    assert np.abs((found.angle_rad - halted.angle_rad)[~still]).max() < 5e-4
