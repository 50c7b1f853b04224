"""Yoke play against a simulated contact: walls around the pin, a sensor on the plunger, the tracker."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bench.config import PlantConfig
from bench.recording import Recording, Signal, Trial
from diagnosis.effects.plunger_play import plunger_motion, tracked_angle
from diagnosis.effects.yoke_backlash import EFFECT
from diagnosis.equations import Baseline, residuals
from diagnosis.features import harmonics
from diagnosis.reduction import running_state
from diagnosis.state import TrialSetting
from processing.crank_angle import track_crank_angle

R, L, KE, KM, B = 0.176, 0.00321, 0.007383, 0.005632, 3.4274e-06
JM, JC, MASS, RADIUS, GEAR = 2.4e-05, 2.38e-05, 0.239, 0.01, 9.333333333333334
DUTY, VOLTAGE_V = 0.4375, 18.0
BASELINE = Baseline(
    plant=PlantConfig.model_validate(
        {
            "resistance_ohm": R,
            "inductance_h": L,
            "back_emf_constant_v_s_per_rad": KE,
            "torque_constant_n_m_per_a": KM,
            "rotor_inertia_kg_m2": JM,
            "yoke_inertia_kg_m2": JC,
            "reciprocating_mass_kg": MASS,
            "crank_radius_m": RADIUS,
            "motor_damping_n_m_s_per_rad": B,
            "gear_ratio": GEAR,
        }
    ),
    battery=None,
    cutting_sign=-1,
)


def simulate(gap_m: float, k_n_s_per_m: float, friction_n: float):
    """Motor, crank and a plunger of its own between two walls; returns a dense solution over 1.6 s."""
    stiffness = 3e6
    damping = np.sqrt(stiffness * MASS)

    def rhs(t, y):
        i, w, angle, x, v = y
        ahead = RADIUS * (1 - np.cos(angle)) - x
        closing = RADIUS * w * np.sin(angle) - v
        push = 0.0
        if ahead > gap_m / 2:
            push = max(stiffness * (ahead - gap_m / 2) + damping * closing, 0.0)
        elif ahead < -gap_m / 2:
            push = min(stiffness * (ahead + gap_m / 2) + damping * closing, 0.0)
        force = k_n_s_per_m * max(-v, 0.0)
        di = (DUTY * VOLTAGE_V - R * i - KE * GEAR * w) / L
        dw = (GEAR * (KM * i - B * GEAR * w) - push * RADIUS * np.sin(angle)) / (JM * GEAR**2 + JC)
        return [di, dw, w, v, (push + force - friction_n * np.tanh(v / 0.01)) / MASS]

    start = [5.0, 85.0, 0.0, 0.0, 0.0]
    return solve_ivp(rhs, (0, 1.6), start, rtol=1e-6, atol=1e-9, max_step=3e-4, dense_output=True).sol


def measure(solution, k_n_s_per_m: float):
    """State of the diagnosis from 5 kHz samples with 3 um of noise."""
    t = np.arange(0.6, 1.6, 2e-4)
    i, _, _, x, v = solution(t)
    noise = 3e-6 * np.random.default_rng(7).standard_normal(len(t))
    channels = {
        "force_n": ("N", k_n_s_per_m * np.maximum(-v, 0.0)),
        "motor_current_a": ("A", i),
        "battery_voltage_v": ("V", np.full(len(t), VOLTAGE_V)),
    }
    is_idle = k_n_s_per_m == 0.0
    material = "none" if is_idle else "oak"
    trial = Trial(trial_id="t", material=material, duty=DUTY, started_at=datetime(2026, 1, 1, tzinfo=UTC))
    recording = Recording(
        trial=trial,
        signals={n: Signal(channel=n, unit=u, time_s=t, values=w) for n, (u, w) in channels.items()},
    )
    setting = TrialSetting(
        label="t", index=0, duty=DUTY, is_idle=is_idle, stock=material, feed_m_s=float("nan"),
        thickness_m=float("nan"), operating_point="p", session_s=0.0,
    )  # fmt: skip
    track = track_crank_angle(t, x + noise, nominal_radius_m=RADIUS)
    assert track is not None
    state = running_state(recording, track, setting, t[0] + 0.05, t[-1] - 0.05)
    assert state is not None
    return replace(state, slow={"k_guess_n_s_per_m": np.full((len(state.angle_rad), 1), k_n_s_per_m)})


# Without friction the inertia throws the plunger across; 25 N of guide friction hold it at the dead centres.
@pytest.mark.parametrize(
    ("k", "friction_n", "steered_by_n"), ((0.0, 0.0, 0.0), (240.0, 0.0, 0.0), (240.0, 25.0, 1e6))
)
def test_the_residuals_of_a_machine_with_play_are_those_of_its_signature(k, friction_n, steered_by_n):
    gap_m = 3e-4
    state = measure(simulate(gap_m, k, friction_n), k)
    seen = residuals(BASELINE, state)
    seen["mechanical"] = seen["mechanical"] - friction_n * RADIUS / GEAR * np.abs(np.sin(state.angle_rad))
    (claimed,) = EFFECT.signatures(BASELINE, state, {"gap_m": gap_m, "friction_n": steered_by_n})
    for equation, n in (("electrical", 12), ("mechanical", 8)):
        a = harmonics(seen[equation], n).mean(axis=0)
        b = harmonics(claimed[equation], n).mean(axis=0)
        assert a @ b > 0.97 * np.sqrt((a @ a) * (b @ b)), equation
        assert 0.8 < (a @ b) / (b @ b) < 1.2, equation
    if k:
        a = harmonics(seen["cutting"] - BASELINE.expected_force(state), 32).mean(axis=0)
        b = harmonics(claimed["cutting"], 32).mean(axis=0)
        assert a @ b > 0.85 * np.sqrt((a @ a) * (b @ b))


def test_without_play_the_pin_carries_the_plunger_and_the_angle_is_right():
    speed = np.full(128, 90.0)
    motion = plunger_motion(
        speed,
        gap_m=0.0,
        radius_m=RADIUS,
        mass_kg=MASS,
        damping_n_s_per_m=0.0,
        cutting_sign=-1,
        friction_n=0.0,
    )
    angle = (np.arange(128) + 0.5) * 2 * np.pi / 128
    assert np.allclose(motion.pin_force_n, MASS * RADIUS * 90.0**2 * np.cos(angle), atol=0.3)
    assert np.max(np.abs(tracked_angle(motion.position_m))) < 2e-3


def test_in_air_the_plunger_crosses_after_mid_stroke():
    """Between the walls it flies at constant velocity: r (f - sin f) = gap, f the angle after mid stroke."""
    gap_m = 2e-4
    motion = plunger_motion(
        np.full(256, 90.0),
        gap_m=gap_m,
        radius_m=RADIUS,
        mass_kg=MASS,
        damping_n_s_per_m=0.0,
        cutting_sign=-1,
        friction_n=0.0,
    )
    angle = (np.arange(256) + 0.5) * 2 * np.pi / 256
    lead_m = motion.position_m - RADIUS * (1 - np.cos(angle))
    landed = angle[(angle > np.pi / 2) & (lead_m > 0.49 * gap_m)][0] - np.pi / 2
    flight = np.linspace(0.0, 1.0, 10001)
    expected = flight[np.argmax(RADIUS * (flight - np.sin(flight)) > gap_m)]
    assert landed == pytest.approx(expected, abs=0.05)
    flying = (angle > np.pi / 2 + 0.05) & (angle < np.pi / 2 + expected - 0.05)
    assert np.allclose(motion.pin_force_n[flying], 0.0)
