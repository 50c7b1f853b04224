"""Signatures against an independent simulation: Eq. 12-13 with the effect's own physics, in steady strokes.

The simulation writes each effect as what happens in the machine or in the sensor; the residuals of the
baseline on it must be what the catalogue says, sign and size.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.yoke_backlash import swing, swings
from sawbench.modeling.parts.linear import coefficient

from tests.rigs.jigsaw_in_time import (
    BASELINE,
    DUTY,
    GEAR,
    JC,
    JM,
    K_CUT,
    KE,
    KM,
    MASS,
    R_BATTERY,
    RADIUS,
    SMALL,
    B,
    L,
    Machine,
    R,
    compare,
    gap,
)

pytestmark = pytest.mark.contract
LATE_FORCE = KnownEffect(effect=EFFECT_BY_NAME["force_sensor_lag"], value=1e-3, form={"damping": 0.5})


def check(machine: Machine, name: str, amplitude: float, shape: dict | None = None, tolerance: float = 0.03) -> None:
    state = machine.run()
    seen = gap(state)
    (claimed,) = EFFECT_BY_NAME[name].signatures(BASELINE, state, shape)
    compare(seen, {key: amplitude * wave for key, wave in claimed.items()}, tolerance)


def test_a_machine_without_effects_leaves_no_residual():
    for wave, small in ((w, SMALL[e]) for e, w in gap(Machine().run()).items()):
        assert np.max(np.abs(wave)) < small


@pytest.mark.parametrize("cuts", [True, False])
def test_guide_friction(cuts):
    machine = Machine(cuts=cuts, guide=lambda v: 6.0 * np.tanh(abs(v) / 0.01))
    check(machine, "guide_friction", 6.0)


def test_guide_friction_with_a_stribeck_dip():
    machine = Machine(guide=lambda v: 6.0 * np.tanh(abs(v) / 0.01) * (1 + 0.5 * np.exp(-((v / 0.1) ** 2))))
    check(machine, "guide_friction", 6.0, {"static_ratio": 1.5, "stribeck_m_s": 0.1})


def test_motor_coulomb_friction():
    check(Machine(drag=lambda w, load: 0.006 * np.sign(w)), "motor_coulomb_friction", 0.006)


def test_windage_drag():
    check(Machine(drag=lambda w, load: 7e-9 * w**2), "windage_drag", 0.007)


@pytest.mark.parametrize(("order", "cuts"), [(1, True), (5, True), (2, False)])
def test_a_swing_of_the_read_angle(order, cuts):
    """The plunger's reading bends both ways: what the equations then leave, per radian of the wave."""
    size = 1e-3 / order
    larger, smaller = (
        gap(Machine(cuts=cuts, bend=((order, sign * size, 0.5 * sign * size),)).run()) for sign in (1.0, -1.0)
    )
    true = Machine(cuts=cuts).run()
    wave = size * (np.cos(order * true.angle_rad) + 0.5 * np.sin(order * true.angle_rad))
    # The blade of this machine goes with the crank: only what a swing of the reading does is compared, not the cut.
    seen = {name: 0.5 * (larger[name] - smaller[name]) for name in ("electrical", "mechanical")}
    compare(seen, swing(BASELINE, true, wave), 0.02)


@pytest.mark.parametrize("known", [(), (LATE_FORCE,)], ids=["no known effect", "a known effect"])
def test_many_swings_at_once_are_each_as_it_is_alone(known):
    true, model = Machine().run(), replace(BASELINE, known=known)
    waves = np.array([1e-3 * np.cos(order * true.angle_rad[:1]) for order in (1, 3, 7)])
    for wave, found in zip(waves, swings(model, true, waves, of_sensor=True), strict=True):
        alone = swing(model, true, wave, of_sensor=True)
        assert found.keys() == alone.keys() == {"electrical", "mechanical", "cutting"}
        for equation, rows in alone.items():
            np.testing.assert_allclose(found[equation], rows, rtol=1e-9, atol=1e-9 * np.abs(rows).max())


