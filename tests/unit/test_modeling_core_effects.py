"""Effects: each against its own equation, runs against periodic strokes, energy, the baseline."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from modeling.batteries.eq16 import Eq16Battery
from modeling.cutting_forces.linear import LinearCutting
from modeling.parameter_sets import paper_jigsaw as paper
from modeling.steady_state import steady_state
from modeling.supplies import FixedDuty, FixedVoltage
from modeling.transient import InitialState, Method, simulate

VOLTAGE = paper.MOTOR_VOLTAGE_V
SOURCE = FixedVoltage(voltage_v=VOLTAGE)
ENDLESS = Eq16Battery(nominal_voltage_v=18.0, capacity_ah=1e7, beta=0.9, internal_resistance_ohm=0.02)
DUTY = FixedDuty(duty=paper.DUTY, battery=ENDLESS)
AIR = LinearCutting(k_fc_n_s_per_m=0.0)
# Without reciprocating mass an idle machine turns evenly, and torques can be balanced by hand.
EVEN = paper.PARAMETERS.replace(reciprocating_mass_kg=0.0)
K_E, K_M, B, R, G = 7.383e-3, 5.632e-3, 3.4274e-6, 0.176, 56 / 6

EVERY = {
    "guide_coulomb_n": {"guide_coulomb_n": 5.0},
    "stribeck": {"guide_coulomb_n": 5.0, "guide_static_n": 9.0},
    "motor_coulomb": {"motor_coulomb_n_m": 0.004},
    "windage": {"windage_n_m_s2_per_rad2": 5e-9},
    "load_friction": {"load_friction": 0.05},
    "backlash": {"backlash_m": 3e-4},
    "eccentricity": {"eccentricity_n_m": 0.02, "eccentricity_phase_rad": 0.7},
    "compliance": {"blade_compliance_m_per_n": 5e-6},
    "rubbing": {"return_rubbing_n_s_per_m": 20.0, "return_rubbing_n": 3.0},
    "tooth": {"tooth_amplitude": 0.3, "tooth_pitch_m": 0.003},
    "exponent": {"cutting_exponent": 0.3},
    "exponent 0": {"cutting_exponent": 0.0},
    "edge": {"edge_force_n": 30.0},
    "chip": {"chip_exponent": 0.6, "feed_m_s": 0.005},
    "engagement": {"engagement_fraction": 0.2},
    "brush": {"brush_drop_v": 1.0},
    "battery resistance": {"extra_battery_resistance_ohm": 0.05},
    "current limit": {"current_limit_a": 11.0},
}
SLOW = {
    "wear": {"wear_per_m": 0.01},
    "grain": {"grain_amplitude": 0.3, "feed_m_s": 0.005},
    "heating": {"winding_heat_capacity_j_per_k": 30.0, "magnet_temperature_coefficient_per_k": -0.0015},
    "polarization": {"polarization_resistance_ohm": 0.05, "polarization_time_constant_s": 1.0},
}


def rms(a, b):
    return float(np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2)))


def run(effects, *, parameters=paper.PARAMETERS, supply=DUTY, cutting=paper.CUTTING, duration_s=1.0, **kwargs):
    return simulate(parameters, supply=supply, cutting=cutting, duration_s=duration_s, effects=effects, **kwargs)


@pytest.mark.parametrize("name", [*EVERY, *SLOW])
def test_default_accuracy_and_energy(name):
    effects = {**EVERY, **SLOW}[name]
    done = run(effects)
    fine = run(effects, method=Method(time_tolerance=1e-11))
    assert done.status == "ok"
    assert rms(done.motor_current_a, fine.motor_current_a) < 1e-6
    assert abs(done.energy.closure_error) < 1e-6


@pytest.mark.parametrize("name", EVERY)
def test_a_long_run_settles_at_the_periodic_stroke(name):
    effects = EVERY[name]
    state = steady_state(paper.PARAMETERS, supply=DUTY, cutting=paper.CUTTING, effects=effects)
    assert state.status == "ok"
    wave = state.waveform(32)
    done = run(effects, duration_s=2.5, rate_hz=8000.0, method=Method(time_tolerance=1e-9))
    begin = 2 * np.pi * (math.floor(done.crank_angle_rad[-1] / (2 * np.pi)) - 2)
    turn = done.crank_angle_rad - begin
    near = (turn > -0.5) & (turn < 2 * np.pi + 0.5)
    at_angle = CubicSpline(turn[near], done.motor_current_a[near])(wave.crank_angle_rad)
    assert wave.motor_current_a == pytest.approx(at_angle, abs=1e-3 if name == "current limit" else 1e-4)
    force = np.interp(wave.crank_angle_rad, turn[near], done.force_n[near])
    smooth = np.abs(np.gradient(force)) < 30.0  # not next to a step of the force
    smooth[[0, 16]] = False
    assert wave.force_n[smooth] == pytest.approx(force[smooth], abs=0.05 * np.abs(force).max())
    seconds = np.interp([0.0, 2 * np.pi], turn[near], done.time_s[near])
    assert seconds[1] - seconds[0] == pytest.approx(state.period_s, abs=2e-6)


def test_an_effect_of_no_size_is_the_baseline():
    plain = run(None)
    same = run({"brush_drop_v": 1e-14})
    assert rms(same.motor_current_a, plain.motor_current_a) < 3e-7
    assert same.energy.cutting_j == pytest.approx(plain.energy.cutting_j, rel=1e-6)
    for name in ("force_n", "displacement_m", "blade_velocity_m_s", "battery_voltage_v", "battery_current_a"):
        assert rms(getattr(same, name), getattr(plain, name)) < 1e-6, name


def test_torques_of_the_idle_machine_balance():
    """k_m i = b w + tau + c w^2 and U - V = R i + k_e w: two equations for w and i."""
    for tau, c, volts in ((0.004, 0.0, 0.0), (0.0, 5e-9, 0.0), (0.002, 2e-9, 1.0)):
        effects = {"motor_coulomb_n_m": tau, "windage_n_m_s2_per_rad2": c, "brush_drop_v": volts}
        state = steady_state(EVEN, supply=SOURCE, cutting=AIR, effects=effects)
        # c w^2 + (b + k_m k_e / R) w + tau - k_m (U - V) / R = 0
        roots = np.roots([c, B + K_M * K_E / R, tau - K_M * (VOLTAGE - volts) / R])
        w = float(roots[roots > 0].min())
        assert 2 * np.pi * G / state.period_s == pytest.approx(w, rel=1e-8)
        assert state.mean_motor_current_a == pytest.approx((VOLTAGE - volts - K_E * w) / R, rel=1e-7)


def test_guide_friction_takes_its_force_times_the_way():
    state = steady_state(EVEN, supply=SOURCE, cutting=AIR, effects={"guide_coulomb_n": 5.0})
    done = run({"guide_coulomb_n": 5.0}, parameters=EVEN, supply=SOURCE, cutting=AIR, duration_s=3.0)
    way = 4 * 0.01 * done.crank_angle_rad[-1] / (2 * np.pi)
    assert done.energy.other_j == pytest.approx(5.0 * way, rel=0.01)  # whole strokes and a part
    # Mean torque of |sin| is 2/pi: 5 N * 1 cm * 2/pi / gear at the motor.
    current = (5.0 * 0.01 * 2 / np.pi / G + B * 2 * np.pi * G / state.period_s) / K_M
    assert state.mean_motor_current_a == pytest.approx(current, rel=1e-4)


def test_stribeck_raises_friction_at_low_speed_only():
    plain = steady_state(EVEN, supply=SOURCE, cutting=AIR, effects={"guide_coulomb_n": 5.0})
    dip = {"guide_coulomb_n": 5.0, "guide_static_n": 9.0, "guide_stribeck_speed_m_s": 0.02}
    stuck = steady_state(EVEN, supply=SOURCE, cutting=AIR, effects=dip)
    wide = steady_state(EVEN, supply=SOURCE, cutting=AIR, effects={**dip, "guide_stribeck_speed_m_s": 100.0})
    full = steady_state(EVEN, supply=SOURCE, cutting=AIR, effects={"guide_coulomb_n": 9.0})
    assert plain.mean_motor_current_a < stuck.mean_motor_current_a < full.mean_motor_current_a
    assert wide.mean_motor_current_a == pytest.approx(full.mean_motor_current_a, rel=1e-4)


def test_brush_drop_and_battery_resistance_are_what_they_say():
    less = steady_state(paper.PARAMETERS, supply=FixedVoltage(voltage_v=VOLTAGE - 0.8), cutting=paper.CUTTING)
    brush = steady_state(paper.PARAMETERS, supply=SOURCE, cutting=paper.CUTTING, effects={"brush_drop_v": 0.8})
    assert brush.mean_motor_current_a == pytest.approx(less.mean_motor_current_a, rel=1e-7)
    worse = Eq16Battery(nominal_voltage_v=18.0, capacity_ah=1e7, beta=0.9, internal_resistance_ohm=0.07)
    one = run({"extra_battery_resistance_ohm": 0.05})
    two = run(None, supply=FixedDuty(duty=paper.DUTY, battery=worse))
    assert rms(one.motor_current_a, two.motor_current_a) < 5e-7
    assert rms(one.battery_voltage_v, two.battery_voltage_v) < 1e-7


def test_current_limit_holds_the_current_and_the_power_balance():
    done = run({"current_limit_a": 20.0}, rate_hz=5000.0)
    assert done.motor_current_a.max() == pytest.approx(20.0, abs=1e-9)
    flat = np.isclose(done.motor_current_a, 20.0, atol=1e-9)
    flat[np.flatnonzero(flat)[-1]] = False  # the limit may let go on this sample
    assert 0.01 < flat.mean() < 0.2
    volt = R * 20.0 + K_E * done.motor_speed_rad_s[flat]
    assert done.motor_voltage_v[flat] == pytest.approx(volt, rel=1e-9)
    power = done.battery_voltage_v * done.battery_current_a
    assert power[flat] == pytest.approx(volt * 20.0, rel=1e-9)


def test_forces_follow_their_laws():
    k = 240.29
    done = run({"edge_force_n": 30.0}, rate_hz=4000.0)
    along = np.maximum(-done.blade_velocity_m_s, 0.0)
    cuts = along > 0.05
    assert done.force_n[cuts] == pytest.approx(30.0 + k * along[cuts], rel=1e-9)
    assert (done.force_n[done.blade_velocity_m_s > 0] == 0.0).all()

    done = run({"cutting_exponent": 0.4, "cutting_reference_speed_m_s": 0.5}, rate_hz=4000.0)
    along = np.maximum(-done.blade_velocity_m_s, 0.0)
    cuts = along > 0.1
    assert done.force_n[cuts] == pytest.approx(k * 0.5 * (along[cuts] / 0.5) ** 0.4, rel=2e-3)

    done = run({"return_rubbing_n_s_per_m": 20.0, "return_rubbing_n": 3.0}, rate_hz=4000.0)
    back = done.blade_velocity_m_s > 0.05
    late = done.time_s > 0.2
    assert done.force_n[back & late] == pytest.approx(-3.0 - 20.0 * done.blade_velocity_m_s[back & late], rel=1e-9)

    effects = {"tooth_amplitude": 0.3, "tooth_pitch_m": 0.003, "tooth_phase_rad": 0.4}
    done = run(effects, rate_hz=4000.0)
    along = np.maximum(-done.blade_velocity_m_s, 0.0)
    gain = 1 + 0.3 * np.sin(2 * np.pi * done.displacement_m / 0.003 + 0.4)
    assert done.force_n == pytest.approx(k * along * gain, abs=1e-6)

    done = run({"grain_amplitude": 0.25, "grain_wavelength_m": 0.004, "feed_m_s": 0.006}, rate_hz=4000.0)
    along = np.maximum(-done.blade_velocity_m_s, 0.0)
    gain = 1 + 0.25 * np.sin(2 * np.pi * 0.006 * done.time_s / 0.004)
    assert done.force_n == pytest.approx(k * along * gain, abs=1e-6)


def test_delayed_engagement_and_backlash_are_fixed_in_position():
    done = run({"engagement_fraction": 0.3}, rate_hz=8000.0)
    turn = np.mod(done.crank_angle_rad, 2 * np.pi)
    travelled = (0.02 - done.displacement_m) / 0.02
    cutting = turn > np.pi
    assert (done.force_n[cutting & (travelled < 0.299)] == 0.0).all()
    assert (done.force_n[cutting & (travelled > 0.301) & (travelled < 0.98)] > 10.0).all()

    done = run({"backlash_m": 4e-4}, rate_hz=8000.0)
    turn = np.mod(done.crank_angle_rad, 2 * np.pi)
    settled = done.crank_angle_rad > 2 * np.pi
    gap = np.arccos(1 - 4e-4 / 0.01)
    assert np.ptp(done.displacement_m[settled]) == pytest.approx(0.02 - 4e-4, abs=1e-7)
    held = settled & (np.mod(turn, np.pi) < gap - 1e-3)
    assert (done.blade_velocity_m_s[held] == 0.0).all() and (done.force_n[held] == 0.0).all()
    assert held.sum() > 100


def test_compliant_blade_lags_and_decays_after_the_reversal():
    tau = 5e-6 * 240.29
    done = run({"blade_compliance_m_per_n": 5e-6}, rate_hz=50_000.0)
    rate = np.gradient(done.force_n, done.time_s)
    law = 240.29 * np.maximum(-done.blade_velocity_m_s, 0.0)
    inside = np.abs(np.sin(done.crank_angle_rad)) > 0.02
    assert (done.force_n + tau * rate)[inside] == pytest.approx(law[inside], abs=0.05)
    after = (np.mod(done.crank_angle_rad, 2 * np.pi) < 0.05) & (done.crank_angle_rad > 6)
    assert (done.force_n[after] > 0.5).all()


def test_heat_wear_and_polarization_add_up():
    effects = {"winding_heat_capacity_j_per_k": 30.0}
    done = run(effects, duration_s=2.0, rate_hz=20_000.0)
    # No cooling: the winding holds every joule of copper loss; its resistance says how warm it is.
    warm = done.energy.copper_j / 30.0
    electrical = done.motor_voltage_v[-2] - K_E * done.motor_speed_rad_s[-2]
    slope = (done.motor_current_a[-1] - done.motor_current_a[-3]) / (done.time_s[-1] - done.time_s[-3])
    resistance = (electrical - 3.21e-3 * slope) / done.motor_current_a[-2]
    assert resistance == pytest.approx(0.176 * (1 + 0.0039 * warm), rel=2e-4)

    done = run({"wear_per_m": 0.05}, duration_s=2.0, rate_hz=4000.0)
    along = np.maximum(-done.blade_velocity_m_s, 0.0)
    distance = np.concatenate([[0.0], np.cumsum(0.5 * (along[1:] + along[:-1]) / 4000.0)])
    assert done.force_n == pytest.approx(240.29 * along * (1 + 0.05 * distance), abs=0.01)

    effects = {"polarization_resistance_ohm": 0.05, "polarization_time_constant_s": 0.3}
    state = steady_state(
        paper.PARAMETERS,
        supply=DUTY,
        cutting=paper.CUTTING,
        effects=effects,
        slow=InitialState(polarization_v=0.05 * 4.5),
    )
    done = run(effects, duration_s=4.0, rate_hz=5000.0)
    late = done.time_s > 3.0
    sag = 18.0 - 0.02 * done.battery_current_a[late] - done.battery_voltage_v[late]
    assert sag.mean() == pytest.approx(0.05 * done.battery_current_a[late].mean(), rel=5e-3)
    assert state.mean_battery_current_a == pytest.approx(done.battery_current_a[late].mean(), rel=5e-3)


def test_chip_thickness_scales_the_force_by_the_stroke_before():
    effects = {"chip_exponent": 0.7, "feed_m_s": 0.004, "chip_reference_m": 2e-4}
    state = steady_state(paper.PARAMETERS, supply=DUTY, cutting=paper.CUTTING, effects=effects)
    wave = state.waveform(64)
    cuts = wave.blade_velocity_m_s < -0.1
    gain = (0.004 * state.period_s / 2e-4) ** 0.7
    assert wave.force_n[cuts] == pytest.approx(-240.29 * gain * wave.blade_velocity_m_s[cuts], rel=1e-6)


def test_a_friction_that_the_motor_cannot_overcome_stalls():
    done = run({"motor_coulomb_n_m": 0.5}, duration_s=1.0)
    assert done.status == "stalled"
    state = steady_state(paper.PARAMETERS, supply=SOURCE, cutting=paper.CUTTING, effects={"motor_coulomb_n_m": 0.5})
    assert state.status == "stalled"
