"""The residuals against machines that are integrated here, with kinematics written out here."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.config import BatteryConfig, PlantConfig
from sawbench.diagnosis.inference.nuisances import nuisances_of
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.residuals import Baseline, residuals
from sawbench.modeling.state import State, TrialSetting
from scipy.integrate import solve_ivp

pytestmark = pytest.mark.unit

R, L, KE, KM, J_MOTOR, J_CRANK, MASS, B, GEAR = 0.176, 3.21e-3, 7.383e-3, 5.632e-3, 2.4e-5, 2.38e-5, 0.239, 3.4e-6, 9.0
RADIUS, ROD, K_CUT, DUTY, E_0, R_B = 0.01, 0.025, 240.0, 0.5, 18.0, 0.02


def travel(angle, radius=RADIUS):
    """Blade travel by the law of cosines: crank end at radius (sin, cos), rod to a point on the axis."""
    return radius + ROD - radius * np.cos(angle) - np.sqrt(ROD**2 - (radius * np.sin(angle)) ** 2)


def lever(angle, radius=RADIUS):
    """Derivative of the travel by a complex step, exact to rounding."""
    return np.imag(travel(angle + 1e-30j, radius)) / 1e-30


def slope(angle, radius=RADIUS):
    return (lever(angle + 1e-6, radius) - lever(angle - 1e-6, radius)) / 2e-6


def blade_force(angle, speed):
    return K_CUT * np.maximum(-lever(angle) * speed, 0.0)


def rates(_, y):
    current, speed, angle = y
    g, force = lever(angle), blade_force(angle, speed)
    current_rate = (DUTY * (E_0 - R_B * DUTY * current) - R * current - KE * GEAR * speed) / L
    # Lagrange: d/dt (J(angle) w) - 1/2 J' w^2 = torque; the force of the wood pushes against the falling blade.
    torque = GEAR * (KM * current - B * GEAR * speed) + force * g
    inertia = J_MOTOR * GEAR**2 + J_CRANK + MASS * g**2
    return [current_rate, (torque - MASS * g * slope(angle) * speed**2) / inertia, speed]


@pytest.fixture(scope="module")
def trial() -> State:
    """A few strokes of a slider-crank saw with a short rod (r/l = 0.4), cutting, derivatives by differences."""
    exact = solve_ivp(rates, (0.0, 0.5), [0.0, 5.0, 0.1], method="DOP853", rtol=1e-11, atol=1e-11, max_step=1e-3,
                      dense_output=True).sol  # fmt: skip
    t, h = np.arange(0.1, 0.45, 1e-3), 2e-6
    y, y_rate = exact(t)[:, None, :], ((exact(t + h) - exact(t - h)) / (2 * h))[:, None, :]
    force = blade_force(y[2], y[1])
    voltage = E_0 - R_B * DUTY * y[0]
    setting = TrialSetting(
        label="t", index=0, duty=DUTY, is_idle=False, stock="oak", feed_m_s=0.004, thickness_m=0.02,
        operating_point="p", session_s=0.0,
    )  # fmt: skip
    one = np.ones((1, 1))
    return State(
        kind="start_up", setting=setting, angle_rad=y[2], speed_rad_s=y[1], acceleration_rad_s2=y_rate[1],
        current_a=y[0], current_rate_a_s=y_rate[0], force_n=force, force_rate_n_s=np.gradient(force, 1e-3, axis=1),
        battery_voltage_v=voltage, battery_current_a=DUTY * y[0], motor_voltage_v=DUTY * voltage, time_s=0.1 * one,
        cut_distance_m=0.0 * one, charge_used_as=0.0 * one, n_strokes=np.ones(1),
        k_guess_n_s_per_m=K_CUT, peak_force_n=force.max(),
    )  # fmt: skip


def baseline(mechanism: str, radius: float = RADIUS) -> Baseline:
    numbers = {
        "resistance_ohm": R, "inductance_h": L, "back_emf_constant_v_s_per_rad": KE, "torque_constant_n_m_per_a": KM,
        "rotor_inertia_kg_m2": J_MOTOR, "yoke_inertia_kg_m2": J_CRANK, "reciprocating_mass_kg": MASS,
        "crank_radius_m": radius, "motor_damping_n_m_s_per_rad": B, "gear_ratio": GEAR,
        "mechanism": mechanism, "rod_length_m": ROD,
    }  # fmt: skip
    battery = BatteryConfig(
        nominal_voltage_v=E_0, capacity_ah=1.5, beta=0.99, internal_resistance_ohm=R_B, cutoff_soc=0.2
    )
    return Baseline(plant=PlantConfig.model_validate(numbers), battery=battery, cutting_sign=-1)


def left_over(model: Baseline, state: State) -> dict:
    found = residuals(model, state)
    return {**found, "cutting": found["cutting"] - model.expected_force(state)}


# What the terms of each equation reach in this trial, for scale.
def scales(state: State) -> dict:
    torque = KM * np.abs(state.current_a).max()
    return {"electrical": DUTY * E_0, "mechanical": torque, "cutting": state.force_n.max(), "supply": E_0,
            "converter": np.abs(state.battery_current_a).max()}  # fmt: skip


def test_the_residuals_of_an_independent_slider_crank_vanish(trial):
    for equation, size in scales(trial).items():
        assert np.abs(left_over(baseline("slider_crank"), trial)[equation]).max() < 1e-6 * size, equation


def test_with_the_equations_of_a_yoke_they_do_not(trial):
    found = left_over(baseline("scotch_yoke"), trial)
    for equation in ("mechanical", "cutting"):
        assert np.abs(found[equation]).max() > 0.1 * scales(trial)[equation], equation


def test_a_wrong_crank_radius_leaves_what_its_signature_says(trial):
    step = 1e-5
    (signature,) = [n.signature for n in nuisances_of(baseline("slider_crank")) if n.name == "crank_radius_m"]
    model = baseline("slider_crank", RADIUS - step)
    seen = residuals(model, trial)["mechanical"]
    claimed = step * signature(model, trial)["mechanical"]
    assert np.abs(seen).max() > 1e-4
    assert np.abs(seen - claimed).max() < 5e-3 * np.abs(seen).max()


def test_friction_on_the_guide_brakes_by_its_power(trial):
    """The torque at the crank times its speed is the friction force times the blade's."""
    model = baseline("slider_crank")
    (part,) = EFFECT_BY_NAME["guide_friction"].signatures(model, trial)
    power = part["mechanical"] * GEAR * trial.speed_rad_s
    velocity = np.abs(lever(trial.angle_rad) * trial.speed_rad_s)
    fast = velocity > 0.05
    assert np.allclose(power[fast], velocity[fast], rtol=1e-3)


def test_side_force_slides_as_the_geometry_of_the_rod_says(trial):
    """Work of friction: the guide takes the tangent of the rod's angle of the blade force, over the blade's travel."""
    angle = trial.angle_rad
    lean = np.arcsin(RADIUS * np.sin(angle) / ROD)
    wanted = np.abs(np.tan(lean) * lever(angle))
    assert np.allclose(baseline("slider_crank").mechanism.sliding_lever(angle), wanted, atol=1e-12)
    block = np.abs(RADIUS * np.cos(angle))
    assert np.allclose(baseline("scotch_yoke").mechanism.sliding_lever(angle), block, atol=1e-15)