def test_backlash_is_made_of_swings():
    """Its k-th wave is a gap of one metre at the crank pin over two radii, smaller by the root of k."""
    true = Machine().run()
    parts = EFFECT_BY_NAME["yoke_backlash"].signatures(BASELINE, true, {"waves": 1.0})
    assert len(parts) == EFFECT_BY_NAME["yoke_backlash"].n_signatures({"waves": 1.0})
    for order, part in ((1, parts[1]), (4, parts[7])):
        turn = 1e-5 / (2 * RADIUS) / np.sqrt(order)
        larger, smaller = (gap(Machine(bend=((order, 0.0, sign * turn),)).run()) for sign in (1.0, -1.0))
        seen = {name: 0.5 * (larger[name] - smaller[name]) for name in ("electrical", "mechanical")}
        compare(seen, {name: 1e-5 * wave for name, wave in part.items()}, 0.02)


def test_load_dependent_friction():
    check(Machine(drag=lambda w, load: 0.1 * abs(load)), "load_dependent_friction", 0.1)


def test_gear_eccentricity_in_both_phases():
    for phase, weights in ((0.0, (1.0, 0.0)), (0.9, (np.cos(0.9), np.sin(0.9)))):
        state = Machine(once=lambda angle, psi=phase: 0.004 * np.sin(angle + psi)).run()
        parts = EFFECT_BY_NAME["gear_eccentricity"].signatures(BASELINE, state)
        summed = sum(0.004 * w * part["mechanical"] for w, part in zip(weights, parts, strict=True))
        compare(gap(state), {"mechanical": summed}, 0.01)


def test_a_swinging_transmission_ratio():
    """Crank and rotor tied by motor angle = gear (angle + e sin(angle)), the energy balance written out."""
    swing, state = 0.004, Machine().run()
    angle, w, a, load = state.angle_rad, state.speed_rad_s, state.acceleration_rad_s2, state.force_n
    ratio = GEAR * (1 + swing * np.cos(angle))
    motor_speed, motor_acceleration = ratio * w, ratio * a - GEAR * swing * np.sin(angle) * w**2
    crank_torque = JC * a + MASS * RADIUS**2 * np.sin(angle) * (np.sin(angle) * a + np.cos(angle) * w**2)
    crank_torque = crank_torque - load * RADIUS * np.sin(angle)
    current = (JM * motor_acceleration + B * motor_speed + crank_torque / ratio) / KM
    voltage = R * current + L * state.current_rate_a_s + KE * motor_speed
    seen = gap(replace(state, current_a=current, motor_voltage_v=voltage))
    _, cosine = EFFECT_BY_NAME["gear_eccentricity"].signatures(BASELINE, state, {"kinematic": 1.0})
    seen = {name: seen[name] for name in ("electrical", "mechanical")}
    compare(seen, {name: swing * wave for name, wave in cosine.items()}, 0.03)


@pytest.mark.parametrize("unloads", [False, True])
def test_blade_compliance(unloads):
    machine = Machine(memory_s=K_CUT / 1e5, unloads=unloads)
    shape = {"stiffness_n_per_m": 1e5, "unloads": float(unloads)}
    check(machine, "blade_compliance", 1.0, shape, tolerance=0.05)


@pytest.mark.parametrize("unloads", [False, True])
def test_blade_compliance_where_the_coefficient_is_regressed_over_the_late_force(unloads):
    """At two speeds, as in a campaign: one coefficient for both, too small by more than a quarter."""
    stiffness_n_per_m = 2.5e4
    states = [
        Machine(memory_s=K_CUT / stiffness_n_per_m, unloads=unloads, duty=duty).run() for duty in (0.6 * DUTY, DUTY)
    ]
    speeds = [BASELINE.cutting_speed(state) for state in states]
    k_fc = coefficient(np.array([state.force_n for state in states]), np.array(speeds))
    assert k_fc < 0.75 * K_CUT
    weights = [float(np.sum(speed**2)) for speed in speeds]
    at_rad_s = float(np.average([state.speed_rad_s.mean() for state in states], weights=weights))
    for state in states:
        regressed = replace(state, k_guess_n_s_per_m=float(k_fc), regressed_at_rad_s=at_rad_s)
        shape = {"stiffness_n_per_m": stiffness_n_per_m, "unloads": float(unloads)}
        (claimed,) = EFFECT_BY_NAME["blade_compliance"].signatures(BASELINE, regressed, shape)
        compare(gap(regressed), claimed, 0.15)


