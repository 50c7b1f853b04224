"""A balance of the electrical side that varies within a trial: what sensors, currents and slow changes may leave, and
what they may not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.posterior import judge
from sawbench.diagnosis.inference.unsteady_balance import unsteady_balances

from tests.rigs.jigsaw_in_time import BASELINE
from tests.rigs.scattered_strokes import N_UNITS, problem_of, strokes

ZERO_A = 0.01 * BASELINE.usual_current_a
# What the zeros of the sensors of current and voltage do to the balance at a duty of 0.44.
BY_ZEROS_V = float(np.hypot(BASELINE.plant.resistance_ohm.nominal * ZERO_A, 0.44 * 0.01))


def with_voltage(states, change_v):
    """Motors whose voltage is off by `change_v(state, rng)`, one number a few strokes."""
    rng = np.random.default_rng(3)
    return [replace(s, motor_voltage_v=s.motor_voltage_v + change_v(s, rng)[:, None]) for s in states]


def found_with(change_v, seed=21):
    return unsteady_balances(problem_of(with_voltage(strokes(seed), change_v)))


@pytest.mark.parametrize("seed", range(21, 29))
def test_sensors_and_wood_leave_every_balance_steady(seed):
    assert unsteady_balances(problem_of(strokes(seed))) == []


def test_a_duty_that_wanders_is_found_where_it_acts():
    (finding,) = found_with(lambda s, rng: 4.0 * BY_ZEROS_V * rng.standard_normal(N_UNITS))
    assert finding.equation == "electrical"
    assert finding.channel == "motor_current_a"
    assert finding.log_evidence > 20.0
    assert "in 5 of 5 trials" in finding.text


@pytest.mark.parametrize("seed", [21, 22, 23])
def test_a_duty_that_wanders_within_little_more_than_a_step_of_eight_bits_is_none(seed):
    """As seen: 9 mV of 28 V within the trials of a saw whose trigger sets the duty hid a winding that got hot."""
    step_v = 18.0 / 256
    assert found_with(lambda s, rng: step_v * rng.uniform(-0.6, 0.6, N_UNITS), seed) == []


def test_a_duty_that_wanders_is_found_though_the_battery_s_current_follows_it():
    """As seen: the battery's current over that of the motor is the duty, so it says all that the voltages leave."""
    rng = np.random.default_rng(7)
    states = []
    for state in strokes():
        more = 4.0 * BY_ZEROS_V * rng.standard_normal(N_UNITS)[:, None] / state.battery_voltage_v.mean()
        battery_a = state.battery_current_a + more * state.current_a
        motor_v = state.motor_voltage_v - more * state.battery_voltage_v
        states.append(replace(state, battery_current_a=battery_a, motor_voltage_v=motor_v))
    found = {finding.equation: finding for finding in unsteady_balances(problem_of(states))}
    assert "in 5 of 5 trials" in found["electrical"].text
    assert found["electrical"].log_evidence > 20.0


def test_another_load_of_the_battery_is_found_where_it_draws():
    """As seen: 0.8 A beside a current of 2.7 A. Its two currents explain all of the balance, whatever else draws."""
    rng = np.random.default_rng(11)
    states = []
    for state in strokes():
        drawn_a = 2.0 * rng.uniform(size=N_UNITS)
        battery_a = state.battery_current_a + drawn_a[:, None]
        states.append(replace(state, battery_current_a=battery_a))
    (finding,) = unsteady_balances(problem_of(states))
    assert finding.channel == "battery_current_a"
    assert finding.log_evidence > 20.0
    assert "another load of the battery" in finding.text


@pytest.mark.parametrize("unsteady", [0.0, 0.1])
def test_losses_and_gains_leave_the_currents_of_the_converter_steady(unsteady):
    """A share of the current that is lost, and wood that is harder every now and then."""
    rng = np.random.default_rng(12)
    states = []
    for state in strokes():
        harder = 1.0 + unsteady * rng.standard_normal(N_UNITS)[:, None]
        current_a = state.current_a * harder
        battery_a = 1.01 * state.setting.duty * current_a * 1.07 + 0.02
        states.append(replace(state, current_a=current_a, battery_current_a=battery_a))
    assert "battery_current_a" not in {finding.channel for finding in unsteady_balances(problem_of(states))}


def test_no_more_than_the_zeros_of_sensors_do_is_theirs():
    assert found_with(lambda s, rng: 0.5 * BY_ZEROS_V * rng.standard_normal(N_UNITS)) == []


def test_a_contact_that_is_loose_shows_under_load_alone():
    """The battery's voltage falls by a resistance that changes; in air hardly a current flows."""
    rng = np.random.default_rng(4)
    states = []
    in_air = [s for s in strokes() if s.setting.is_idle]
    for state in [*strokes(), *in_air, *in_air]:
        dropped_v = 0.02 * rng.uniform(0.0, 1.0, N_UNITS)[:, None] * state.battery_current_a
        voltage_v = state.battery_voltage_v - (0.0 if state.setting.is_idle else dropped_v)
        states.append(replace(state, battery_voltage_v=voltage_v, motor_voltage_v=state.setting.duty * voltage_v))
    found = {finding.channel: finding for finding in unsteady_balances(problem_of(states))}
    assert "in 4 of 4 trials" in found["battery_voltage_v"].text


