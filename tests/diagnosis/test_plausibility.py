"""Force and motor current are held against each other as far as the idle runs of a campaign say what idling takes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.config import load_config
from sawbench.bench.recording import Trial
from sawbench.diagnosis.plausibility import check, idle_current_between, settled_current_a
from sawbench.diagnosis.trial_reading import Reading, read_trial
from sawbench.modeling.residuals import Baseline

pytestmark = pytest.mark.unit

PLANT = load_config(Path(__file__).parents[2] / "bench_config.toml").config.plant
BASELINE = Baseline(plant=PLANT, battery=None, cutting_sign=-1)
TOP_DUTY, LOW_DUTY, HZ_AT_FULL_DUTY = 0.66, 0.42, 36.0


def watt_per_ampere(duty: float) -> float:
    """Shaft power of an ampere of motor current at the stroke rate of a duty."""
    speed = 2.0 * math.pi * HZ_AT_FULL_DUTY * duty * BASELINE.gear
    return PLANT.torque_constant_n_m_per_a.nominal * speed


def in_soft_wood(duty: float, idle_a: float, force_is: float = 1.0) -> Reading:
    """A trial whose current is that of idling and of 5 W at the blade; the force shows `force_is` times as much."""
    cut_w = 5.0
    return Reading(
        travel_m=2.0 * BASELINE.radius_m, n_strokes=100, rate_hz=HZ_AT_FULL_DUTY * duty,
        motor_current_a=idle_a + cut_w / watt_per_ampere(duty), top_current_a=None,
        battery_current_a=None, battery_voltage_v=None, voltage_ripple=None,
        blade_power_w=force_is * cut_w, falling_force_n=100.0, rising_force_n=0.0,
    )  # fmt: skip


def kinds(reading: Reading, idle_a: tuple[float, float] | None) -> set[str]:
    trial = Trial(trial_id="soft", material="nylon", duty=LOW_DUTY)
    return {fault.kind for fault in check(BASELINE, trial, reading, idle_a).faults}


@pytest.mark.parametrize("power", [0.0, 1.0, 2.0])
def test_soft_wood_at_low_speed_is_believed_where_only_a_faster_idle_run_was_recorded(power):
    idle_at_top_a = 1.4
    idle_a = idle_at_top_a * (LOW_DUTY / TOP_DUTY) ** power
    between = idle_current_between({TOP_DUTY: (idle_at_top_a, idle_at_top_a)}, LOW_DUTY)
    assert between[0] - 1e-12 <= idle_a <= between[1] + 1e-12
    assert not kinds(in_soft_wood(LOW_DUTY, idle_a), between)


@pytest.mark.parametrize("factor", [0.1, 3.0])
def test_a_force_of_the_wrong_size_is_found_with_an_idle_run_at_its_own_duty(factor):
    between = idle_current_between({LOW_DUTY: (0.9, 0.9), TOP_DUTY: (1.4, 1.4)}, LOW_DUTY)
    assert between == (0.9, 0.9)
    assert kinds(in_soft_wood(LOW_DUTY, 0.9, force_is=factor), between) == {"blade power"}
    assert not kinds(in_soft_wood(LOW_DUTY, 0.9), between)


def test_a_force_that_no_idle_current_explains_is_found_without_an_idle_run_at_its_duty():
    between = idle_current_between({TOP_DUTY: (1.4, 1.4)}, LOW_DUTY)
    assert kinds(in_soft_wood(LOW_DUTY, 0.9, force_is=10.0), between) == {"blade power"}


@pytest.mark.parametrize("idle_a", [0.0, 0.9, 3.0])
def test_without_an_idle_run_nobody_knows_what_idling_takes(idle_a):
    """As seen: 8 W at the blade of a tool of 57 W, whose every idle watt was taken for one of the cut."""
    assert idle_current_between({}, LOW_DUTY) is None
    assert not kinds(in_soft_wood(LOW_DUTY, idle_a), None)


@pytest.mark.parametrize("factor", [1e-3, 50.0])
def test_without_an_idle_run_a_force_of_quite_another_size_is_still_found(factor):
    assert kinds(in_soft_wood(LOW_DUTY, 0.9, force_is=factor), None) == {"blade power"}


def test_cold_grease_does_not_make_the_force_of_a_warm_machine_too_large():
    """As seen: the first idle run of the day drew half as much again as the last one, and no cut had so little left."""
    cold = idle_current_between({LOW_DUTY: (1.4, 1.4)}, LOW_DUTY)
    both = idle_current_between({LOW_DUTY: (0.9, 1.4)}, LOW_DUTY)
    warm = in_soft_wood(LOW_DUTY, 0.9)
    at_top_later = idle_current_between({LOW_DUTY: (1.4, 1.4), TOP_DUTY: (0.9, 1.6)}, LOW_DUTY)
    assert kinds(warm, cold) == {"blade power"}
    assert not kinds(warm, both)
    assert at_top_later == (0.9, 1.4)


@pytest.mark.parametrize("time_constant_s", [0.3, 1.0])
def test_what_brings_a_machine_up_to_speed_is_no_friction(time_constant_s):
    """As seen: idle runs of 4 s on a saw that takes 2 s to settle, and every cut took more than the motor had left."""
    time_s = np.arange(0.0, 4.0, 1e-3)
    rate_hz = 30.0 * -np.expm1(-time_s / time_constant_s)
    turned = np.cumsum(2.0 * np.pi * rate_hz) * 1e-3
    inertia = PLANT.rotor_inertia_kg_m2.nominal * BASELINE.gear + PLANT.yoke_inertia_kg_m2.nominal / BASELINE.gear
    swung_n_m = inertia * 2.0 * np.pi * np.gradient(rate_hz, time_s)
    friction_a = 1.5
    current_a = friction_a + swung_n_m / PLANT.torque_constant_n_m_per_a.nominal
    tracks = {"displacement_mm": (time_s, 10.0 * (1.0 - np.cos(turned))), "motor_current_a": (time_s, current_a)}
    reading = read_trial(tracks)
    assert settled_current_a(BASELINE, reading) == pytest.approx(friction_a, rel=0.1)
    assert reading.motor_current_a > 1.5 * friction_a or time_constant_s < 1.0


def cut_trial(*, off_s: float, seconds: float = 1.8) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Tracks of a saw that cuts evenly at 20 strokes a second until the trigger is let go; then it slows down."""
    time_s = np.arange(0.0, seconds, 5e-4)
    rate_hz = 20.0 * np.exp(-np.maximum(time_s - off_s, 0.0) / 0.3)
    turned = np.cumsum(2.0 * np.pi * rate_hz) * 5e-4
    speed = 10.0 * np.sin(turned) * rate_hz / 20.0
    return {
        "displacement_mm": (time_s, 10.0 * (1.0 - np.cos(turned))),
        "force_n": (time_s, 20.0 * np.maximum(-speed, 0.0)),
        "motor_current_a": (time_s, np.where(time_s < off_s, 10.0, 0.0)),
    }