def test_return_stroke_rubbing():
    check(Machine(rub=lambda v: 30.0 * v), "return_stroke_rubbing", 30.0)


def test_cutting_speed_exponent():
    machine = Machine(cut=lambda v, x, m: K_CUT * 0.7 * (v / 0.7) ** 0.4)
    check(machine, "cutting_speed_exponent", 1.0, {"exponent": 0.4}, tolerance=0.01)


def test_edge_force():
    check(Machine(cut=lambda v, x, m: 35.0 * np.tanh(v / 0.01) + K_CUT * v), "edge_force", 35.0)


def test_tooth_passing_ripple():
    def cut(v, travelled, memory):
        return K_CUT * v * (1 + 0.2 * np.cos(2 * np.pi * (2 * RADIUS - travelled) / 0.004))

    state = Machine(cut=cut).run()
    shape = {"pitch_m": 0.004, "sharp": 0.0}
    _, cosine = EFFECT_BY_NAME["tooth_passing_ripple"].signatures(BASELINE, state, shape)
    compare(gap(state), {key: 0.2 * wave for key, wave in cosine.items()}, 0.02)


def test_teeth_that_are_set_in_turn_have_the_wave_of_every_second_one_too():
    def cut(v, travelled, memory):
        turn = 2 * np.pi * (2 * RADIUS - travelled) / 0.004
        return K_CUT * v * (1 + 0.2 * np.sin(turn + 0.3) + 0.1 * np.sin(0.5 * turn - 1.1))

    state = Machine(cut=cut).run()
    shape = {"pitch_m": 0.004, "sharp": 1.0, "alternate": 1.0}
    parts = EFFECT_BY_NAME["tooth_passing_ripple"].signatures(BASELINE, state, shape)
    # Waves of the pitch, then of two pitches, whose typical size is half of that.
    weights = [0.2 * w for p in (0.3, -1.1) for w in (np.cos(p), np.sin(p))]
    found = {key: sum(w * part[key] for w, part in zip(weights, parts, strict=False)) for key in parts[0]}
    compare(gap(state), found, 0.02)


def test_sharp_teeth_have_two_overtones_each_half_as_large():
    sizes, phases = (0.2, 0.1, 0.05), (0.3, 1.1, -0.7)

    def cut(v, travelled, memory):
        turn = 2 * np.pi * (2 * RADIUS - travelled) / 0.004
        waves = (a * np.sin(k * turn + p) for k, a, p in zip((1, 2, 3), sizes, phases, strict=True))
        return K_CUT * v * (1 + sum(waves))

    state = Machine(cut=cut).run()
    shape = {"pitch_m": 0.004, "sharp": 1.0}
    parts = EFFECT_BY_NAME["tooth_passing_ripple"].signatures(BASELINE, state, shape)
    # One amplitude for all three: the overtones' sizes are the signature's own.
    weights = [0.2 * w for p in phases for w in (np.cos(p), np.sin(p))]
    claimed = sum(w * part["cutting"] for w, part in zip(weights, parts, strict=True))
    compare(gap(state), {"cutting": claimed}, 0.02)


def test_engagement_delay():
    machine = Machine(cut=lambda v, x, m: K_CUT * v * np.clip((x / (2 * RADIUS) - 0.18) / 0.08 + 0.5, 0, 1))
    check(machine, "engagement_delay", 1.0, {"fraction": 0.18, "ramp": 0.08})


def test_engagement_delay_where_the_coefficient_is_regressed_over_the_whole_half_stroke():
    machine = Machine(cut=lambda v, x, m: K_CUT * v * np.clip((x / (2 * RADIUS) - 0.32) / 0.08 + 0.5, 0, 1))
    state = machine.run()
    k_fc = float(coefficient(state.force_n, BASELINE.cutting_speed(state)))
    assert k_fc < 0.8 * K_CUT
    regressed = replace(state, k_guess_n_s_per_m=k_fc, regressed_at_rad_s=float(state.speed_rad_s.mean()))
    shape = {"fraction": 0.32, "ramp": 0.08}
    (claimed,) = EFFECT_BY_NAME["engagement_delay"].signatures(BASELINE, regressed, shape)
    compare(gap(regressed), claimed, 0.03)


def test_brush_voltage_drop():
    check(Machine(lost_voltage=lambda i, w: 0.9 * np.tanh(i / 0.1)), "brush_voltage_drop", 0.9)