def test_a_voltage_sensor_whose_noise_is_slow_is_no_loose_contact():
    """It varies in air as well, where hardly a current flows."""
    rng = np.random.default_rng(6)
    in_air = [s for s in strokes() if s.setting.is_idle]
    states = []
    for state in [*strokes(), *in_air, *in_air]:
        read_v = state.battery_voltage_v + 0.2 * rng.standard_normal(N_UNITS)[:, None]
        states.append(replace(state, battery_voltage_v=read_v))
    assert not [found for found in unsteady_balances(problem_of(states)) if found.equation == "supply"]


@pytest.mark.parametrize(
    "change_v",
    [
        pytest.param(lambda s, rng: -0.5 * (s.current_a.mean(axis=1) - 10.0), id="series resistance"),
        pytest.param(lambda s, rng: np.linspace(0.0, 1.0, N_UNITS), id="a winding that warms up"),
        pytest.param(lambda s, rng: 3.0 * (np.arange(N_UNITS) == 5), id="a few strokes in a gap of the samples"),
    ],
)
def test_what_goes_with_currents_or_slowly_or_once_is_none(change_v):
    assert found_with(change_v) == []


def test_an_inductance_takes_a_voltage_while_the_current_gains_within_a_stroke():
    """As seen: 5 mH and a wood that is harder every now and then; means from stroke to stroke do not show the gain."""
    rng = np.random.default_rng(9)
    states = []
    for state in strokes():
        inductive_v = 4.0 * BY_ZEROS_V * rng.standard_normal(N_UNITS)[:, None]
        turn_s = 2.0 * np.pi / state.speed_rad_s.mean(axis=1, keepdims=True)
        gained_a = inductive_v / BASELINE.plant.inductance_h.nominal * turn_s
        ramp_a = gained_a * (state.angle_rad / (2.0 * np.pi) % 1.0 - 0.5)
        states.append(
            replace(state, current_a=state.current_a + ramp_a, motor_voltage_v=state.motor_voltage_v + inductive_v)
        )
    assert [found for found in unsteady_balances(problem_of(states)) if found.equation == "electrical"] == []


def test_in_a_minority_of_trials_it_is_none():
    def change_v(state, rng):
        return 4.0 * BY_ZEROS_V * rng.standard_normal(N_UNITS) * (state.setting.index < 2)

    assert found_with(change_v) == []


def dragging(drawn_a, *, in_air):
    """Motors that draw more by `drawn_a(rng)`, one number a few strokes, in air or under load."""
    rng = np.random.default_rng(5)
    return [
        replace(s, current_a=s.current_a + drawn_a(rng)[:, None]) if s.setting.is_idle == in_air else s
        for s in strokes()
    ]


def of_torques(states):
    return [found for found in unsteady_balances(problem_of(states)) if found.equation == "mechanical"]


def test_a_bearing_that_seizes_now_and_then_shows_in_air():
    """A drag in one stroke of three, by a third of the current of the usual cut."""
    (finding,) = of_torques(dragging(lambda rng: 33.0 * ZERO_A * (rng.uniform(size=N_UNITS) < 1 / 3), in_air=True))
    assert finding.channel == "motor_current_a"
    assert finding.log_evidence > 5.0
    assert "the balance of torques in air" in finding.text
    assert "in 1 of 1 trial," in finding.text


@pytest.mark.parametrize(
    ("drawn_a", "in_air"),
    [
        pytest.param(lambda rng: 0.5 * ZERO_A * rng.standard_normal(N_UNITS), True, id="as much as sensors do"),
        pytest.param(lambda rng: 3.0 * ZERO_A * rng.standard_normal(N_UNITS), True, id="friction that is never steady"),
        pytest.param(lambda rng: 50.0 * ZERO_A * (np.arange(N_UNITS) == 5), True, id="once"),
        pytest.param(lambda rng: np.linspace(20.0 * ZERO_A, 0.0, N_UNITS), True, id="grease that warms up"),
        pytest.param(lambda rng: 6.0 * ZERO_A * rng.standard_normal(N_UNITS), False, id="under load"),
    ],
)
def test_a_current_that_sensors_or_warmth_or_the_load_explain_is_no_drag(drawn_a, in_air):
    assert of_torques(dragging(drawn_a, in_air=in_air)) == []


def test_it_makes_the_cause_unknown_and_says_so():
    problem = problem_of(with_voltage(strokes(), lambda s, rng: 4.0 * BY_ZEROS_V * rng.standard_normal(N_UNITS)))
    posterior = judge(problem, effect_columns(problem))
    assert posterior.verdict == "unknown"
    assert posterior.resembles.startswith("the balance of voltages at the motor varies within a trial")