def test_strokes_after_the_trigger_was_let_go_say_nothing_of_the_power():
    whole, let_go = (read_trial(cut_trial(off_s=off_s)) for off_s in (9.0, 1.4))
    assert let_go.motor_current_a == pytest.approx(10.0)
    assert let_go.blade_power_w == pytest.approx(whole.blade_power_w, rel=0.02)
    assert let_go.n_strokes < whole.n_strokes
    # Hardly a stroke before it: there is nothing to compare.
    short = read_trial(cut_trial(off_s=0.95, seconds=1.15))
    assert short.blade_power_w is None and short.n_strokes >= 3


def test_a_brush_drop_is_believed_at_a_low_duty_of_a_low_voltage():
    """1.5 V of the 2.7 V that a quarter of 10.8 V is."""
    duty, drive_v, dropped_v, current_a = 0.25, 0.25 * 10.8, 1.5, 1.0
    asked_v = drive_v - dropped_v - PLANT.resistance_ohm.nominal * current_a
    rate_hz = asked_v / (PLANT.back_emf_constant_v_s_per_rad.nominal * BASELINE.gear) / (2.0 * math.pi)
    reading = Reading(
        travel_m=2.0 * BASELINE.radius_m, n_strokes=100, rate_hz=rate_hz, motor_current_a=current_a, top_current_a=None,
        battery_current_a=None, battery_voltage_v=10.8, voltage_ripple=None, blade_power_w=None, falling_force_n=None,
        rising_force_n=None,
    )  # fmt: skip
    found = check(BASELINE, Trial(trial_id="slow", material="oak", duty=duty), reading).faults
    assert "motor voltage" not in {fault.kind for fault in found}