def test_brushes_whose_voltage_goes_on_rising_with_the_current():
    """0.8 V flat and 0.05 V for every e-fold of the current beyond 1 A: 0.92 V at 10 A, a part of it logarithmic."""

    def lost(i, w):
        return 0.8 * np.tanh(i / 1.0) + 0.05 * np.sign(i) * np.log1p(abs(i))

    at_10_a = lost(10.0, 0.0)
    rise = 0.05 * np.log1p(10.0) / at_10_a
    check(Machine(lost_voltage=lost), "brush_voltage_drop", at_10_a, {"knee_a": 1.0, "rise": rise}, tolerance=0.01)


@pytest.mark.parametrize("duty", [0.35, 0.6])
def test_converter_diode_drop(duty):
    machine = Machine(duty=duty, lost_voltage=lambda i, w: 0.6 * (1 - duty))
    check(machine, "converter_diode_drop", 0.6)


@pytest.mark.parametrize("duty", [0.35, 0.6])
@pytest.mark.parametrize("dead", [0.0, 0.3])
def test_converter_diode_after_shockley(duty, dead):
    """V_f = n V_T ln(1 + i / i_s): the amplitude is what the diode takes at 10 A."""
    thermal_v, saturation_a = 0.09, 0.03
    machine = Machine(
        duty=duty, lost_voltage=lambda i, w: thermal_v * np.log(1 + max(i, 0.0) / saturation_a) * (1 - duty + dead)
    )
    shape = {"dead_share": dead, "knee_a": saturation_a, "rise": 1.0}
    check(machine, "converter_diode_drop", thermal_v * np.log(1 + 10.0 / saturation_a), shape)


def test_winding_heating():
    rise_k = 4.0 * R * 120.0  # K/W times the copper loss in the slow state
    machine = Machine(resistance=R * (1 + 0.0039 * rise_k))
    check(machine, "winding_heating", 4.0, tolerance=0.01)


def test_magnet_weakening():
    machine = Machine(flux=1 - 0.0015 * 3.0 * R * 120.0)
    check(machine, "magnet_weakening", 3.0, tolerance=0.01)


def test_battery_internal_resistance():
    check(Machine(battery_resistance=R_BATTERY + 0.05), "battery_internal_resistance", 0.05)


@pytest.mark.parametrize(("power", "growth", "factor"), [(0.5, 0.0, 2.0**0.5), (2.0, 0.0, 4.0), (0.0, 4.0, 3.0)])
def test_battery_internal_resistance_of_a_half_empty_battery(power, growth, factor):
    open_voltage = 18.0 * 0.5 / (1 - 0.99 * 0.5)  # Eq. 16 at half charge
    machine = Machine(
        battery_resistance=R_BATTERY + 0.03 * factor, open_voltage=open_voltage, charge_used_as=0.5 * 1.5 * 3600
    )
    check(machine, "battery_internal_resistance", 0.03, {"power": power, "growth": growth})


@pytest.mark.parametrize("duty", [0.35, 0.6])
@pytest.mark.parametrize(
    ("loss_a", "shape"),
    [
        (lambda duty, i: duty * i * (1 / 0.92 - 1), {"lumped": 1 / 0.92 - 1}),  # one efficiency of 92 %
        (lambda duty, i: 0.04 * i, {"switching": 0.08}),  # 5 A at 10 A and half duty are the unit
        (lambda duty, i: 0.06 * i**2 / 18.0, {"conduction": 0.06 * 100 / 18.0 / 5}),  # 60 mOhm
        (lambda duty, i: duty * 0.06 * i**2 / 18.0, {"on_state": 0.06 * 100 / 18.0 / 10}),  # the upper switch
        (lambda duty, i: 0.25, {"constant": 0.05}),  # a controller that draws 0.25 A
        (lambda duty, i: 0.02 * i + 0.003 * i**2, {"switching": 0.04, "conduction": 0.06}),
        # A loss of 10 % at 10 A and of 20 % at a fourth of it.
        (lambda duty, i: 0.1 * duty * np.sqrt(10.0 * max(i, 0.0)), {"light": 0.1}),
    ],
)
def test_converter_loss(loss_a, shape, duty):
    state = Machine(duty=duty, lost_current=loss_a).run()
    shares = dict.fromkeys(("lumped", "switching", "conduction", "constant", "light"), 0.0)
    parts = {name: value / 0.08 for name, value in shape.items()}
    (claimed,) = EFFECT_BY_NAME["converter_loss"].signatures(BASELINE, state, {**shares, **parts})
    # The battery's voltage goes with the ideal current in this machine: only the converter is compared.
    seen = {"converter": gap(state)["converter"]}
    compare(seen, {"converter": 0.08 * claimed["converter"]}, 0.01)


