"""States of a jigsaw drawn by hand: strokes with ripple and a spin-up, whose waves need not solve the equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from sawbench.bench.config import BatteryConfig, PlantConfig
from sawbench.modeling.effects.catalogue import MEMORIES
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import State, TrialSetting

RADIUS_M, N_UNITS, N_POINTS, N_TIMES = 0.01, 3, 128, 400


def make_baseline(cutting_sign: int = -1, mechanism: str = "scotch_yoke") -> Baseline:
    plant = PlantConfig.model_validate(
        {
            "resistance_ohm": 0.176,
            "inductance_h": 0.00321,
            "back_emf_constant_v_s_per_rad": 0.007383,
            "torque_constant_n_m_per_a": 0.005632,
            "rotor_inertia_kg_m2": 2.4e-05,
            "yoke_inertia_kg_m2": 2.38e-05,
            "reciprocating_mass_kg": 0.239,
            "crank_radius_m": RADIUS_M,
            "motor_damping_n_m_s_per_rad": 3.4274e-06,
            "gear_ratio": 9.333333333333334,
            "mechanism": mechanism,
            "rod_length_m": 0.025,
        }
    )
    battery = BatteryConfig(
        nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.99, internal_resistance_ohm=0.02, cutoff_soc=0.2
    )
    return Baseline(plant=plant, battery=battery, cutting_sign=cutting_sign)


BASELINE = make_baseline()

HELD = {"motor_current_squared_a2": 100.0, "crank_speed_squared_rad2_s2": 8000.0, "battery_current_a": 4.0}


def history(n_units: int, k_n_s_per_m: float) -> dict:
    slow = {memory: np.full((n_units, 1), HELD[memory.drive]) for memory in MEMORIES}
    return {"slow": slow, "k_guess_n_s_per_m": k_n_s_per_m, "peak_force_n": 200.0, "top_current_a": 35.0}


def setting_of(is_idle: bool, **changes) -> TrialSetting:
    given = {
        "label": "t",
        "index": 0,
        "duty": 0.4375,
        "is_idle": is_idle,
        "stock": "oak",
        "feed_m_s": 0.004,
        "thickness_m": 0.02,
        "operating_point": "p",
        "session_s": 300.0,
    }
    return TrialSetting(**{**given, **changes})


def running(is_idle: bool = False, **changes) -> State:
    """Strokes with the ripple of a loaded jigsaw; waves need not solve the equations."""
    angle = np.broadcast_to((np.arange(N_POINTS) + 0.5) * 2 * np.pi / N_POINTS, (N_UNITS, N_POINTS))
    speed = 88.0 + 6.0 * np.cos(2 * angle) + np.arange(N_UNITS)[:, None]
    acceleration = speed * -12.0 * np.sin(2 * angle)
    current = 10.0 + 1.5 * np.sin(angle) + np.cos(2 * angle)
    current_rate = speed * (1.5 * np.cos(angle) - 2.0 * np.sin(2 * angle))
    force = 0.0 * angle if is_idle else 210.0 * np.maximum(-np.sin(angle), 0.0)
    force_rate = -speed * np.where(force > 0.0, 210.0 * np.cos(angle), 0.0)
    voltage = 17.8 - 0.01 * current
    state = State(
        kind="running", setting=setting_of(is_idle), angle_rad=angle, speed_rad_s=speed,
        acceleration_rad_s2=acceleration, current_a=current, current_rate_a_s=current_rate, force_n=force,
        force_rate_n_s=force_rate, battery_voltage_v=voltage, battery_current_a=0.44 * current,
        motor_voltage_v=0.4375 * voltage, time_s=np.array([[1.0], [2.0], [3.0]]),
        cut_distance_m=np.array([[1.0], [2.0], [3.0]]), charge_used_as=np.full((N_UNITS, 1), 50.0),
        n_strokes=np.full(N_UNITS, 2.0), **history(N_UNITS, 0.0 if is_idle else 240.0),
    )  # fmt: skip
    return replace(state, **changes)


def start_up(is_idle: bool = False, **changes) -> State:
    """Spin-up on the 1 ms grid."""
    t = (np.arange(N_TIMES) + 0.5)[None, :] * 1e-3
    speed = 88.0 * (1.0 - np.exp(-t / 0.08))
    angle = 88.0 * (t - 0.08 * (1.0 - np.exp(-t / 0.08)))
    current = 3.0 + 45.0 * (np.exp(-t / 0.09) - np.exp(-t / 0.015))
    voltage = 17.9 - 0.01 * current
    force = 0.0 * t if is_idle else 240.0 * np.maximum(-RADIUS_M * speed * np.sin(angle), 0.0)
    state = State(
        kind="start_up", setting=setting_of(is_idle), angle_rad=angle, speed_rad_s=speed,
        acceleration_rad_s2=np.gradient(speed, 1e-3, axis=1), current_a=current,
        current_rate_a_s=np.gradient(current, 1e-3, axis=1), force_n=force,
        force_rate_n_s=np.gradient(force, 1e-3, axis=1), battery_voltage_v=voltage,
        battery_current_a=0.44 * current, motor_voltage_v=0.4375 * voltage, time_s=np.array([[0.3]]),
        cut_distance_m=np.array([[0.5]]), charge_used_as=np.array([[0.0]]), n_strokes=np.ones(1),
        **history(1, 0.0 if is_idle else 240.0),
    )  # fmt: skip
    return replace(state, **changes)
