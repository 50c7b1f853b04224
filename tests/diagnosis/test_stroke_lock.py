"""What the measured displacement tells of the stroke: in coarse steps, and whether the current in air follows it."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Signal, Trial
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.reduction import lock_to_angle, running_state
from sawbench.modeling.state import TWO_PI, angle_derivative

from tests.rigs.drawn_states import setting_of
from tests.rigs.processed import processed_trial

pytestmark = pytest.mark.unit

RADIUS_M, SECONDS = 0.01, 6.0


def state_of(stroke_hz, *, rate_hz=10_000.0, idle=False, **channels):
    """Evenly turning; the angle is exact, the channels are functions of time and angle."""
    time_s = np.arange(0.0, SECONDS, 1.0 / rate_hz)
    turned = TWO_PI * stroke_hz * time_s
    angle = CrankAngle(
        time_s=time_s, angle_rad=turned, speed_rad_s=np.full(len(time_s), TWO_PI * stroke_hz),
        angle_std_rad=np.zeros(len(time_s)), radius_m=RADIUS_M, source="test", is_absolute=True,
    )  # fmt: skip
    units = {"motor_current_a": "A", "displacement_mm": "mm"}
    signals = {
        n: Signal(channel=n, unit=units[n], time_s=time_s, values=of(time_s, turned)) for n, of in channels.items()
    }
    trial = processed_trial(Trial(trial_id="t", duty=0.5, material="oak"), signals, angle, 0.1, SECONDS - 0.1)
    state = running_state(trial, setting_of(is_idle=idle))
    assert state is not None
    return state


def displacement(step_mm, noise_mm):
    rng = np.random.default_rng(1)

    def of(time_s, turned):
        exact = 10.0 * (1.0 - np.cos(turned)) + 0.31 * step_mm + noise_mm * rng.standard_normal(len(time_s))
        return np.round(exact / step_mm) * step_mm

    return of


@pytest.mark.parametrize("step_mm", [0.05, 0.1])
@pytest.mark.parametrize("rate_hz", [3000.0, 10_000.0])
def test_the_speed_that_coarse_steps_give_is_as_uncertain_as_stated(step_mm, rate_hz):
    """Against the error that is there: the strokes are exact, and so is the angle."""
    state = state_of(14.3, rate_hz=rate_hz, displacement_mm=displacement(step_mm, 0.0))
    speed_rad_s = TWO_PI * 14.3
    assert state.blade_excess_m_s is not None
    made = state.blade_excess_m_s.mean(axis=0)
    stated = speed_rad_s * angle_derivative(np.diag(state.stroke_std_m))
    assert 0.5 < np.sqrt(np.mean(np.sum(stated**2, axis=0))) / np.sqrt(np.mean(made**2)) < 3.0
    # It lies where the blade is slow.
    slow = np.abs(np.sin(state.angle_rad[0])) < 0.25
    assert np.mean(made[slow] ** 2) > 10.0 * np.mean(made[~slow] ** 2)
    assert state.stroke_std_m[slow].min() > state.stroke_std_m[~slow].max()


def test_steps_that_the_noise_hides_add_nothing():
    state = state_of(14.3, displacement_mm=displacement(0.005, 0.02))
    assert state.stroke_std_m.size == 0


def current_in_air(*, hum_a=0.0, ripple_a=0.05, noise_a=0.02, slip=0.0):
    rng = np.random.default_rng(2)

    def of(time_s, turned):
        wave = 2.0 + ripple_a * np.cos(2.0 * (1.0 + slip) * turned + 0.7) + hum_a * np.sin(TWO_PI * 50.0 * time_s)
        return wave + noise_a * rng.standard_normal(len(time_s))

    return of


def test_a_current_that_follows_the_strokes_is_locked_and_one_of_another_trial_is_not():
    name, lock, _ = lock_to_angle(state_of(20.0, idle=True, motor_current_a=current_in_air()))
    assert name == "current in air"
    assert abs(lock) > 0.98
    assert np.angle(lock) == pytest.approx(0.7, abs=0.1)
    _, other, _ = lock_to_angle(state_of(20.0, idle=True, motor_current_a=current_in_air(slip=0.05)))
    assert abs(other) < 0.5


@pytest.mark.parametrize("stroke_hz", [23.1, 24.6, 25.0, 25.3, 27.0])
def test_mains_hum_at_the_judged_harmonic_says_nothing(stroke_hz):
    assert lock_to_angle(state_of(stroke_hz, idle=True, motor_current_a=current_in_air(hum_a=0.5))) is None


@pytest.mark.parametrize("stroke_hz", [12.4, 16.7, 19.3])
def test_mains_hum_beside_it_makes_no_other_trial(stroke_hz):
    """Ten times as strong as what is judged: its side lobes may hide that, but accuse nothing."""
    found = lock_to_angle(state_of(stroke_hz, idle=True, motor_current_a=current_in_air(hum_a=0.5)))
    is_kept = found is None or abs(found[1]) > SETTINGS.screening.locked
    assert is_kept and (found is None or np.angle(found[1]) == pytest.approx(0.7, abs=0.3))


def test_noise_says_nothing():
    assert lock_to_angle(state_of(20.0, idle=True, motor_current_a=current_in_air(ripple_a=0.0))) is None