def test_current_limit():
    state = Machine(lost_voltage=lambda i, w: 40.0 * max(i - 10.6, 0.0)).run()
    assert gap(state)["electrical"].max() > 0.4
    (claimed,) = EFFECT_BY_NAME["current_limit"].signatures(BASELINE, state, {"share": 0.985, "soft": 0.0})
    seen = {"electrical": gap(state)["electrical"]}
    # The edge of the signature is softer than this controller's.
    compare(seen, {"electrical": claimed["electrical"]}, 0.25)


def test_preload_lift_off():
    state = Machine().run()
    true_force = state.force_n
    state = replace(state, force_n=np.minimum(true_force, 180.0))
    assert true_force.max() > 190.0
    (claimed,) = EFFECT_BY_NAME["preload_lift_off"].signatures(BASELINE, state, {"share": 1.0, "scale": 1.0})
    compare(gap(state), claimed, 0.1)


@pytest.mark.parametrize("tau_s", [5e-4, 3e-3])
def test_force_sensor_lag(tau_s):
    check(Machine(lag_force_s=tau_s), "force_sensor_lag", 1.0, {"tau_s": tau_s, "damping": 0.0}, tolerance=0.04)


@pytest.mark.parametrize("damping", [0.5, 0.7, 1.0])
@pytest.mark.parametrize("tau_s", [1e-3, 3e-3])
def test_force_sensor_lag_of_second_order(tau_s, damping):
    """Slow signals are late by 2 zeta / w_0."""
    natural_hz = 2 * damping / tau_s / (2 * np.pi)
    machine = Machine(ring=(natural_hz, damping))
    check(machine, "force_sensor_lag", 1.0, {"tau_s": tau_s, "damping": damping}, tolerance=0.04)


@pytest.mark.parametrize("tau_s", [5e-4, 3e-3])
def test_current_sensor_lag(tau_s):
    check(Machine(lag_current_s=tau_s), "current_sensor_lag", 1.0, {"tau_s": tau_s}, tolerance=0.02)


@pytest.mark.parametrize(("frequency_hz", "damping"), [(95.0, 0.2), (150.0, 0.08)])
def test_carriage_resonance(frequency_hz, damping):
    machine = Machine(ring=(frequency_hz, damping))
    shape = {"frequency_hz": frequency_hz, "damping": damping}
    check(machine, "carriage_resonance", 1.0, shape, tolerance=0.05)


def test_a_carriage_with_an_upper_mode_and_a_force_that_bypasses_it():
    """Half of the force rings at 110 Hz, a fifth at twice that, and the rest reaches the cell at once."""
    first, upper = (Machine(ring=(f, 0.06)).run() for f in (110.0, 220.0))
    true = Machine().run()
    reading = 0.5 * first.force_n + 0.2 * upper.force_n + 0.3 * true.force_n
    shape = {"frequency_hz": 110.0, "damping": 0.06, "upper": 2.0}
    parts = EFFECT_BY_NAME["carriage_resonance"].signatures(BASELINE, true, shape)
    claimed = {key: 0.5 * parts[0][key] + 0.2 * parts[1][key] for key in parts[0]}
    compare(gap(replace(true, force_n=reading)), claimed, 0.05)


@pytest.mark.parametrize(("device", "channel"), [(0.0, "force"), (1.0, "can"), (2.0, "displacement")])
@pytest.mark.parametrize("tau_s", [1e-3, 5e-3])
def test_clock_offset(device, channel, tau_s):
    machine = Machine(late={channel: tau_s})
    shape = {"device": device, "tau_s": tau_s, "drifts": 0.0}
    # A late displacement also puts the cutting half at the wrong angle, a second-order term.
    check(machine, "clock_offset", 1.0, shape, tolerance=0.05)
