"""Runs: figures of the paper, limits with a closed form, events, statuses, and what nonsense input meets."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sawbench.bench.config import parse_config
from sawbench.bench.errors import InputError
from sawbench.modeling import slots
from sawbench.modeling.machines import paper_jigsaw as paper
from sawbench.modeling.parameters import JigsawParameters
from sawbench.modeling.parts.eq16 import Eq16Battery
from sawbench.modeling.parts.linear import LinearCutting
from sawbench.modeling.parts.measured import MeasuredForce
from sawbench.modeling.steady_state import steady_state
from sawbench.modeling.supplies import FixedDuty, FixedVoltage, HeldVoltage
from sawbench.modeling.transient import InitialState, Method, simulate

pytestmark = pytest.mark.unit

SOURCE = FixedVoltage(voltage_v=paper.MOTOR_VOLTAGE_V)
AIR = LinearCutting(k_fc_n_s_per_m=0.0)


def test_start_up_peaks_of_the_paper():
    held = HeldVoltage(voltage_v=paper.MOTOR_VOLTAGE_V, battery=paper.BATTERY)
    peak = {}
    for half in ("pi_to_2pi", "zero_to_pi"):
        cutting = LinearCutting(k_fc_n_s_per_m=240.29, cutting_half=half)
        run = simulate(paper.PARAMETERS, supply=held, cutting=cutting, duration_s=1.0, rate_hz=20_000.0)
        peak[half] = run.motor_current_a.max()
    assert peak["pi_to_2pi"] == pytest.approx(34.732, abs=0.001)  # the paper prints 34.73 A
    assert peak["zero_to_pi"] == pytest.approx(34.754, abs=0.001)


def test_no_load_no_damping_settles_at_the_back_emf():
    ideal = paper.PARAMETERS.replace(motor_damping_n_m_s_per_rad=0.0, reciprocating_mass_kg=0.0)
    run = simulate(ideal, supply=SOURCE, cutting=AIR, duration_s=4.0)
    assert run.motor_speed_rad_s[-1] == pytest.approx(SOURCE.voltage_v / 7.383e-3, rel=1e-7)
    assert abs(run.motor_current_a[-1]) < 1e-5


def test_without_mass_and_cut_the_machine_is_a_linear_motor():
    """Two linear equations with constant coefficients: the matrix exponential is the answer."""
    from scipy.linalg import expm

    p = paper.PARAMETERS.replace(reciprocating_mass_kg=0.0)
    run = simulate(p, supply=SOURCE, cutting=AIR, duration_s=0.4)
    inertia = p.rotor_inertia_kg_m2 + p.yoke_inertia_kg_m2 / p.gear_ratio**2
    a = np.array(
        [
            [-p.resistance_ohm / p.inductance_h, -p.back_emf_constant_v_s_per_rad / p.inductance_h],
            [p.torque_constant_n_m_per_a / inertia, -p.motor_damping_n_m_s_per_rad / inertia],
        ]
    )
    rest = np.linalg.solve(a, [-SOURCE.voltage_v / p.inductance_h, 0.0])
    exact = np.array([rest - expm(a * t) @ rest for t in run.time_s])
    assert np.abs(run.motor_current_a - exact[:, 0]).max() < 1e-6 * 35
    assert np.abs(run.motor_speed_rad_s - exact[:, 1]).max() < 1e-6 * 1000


def test_energy_of_the_balance_is_the_integral_of_the_samples():
    run = simulate(paper.PARAMETERS, supply=SOURCE, cutting=paper.CUTTING, duration_s=1.0, rate_hz=20_000.0)
    energy = run.energy
    t = run.time_s
    assert np.trapezoid(run.motor_voltage_v * run.motor_current_a, t) == pytest.approx(energy.electrical_in_j, rel=1e-6)
    assert np.trapezoid(0.176 * run.motor_current_a**2, t) == pytest.approx(energy.copper_j, rel=1e-6)
    power = -run.force_n * run.blade_velocity_m_s  # cuts on pi..2pi, where the displacement falls
    assert np.trapezoid(power, t) == pytest.approx(energy.cutting_j, rel=1e-5)
    parts = energy.copper_j + energy.damping_j + energy.cutting_j + energy.conversion_j + energy.stored_j
    assert parts == pytest.approx(energy.electrical_in_j, rel=1e-6)


def test_mirrored_cutting_half_is_the_same_machine_half_a_turn_later():
    late = InitialState(crank_angle_rad=math.pi)
    one = simulate(paper.PARAMETERS, supply=SOURCE, cutting=paper.CUTTING, duration_s=0.7)
    other = LinearCutting(k_fc_n_s_per_m=240.29, cutting_half="zero_to_pi")
    two = simulate(paper.PARAMETERS, supply=SOURCE, cutting=other, duration_s=0.7, initial=late)
    assert np.allclose(one.motor_current_a, two.motor_current_a, atol=1e-10)
    assert np.allclose(one.force_n, two.force_n, atol=1e-7)
    assert np.allclose(one.displacement_m + two.displacement_m, 0.02, atol=1e-10)


def _wall(newtons):
    angle = 2 * np.pi * np.arange(32) / 32
    return MeasuredForce(force_n=np.where(angle > np.pi, newtons * np.abs(np.sin(angle)), 0.0))


def test_force_that_the_motor_cannot_overcome_stalls_it():
    weak = FixedVoltage(voltage_v=2.0)
    run = simulate(paper.PARAMETERS, supply=weak, cutting=_wall(900.0), duration_s=3.0)
    assert run.status == "stalled" and "force_n" in run.message
    assert run.motor_speed_rad_s[-1] == 0.0
    assert run.motor_current_a[-1] == pytest.approx(2.0 / 0.176, rel=1e-6)
    # It stands where the load holds what the stalled motor gives.
    torque = 5.632e-3 * (2.0 / 0.176) * 56 / 6
    angle = run.crank_angle_rad[-1]
    assert np.pi < angle < 2 * np.pi
    assert _wall(900.0).force_at([angle])[0] * 0.01 * abs(math.sin(angle)) >= torque * 0.999
    assert steady_state(paper.PARAMETERS, supply=weak, cutting=_wall(900.0)).status == "stalled"


def test_a_crank_at_rest_waits_until_the_current_has_risen():
    """The load holds the crank until k_m i exceeds it; the current follows its exponential until then."""
    angle = 1.5 * np.pi
    run = simulate(
        paper.PARAMETERS,
        supply=SOURCE,
        cutting=_wall(60.0),
        duration_s=0.05,
        rate_hz=100_000.0,
        initial=InitialState(crank_angle_rad=angle),
    )
    needed = 60.0 * 0.01 / (56 / 6) / 5.632e-3
    release = -(3.21e-3 / 0.176) * math.log(1 - needed * 0.176 / SOURCE.voltage_v)
    before = run.time_s < release - 1e-5
    assert (run.motor_speed_rad_s[before] == 0.0).all()
    assert (run.motor_speed_rad_s[run.time_s > release + 1e-3] > 0.0).all()
    assert run.motor_current_a[before][-1] == pytest.approx(needed, rel=2e-3)


@pytest.mark.parametrize("volts", [1e-9, 0.5, paper.MOTOR_VOLTAGE_V])
@pytest.mark.parametrize("n_n", [0.0, 30.0, 3000.0])
def test_interpreted_is_the_same_as_compiled(volts, n_n):
    """At rest, stalled and running, with a force that follows the angle."""
    angle = np.arange(64) * math.pi / 32
    setting = {
        "supply": HeldVoltage(voltage_v=volts, battery=paper.BATTERY),
        "cutting": MeasuredForce(force_n=n_n * np.maximum(-np.sin(angle), 0.0)),
        "duration_s": 0.3,
        "initial": InitialState(crank_angle_rad=2.0),
    }
    one, other = (simulate(paper.PARAMETERS, **setting, compiles=compiles) for compiles in (True, False))
    assert other.status == one.status
    assert np.abs(other.motor_current_a - one.motor_current_a).max() <= 1e-10 * max(volts / 0.176, 1e-9)
    assert np.abs(other.crank_angle_rad - one.crank_angle_rad).max() < 1e-9


def test_samples_do_not_depend_on_the_sampling():
    coarse = simulate(paper.PARAMETERS, supply=SOURCE, cutting=paper.CUTTING, duration_s=0.5, rate_hz=100.0)
    fine = simulate(paper.PARAMETERS, supply=SOURCE, cutting=paper.CUTTING, duration_s=0.5, rate_hz=5000.0)
    odd = simulate(paper.PARAMETERS, supply=SOURCE, cutting=paper.CUTTING, time_s=[0.123456, 0.4])
    assert np.allclose(coarse.motor_current_a, fine.motor_current_a[::50], rtol=1e-9, atol=1e-6)
    assert odd.motor_current_a[1] == pytest.approx(coarse.motor_current_a[40], abs=1e-6)


def test_battery_runs_empty():
    tiny = Eq16Battery(nominal_voltage_v=18.0, capacity_ah=0.001, shape_capacity_ah=0.003, beta=0.5)
    run = simulate(paper.PARAMETERS, supply=FixedDuty(duty=0.4, battery=tiny), cutting=paper.CUTTING, duration_s=3.0)
    assert run.status == "battery_empty"


plant_numbers = st.fixed_dictionaries(
    {
        "resistance_ohm": st.floats(0.03, 1.0),
        "inductance_h": st.floats(1e-4, 1e-2),
        "rotor_inertia_kg_m2": st.floats(5e-6, 2e-4),
        "reciprocating_mass_kg": st.floats(0.0, 1.0),
        "crank_radius_m": st.floats(0.004, 0.02),
        "motor_damping_n_m_s_per_rad": st.floats(0.0, 5e-5),
        "gear_ratio": st.floats(3.0, 20.0),
    }
)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(plant_numbers, st.floats(0.0, 600.0), st.floats(1.0, 20.0))
def test_any_machine_keeps_its_energy_and_its_accuracy(numbers, k_fc, voltage):
    parameters = paper.PARAMETERS.replace(**numbers)
    kwargs = {
        "supply": FixedVoltage(voltage_v=voltage),
        "cutting": LinearCutting(k_fc_n_s_per_m=k_fc),
        "duration_s": 0.4,
    }
    run = simulate(parameters, **kwargs)
    fine = simulate(parameters, method=Method(angle_tolerance=1e-10, time_tolerance=1e-11), **kwargs)
    assert run.status == "ok"
    assert abs(run.energy.closure_error) < 1e-5
    stall_current = voltage / parameters.resistance_ohm
    assert np.sqrt(np.mean((run.motor_current_a - fine.motor_current_a) ** 2)) < 1e-6 * stall_current
    assert (np.diff(run.crank_angle_rad) >= -1e-12).all()


@pytest.mark.parametrize("name", slots.PLANT_NAMES[:-1])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf, "much"])
def test_nonsense_parameters_are_named(name, value):
    with pytest.raises(InputError, match=name):
        paper.PARAMETERS.replace(**{name: value})


def test_nonsense_parts_and_times_are_named():
    for make, name in (
        (lambda: Eq16Battery(nominal_voltage_v=18.0, capacity_ah=1.5, beta=1.0), "beta"),
        (lambda: LinearCutting(k_fc_n_s_per_m=-1.0), "k_fc_n_s_per_m"),
        (lambda: LinearCutting(k_fc_n_s_per_m=1.0, cutting_half="both"), "cutting_half"),
        (lambda: MeasuredForce(force_n=[0.0, math.nan] * 8), "force_n .* node 1"),
        (lambda: MeasuredForce(force_n=[0.0] * 9), "even number of nodes"),
        (lambda: FixedDuty(duty=1.5, battery=paper.BATTERY), "duty"),
        (lambda: paper.PARAMETERS.replace(mechanism="cam"), "mechanism"),
        (lambda: paper.PARAMETERS.replace(mechanism="slider_crank"), "rod_length_m"),
        (lambda: paper.PARAMETERS.replace(mechanism="slider_crank", rod_length_m=0.005), "rod_length_m"),
        (lambda: InitialState(motor_speed_rad_s=-1.0), "motor_speed_rad_s"),
        (lambda: InitialState(soc=1.2), "soc"),
        (lambda: Method(steps_per_turn=7), "steps_per_turn"),
        (lambda: _run(time_s=[0.1, 0.1]), "time_s"),
        (lambda: _run(duration_s=-1.0), "duration_s"),
        (_run, "duration_s or time_s"),
    ):
        with pytest.raises(InputError, match=name):
            make()


def _run(**kwargs):
    return simulate(paper.PARAMETERS, supply=SOURCE, cutting=paper.CUTTING, **kwargs)


def test_parameters_come_from_the_config_and_go_to_the_vector():
    text = (Path(__file__).parents[2] / "bench_config.toml").read_text(encoding="utf-8")
    plant = parse_config(text).plant()
    parameters = JigsawParameters.from_config(plant)
    assert parameters == replace(paper.PARAMETERS, gear_ratio=plant.gear_ratio)
    vector = parameters.to_vector()
    for name in slots.PLANT_NAMES[:-1]:
        assert vector[slots.INDEX[name]] == getattr(parameters, name)
