"""A slider-crank saw is processed with its own kinematics, against an integration of it written here.

The plant is stated by the position of the pin alone: y(phi) = r + l - (r cos phi + sqrt(l^2 - r^2 sin^2 phi)). Lever
and slope come of differences of it, so that no formula of the product is repeated.
"""

import functools

import numpy as np
import pytest
from sawbench.bench.config import BenchConfig, load_config
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.bench.units import CHANNEL_BY_NAME
from sawbench.inputs import shipped_config
from sawbench.modeling.force_fit import fit_force
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.processing.measured_cycles import measured_cycles
from sawbench.processing.process import process_recording
from scipy.integrate import solve_ivp

pytestmark = pytest.mark.unit

R_M, L_M = 0.01, 0.025
RATE_HZ, SECONDS = 5000.0, 3.0
K_FC, DUTY, GEAR = 240.29, 0.4375, 56 / 6
STEP = 1e-5


def position(angle):
    return R_M + L_M - (R_M * np.cos(angle) + np.sqrt(L_M**2 - (R_M * np.sin(angle)) ** 2))


def lever(angle):
    return (position(angle + STEP) - position(angle - STEP)) / (2.0 * STEP)


@functools.cache
def run():
    """Time, crank angle, crank speed, motor current and blade velocity of a saw that cuts while y falls."""
    j_motor, j_crank, mass, resistance, inductance, ke, km, b = (
        2.4e-5, 2.38e-5, 0.239, 0.176, 3.21e-3, 7.383e-3, 5.632e-3, 3.4274e-6,
    )  # fmt: skip

    def rates(_, y):
        current, speed, angle = y
        g = lever(angle)
        slope = (position(angle + STEP) - 2.0 * position(angle) + position(angle - STEP)) / STEP**2
        inertia = j_motor * GEAR**2 + j_crank + mass * g * g
        cut = K_FC * max(-g * speed, 0.0)
        torque = GEAR * (km * current - b * GEAR * speed) + cut * g - mass * g * slope * speed**2
        return [(18.0 * DUTY - resistance * current - ke * GEAR * speed) / inductance, torque / inertia, speed]

    time_s = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    found = solve_ivp(rates, (0, SECONDS), [0, 0, 0.7], t_eval=time_s, rtol=1e-7, atol=1e-8, max_step=4e-3).y
    current, speed, angle = found
    return time_s, angle, speed, current, lever(angle) * speed


def recording():
    time_s, angle, _, current, velocity = run()
    rng = np.random.default_rng(2)
    values = {
        "displacement_mm": 1e3 * position(angle) + 5e-3 * rng.standard_normal(len(time_s)),
        "force_n": K_FC * np.maximum(-velocity, 0.0) + 0.5 * rng.standard_normal(len(time_s)),
        "motor_current_a": current + 0.02 * rng.standard_normal(len(time_s)),
        "battery_voltage_v": np.full(len(time_s), 18.0) + 2e-3 * rng.standard_normal(len(time_s)),
        "battery_current_a": DUTY * current + 0.02 * rng.standard_normal(len(time_s)),
    }
    signals = {
        name: Signal(channel=name, unit=CHANNEL_BY_NAME[name].unit, time_s=time_s, values=of)
        for name, of in values.items()
    }
    return Recording(trial=Trial(trial_id="t", duty=DUTY, material="oak", feed_mm_s=3.0), signals=signals)


def config(**mechanism):
    shipped = load_config(shipped_config()).config
    plant = shipped.plant.model_copy(update=mechanism)
    return shipped.model_copy(update={"plant": plant})


SLIDER = config(mechanism="slider_crank", rod_length_m=L_M)


@functools.cache
def processed(with_rod=True):
    return process_recording(recording(), SLIDER if with_rod else config())


def settled(trial):
    """Crank angle and speed of a trial against the truth, in its settled part, at the tracked times."""
    time_s, angle, speed, _, velocity = run()
    late = (trial.angle.time_s > trial.steady.settled_s) & (trial.angle.time_s < SECONDS - 0.1)
    at_s = trial.angle.time_s[late]
    truth = (np.interp(at_s, time_s, of) for of in (angle, speed, velocity))
    return trial.angle.angle_rad[late], trial.angle.speed_rad_s[late], *truth


def test_angle_speed_and_blade_velocity_are_those_of_the_integration():
    angle, speed, true_angle, true_speed, true_velocity = settled(processed())
    assert np.std(angle - true_angle) < 1e-3 and abs(np.mean(angle - true_angle)) < 1e-3
    assert np.std(speed - true_speed) < 0.005 * true_speed.mean()
    blade = Mechanism(radius_m=R_M, rod_length_m=L_M).lever(angle) * speed
    assert np.abs(blade - true_velocity).max() < 0.01 * np.abs(true_velocity).max()


def test_taken_as_a_yoke_it_would_be_far_off():
    """The yoke's lever at the true angle, or the angle and the speed that a yoke would need for this displacement."""
    _, _, true_angle, true_speed, true_velocity = settled(processed())
    off = np.abs(Mechanism(radius_m=R_M).lever(true_angle) * true_speed - true_velocity).max()
    assert off > 0.18 * np.abs(true_velocity).max()
    angle, speed, true_angle, true_speed, _ = settled(processed(with_rod=False))
    assert np.std(angle - true_angle) > 0.1
    assert np.std(speed - true_speed) > 0.1 * true_speed.mean()


def test_the_fold_and_the_zeroed_half_are_at_the_true_angle():
    trial = processed()
    _, angle, speed, _, _ = run()
    order = np.argsort(angle % (2.0 * np.pi))
    late = order[(angle[order] > angle[-1] - 60.0)]
    at = trial.folded["force_n"].angle_rad
    mean_speed = np.interp(at, angle[late] % (2.0 * np.pi), speed[late])
    expected = K_FC * np.maximum(-lever(at) * mean_speed, 0.0)
    assert np.abs(trial.folded["force_n"].mean - expected).max() < 0.02 * expected.max()
    assert trial.removed.share_of_impulse < 5e-3 and not trial.removed.looks_swapped
    assert trial.peak_force_n == pytest.approx(expected.max(), rel=0.01)
    # The blade is fastest where the rod stands square to the crank, nearer to angle 0 than a yoke's quarter turn.
    assert at[np.argmax(trial.cutting_force.mean)] > 1.5 * np.pi + 0.2


def test_k_fc_comes_back_from_force_and_blade_speed():
    found = fit_force(measured_cycles(processed()), plant=SLIDER.plant, cutting_half="pi_to_2pi")
    assert found.k_fc_n_s_per_m == pytest.approx(K_FC, rel=0.005)
    assert np.std(found.per_stroke_n_s_per_m) < 0.01 * K_FC


def test_without_a_plant_the_crank_is_taken_as_a_yoke_and_that_is_said():
    trial = process_recording(recording(), BenchConfig())
    assert trial.period.confidence == "high" and trial.angle.rod_length_m is None
    assert any("Scotch yoke" in warning for warning in trial.warnings)
    assert not any("Scotch yoke" in warning for warning in processed().warnings)
