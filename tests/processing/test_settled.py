"""Settled strokes end where the drive is switched off, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.processed import CrankAngle
from sawbench.processing.settled import find_steady_part

pytestmark = pytest.mark.unit

_RATE_HZ, _STEP_S = 25.0, 1e-4


def turning(speed_share):
    """A crank that runs at so much of its usual speed at each step."""
    speed = 2.0 * np.pi * _RATE_HZ * speed_share
    n = len(speed)
    return CrankAngle(
        time_s=np.arange(n) * _STEP_S, angle_rad=np.cumsum(speed) * _STEP_S, speed_rad_s=speed,
        angle_std_rad=np.zeros(n), radius_m=0.01, source="displacement_mm", is_absolute=True,
    )  # fmt: skip


def wandering(seconds, seed, std):
    """Speed that differs from stroke to stroke."""
    rng = np.random.default_rng(seed)
    at_s = np.arange(0.0, seconds, _STEP_S)
    strokes_s = np.arange(0.0, seconds + 0.1, 1.0 / _RATE_HZ)
    return 1.0 + np.interp(at_s, strokes_s, rng.normal(0.0, std, len(strokes_s)))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("lost", [0.04, 0.2])
def test_a_record_that_ends_while_the_blade_runs_down(lost, seed):
    """Half a second after the trigger was let go, in air, where little brakes the blade."""
    speed = wandering(3.5, seed, 0.002)
    off = int(3.0 / _STEP_S)
    speed[off:] *= np.exp(np.log(1.0 - lost) * np.arange(len(speed) - off) * _STEP_S / 0.5)
    part = find_steady_part(turning(speed))
    assert 2.7 < part.end_s <= 3.0


@pytest.mark.parametrize("seed", range(20))
def test_a_trial_that_is_cut_to_its_end_is_used_to_its_end(seed):
    crank = turning(wandering(3.0, seed, 0.01))
    assert find_steady_part(crank).end_s == crank.time_s[-1]


@pytest.mark.parametrize("seed", range(60))
def test_wood_that_gets_harder_towards_the_end_is_no_run_down(seed):
    """A speed that walks from stroke to stroke: some rise or fall over the last strokes of the record."""
    rng = np.random.default_rng(seed)
    strokes_s = np.arange(0.0, 3.1, 1.0 / _RATE_HZ)
    walk = 0.004 * np.cumsum(rng.standard_normal(len(strokes_s)))
    crank = turning(1.0 + np.interp(np.arange(0.0, 3.0, _STEP_S), strokes_s, walk - walk.mean()))
    assert find_steady_part(crank).end_s == crank.time_s[-1]


def test_a_battery_that_sags_is_no_run_down():
    crank = turning(np.linspace(1.0, 0.9, int(4.0 / _STEP_S)))
    assert find_steady_part(crank).end_s == crank.time_s[-1]


def test_a_cut_after_an_idle_run_is_no_run_down():
    speed = wandering(4.0, 3, 0.003)
    speed[int(3.0 / _STEP_S) :] *= 0.85
    crank = turning(speed)
    assert find_steady_part(crank).end_s == crank.time_s[-1]


@pytest.mark.parametrize("seed", range(5))
def test_a_crank_whose_noise_at_rest_looks_like_motion_starts_when_it_turns(seed):
    """Noise of the displacement near a dead centre, at rest: 4 rad/s of speed, a hundredth of a turn."""
    rest, at_s = 0.5, np.arange(0.0, 3.0, _STEP_S)
    speed = np.where(at_s < rest, 0.0, np.minimum((at_s - rest) / 0.1, 1.0))
    crank = turning(speed)
    noise = np.where(at_s < rest, np.random.default_rng(seed).normal(0.0, 4.0, len(at_s)), 0.0)
    part = find_steady_part(
        replace(crank, speed_rad_s=crank.speed_rad_s + noise, angle_rad=crank.angle_rad + 0.01 * noise)
    )
    # Four standard deviations of that noise are reached 10 ms after the start.
    assert rest <= part.first_motion_s <= rest + 0.012


def test_a_record_that_starts_while_the_crank_turns_has_no_rest_before():
    part = find_steady_part(turning(wandering(3.0, 3, 0.002)))
    assert part.first_motion_s == pytest.approx(0.0)


def current_of(crank, off_s, seed, *, noise_a=0.3):
    """A motor current that swings twice a stroke until the trigger is let go."""
    rng = np.random.default_rng(seed)
    driven = np.where(crank.time_s < off_s, 4.0 + 2.0 * np.cos(2.0 * crank.angle_rad), 0.0)
    return crank.time_s, driven + noise_a * rng.standard_normal(len(crank.time_s))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_motor_current_says_when_the_trigger_was_let_go(seed, sign):
    """Two strokes before the record ends: not always enough to see it by the speed alone."""
    speed = wandering(1.3, seed, 0.002)
    off_s = 1.21
    off = int(off_s / _STEP_S)
    speed[off:] *= np.exp(-np.arange(len(speed) - off) * _STEP_S / 0.3)
    crank = turning(speed)
    time_s, current_a = current_of(crank, off_s, seed)
    part = find_steady_part(crank, motor_current=(time_s, sign * current_a))
    assert off_s - 4.0 / _RATE_HZ < part.end_s <= off_s


@pytest.mark.parametrize("seed", range(5))
def test_a_current_that_is_there_to_the_end_ends_nothing(seed):
    crank = turning(wandering(2.0, seed, 0.005))
    for noise_a in (0.1, 3.0):
        current = current_of(crank, 9.0, seed, noise_a=noise_a)
        assert find_steady_part(crank, motor_current=current).end_s == crank.time_s[-1]
    # One that is not recorded to the end says nothing of it.
    time_s, current_a = current_of(crank, 9.0, seed)
    shorter = (time_s[:-6000], current_a[:-6000])
    assert find_steady_part(crank, motor_current=shorter).end_s == crank.time_s[-1]
