"""Discharges: the paper's runtime, averaging against every stroke, cut-offs, stalls."""

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.modeling.discharge import discharge
from sawbench.modeling.discharge_kernel import start_up
from sawbench.modeling.machine import machine
from sawbench.modeling.machines import paper_jigsaw as paper
from sawbench.modeling.parts.eq16 import Eq16Battery
from sawbench.modeling.parts.linear import LinearCutting
from sawbench.modeling.parts.measured import MeasuredForce
from sawbench.modeling.parts.ocv_table import TableBattery
from sawbench.modeling.supplies import FixedDuty, FixedVoltage, HeldVoltage
from sawbench.modeling.transient import InitialState, model_vector, simulate
from sawbench.modeling.transient_kernel import NO_CONVERGENCE

pytestmark = pytest.mark.unit

EQ16 = Eq16Battery(nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.95, internal_resistance_ohm=0.02)
DUTY = FixedDuty(duty=paper.DUTY, battery=EQ16)
HELD = HeldVoltage(voltage_v=paper.MOTOR_VOLTAGE_V, battery=EQ16)
SHAPE = MeasuredForce(force_n=250 * np.maximum(-np.sin(2 * np.pi * np.arange(64) / 64), 0.0) ** 1.1)


def test_the_papers_runtime():
    held = HeldVoltage(voltage_v=paper.MOTOR_VOLTAGE_V, battery=paper.BATTERY)
    run = discharge(paper.PARAMETERS, supply=held, cutting=paper.CUTTING)
    assert run.runtime_s == pytest.approx(927.0, abs=1.0)
    assert run.status == "ok" and run.ended_by == "soc"


@pytest.mark.parametrize("method", ["multi_scale", "brute_force"])
def test_the_measured_reference_of_a_fixed_duty(method):
    """994.389 s was measured for this reading (cutting on 0..pi) with the peers, outside this project."""
    cutting = LinearCutting(k_fc_n_s_per_m=240.29, cutting_half="zero_to_pi")
    run = discharge(paper.PARAMETERS, supply=DUTY, cutting=cutting, method=method)
    assert run.runtime_s == pytest.approx(994.389, rel=2e-6)


@pytest.mark.parametrize("supply", [DUTY, HELD], ids=["duty", "held"])
@pytest.mark.parametrize("cutting", [paper.CUTTING, SHAPE], ids=["linear", "measured"])
@pytest.mark.parametrize("cutoff", [{}, {"cutoff_soc": 0.1}, {"cutoff_voltage_v": 16.8}], ids=["20 %", "10 %", "volts"])
def test_averaging_agrees_with_every_stroke_and_says_its_error(supply, cutting, cutoff):
    fine_steps = 40 if cutting is paper.CUTTING else 128
    fine = discharge(
        paper.PARAMETERS,
        supply=supply,
        cutting=cutting,
        method="brute_force",
        steps_per_turn=fine_steps,
        **cutoff,
    )
    fast = discharge(paper.PARAMETERS, supply=supply, cutting=cutting, **cutoff)
    brute = discharge(paper.PARAMETERS, supply=supply, cutting=cutting, method="brute_force", **cutoff)
    assert fast.ended_by == fine.ended_by == ("voltage" if "cutoff_voltage_v" in cutoff else "soc")
    assert fast.runtime_s == pytest.approx(fine.runtime_s, rel=3e-6)
    assert brute.runtime_s == pytest.approx(fine.runtime_s, rel=2e-6)
    assert fast.numerical_error_s < 1e-5 * fast.runtime_s
    assert fast.mean_battery_current_a == pytest.approx(fine.mean_battery_current_a, rel=1e-4)
    assert fast.mean_motor_current_a == pytest.approx(fine.mean_motor_current_a, rel=2e-3)  # the start-up's share


@pytest.mark.parametrize("k_fc", [240.0, 420.0, 500.0, 1000.0])
def test_strokes_that_nearly_stop_the_crank_count_too(k_fc):
    """In a hard cut the speed changes too much within an angle step: all strokes are run as starts are, in time."""
    cutting = LinearCutting(k_fc_n_s_per_m=k_fc)
    run = discharge(paper.PARAMETERS, supply=DUTY, cutting=cutting)
    whole = simulate(paper.PARAMETERS, supply=DUTY, cutting=cutting, time_s=np.array([0.0, run.runtime_s]))
    assert run.n_strokes == pytest.approx(whole.crank_angle_rad[-1] / (2.0 * np.pi), abs=2.0)
    easy = discharge(paper.PARAMETERS, supply=DUTY, cutting=LinearCutting(k_fc_n_s_per_m=100.0))
    ratio = easy.mean_motor_current_a / easy.mean_battery_current_a
    assert run.mean_motor_current_a / run.mean_battery_current_a == pytest.approx(ratio, rel=2e-3)


@pytest.mark.parametrize("cutoff", [{}, {"cutoff_voltage_v": 16.5}], ids=["charge", "volts"])
@pytest.mark.parametrize(
    ("inductance_h", "duty", "k_fc"), [(1e-4, 0.4375, 240.0), (1e-5, 0.4375, 240.0), (3.21e-3, 0.15, 500.0)]
)
def test_machines_whose_current_or_speed_decays_fast_need_finer_steps_alone(inductance_h, duty, k_fc, cutoff):
    """A coarse angle step cannot follow them; every stroke in time steps can."""
    how = {
        "supply": FixedDuty(duty=duty, battery=EQ16),
        "cutting": LinearCutting(k_fc_n_s_per_m=k_fc),
        **cutoff,
    }
    parameters = paper.PARAMETERS.replace(inductance_h=inductance_h)
    fast = discharge(parameters, **how)
    every = discharge(parameters, method="brute_force", **how)
    assert fast.ended_by == every.ended_by == ("voltage" if cutoff else "soc")
    assert fast.runtime_s == pytest.approx(every.runtime_s, rel=1e-4)
    assert fast.mean_motor_current_a == pytest.approx(every.mean_motor_current_a, rel=2e-3)
    assert fast.n_strokes == pytest.approx(every.n_strokes, abs=3.0)
    assert len(every.curves.time_s) > 0.9 * every.n_strokes
    if inductance_h < 1e-3:
        # So small an inductance does not matter for a runtime.
        usual = discharge(paper.PARAMETERS, **how)
        assert fast.runtime_s == pytest.approx(usual.runtime_s, rel=1e-3)


@pytest.mark.parametrize("level_v", [17.2, 17.4, 17.5, 17.7])
def test_a_cut_off_voltage_of_a_battery_with_a_fine_table(level_v):
    """Where the curve has corners, many strokes are solved; the end is found between them, never beyond."""
    soc = np.linspace(0.0, 1.0, 46)
    corners = 0.01 * np.random.default_rng(5).standard_normal(len(soc))
    battery = TableBattery(
        soc=soc.tolist(),
        ocv_v=(17.0 + 3.0 * soc - 2.5 * np.exp(-soc / 0.05) + corners).tolist(),
        capacity_ah=0.5,
        internal_resistance_ohm=0.08,
    )
    how = {
        "supply": FixedDuty(duty=paper.DUTY, battery=battery),
        "cutting": paper.CUTTING,
        "cutoff_voltage_v": level_v,
        "cutoff_soc": 0.02,
    }
    fast = discharge(paper.PARAMETERS, **how)
    every = discharge(paper.PARAMETERS, method="brute_force", **how)
    assert fast.ended_by == every.ended_by == "voltage"
    assert fast.runtime_s == pytest.approx(every.runtime_s, rel=1e-3)


@pytest.mark.parametrize("k_fc", [500.0, 1e4, 1e9])
def test_a_start_that_does_not_get_calm_is_given_up(k_fc):
    """Interpreted, the 30 s of a start would take minutes."""
    vector, spline, ocv = model_vector(paper.PARAMETERS, DUTY, LinearCutting(k_fc_n_s_per_m=k_fc))
    took_s, *_, status = start_up(machine(vector), spline, ocv, (0.0, 0.0, 0.0, 1.0), 10, 1e-9, True)
    assert status == NO_CONVERGENCE
    assert took_s < 5.0


def test_curves_agree():
    fast = discharge(paper.PARAMETERS, supply=DUTY, cutting=paper.CUTTING).curves
    every = discharge(paper.PARAMETERS, supply=DUTY, cutting=paper.CUTTING, method="brute_force").curves
    assert (np.diff(fast.time_s) > 0).all() and (np.diff(fast.soc) < 0).all()
    inside = slice(1, -1)
    for name in ("soc", "battery_voltage_v", "battery_current_a", "motor_current_a", "stroke_rate_hz"):
        expected = np.interp(fast.time_s[inside], every.time_s, getattr(every, name))
        assert getattr(fast, name)[inside] == pytest.approx(expected, rel=1e-5), name


def test_soc_is_the_charge_drawn():
    run = discharge(paper.PARAMETERS, supply=HELD, cutting=paper.CUTTING)
    assert run.mean_battery_current_a * run.runtime_s == pytest.approx(0.8 * 1.5 * 3600, rel=1e-9)


def test_a_battery_that_cannot_turn_the_machine_over():
    wall = MeasuredForce(force_n=3000 * np.maximum(-np.sin(2 * np.pi * np.arange(32) / 32), 0.0))
    run = discharge(paper.PARAMETERS, supply=FixedDuty(duty=0.1, battery=EQ16), cutting=wall)
    assert run.status == "cannot_start" and run.ended_by == "stall"
    assert "force_n" in run.message


def test_a_load_that_the_sagging_battery_can_no_longer_turn():
    soft = Eq16Battery(nominal_voltage_v=18.0, capacity_ah=0.2, beta=0.2, internal_resistance_ohm=0.02)
    wall = MeasuredForce(force_n=150 * np.maximum(-np.sin(2 * np.pi * np.arange(32) / 32), 0.0))
    run = discharge(paper.PARAMETERS, supply=FixedDuty(duty=0.44, battery=soft), cutting=wall, cutoff_soc=0.05)
    assert run.status == "stalled" and run.ended_by == "stall"
    assert 0 < run.runtime_s < 200


def test_discharge_of_a_battery_with_a_table():
    battery = TableBattery(
        soc=[0.0, 0.2, 0.5, 1.0],
        ocv_v=[14.0, 17.0, 18.0, 20.0],
        capacity_ah=0.3,
        internal_resistance_ohm=0.02,
    )
    kwargs = {"supply": FixedDuty(duty=paper.DUTY, battery=battery), "cutting": paper.CUTTING}
    fast = discharge(paper.PARAMETERS, **kwargs)
    every = discharge(paper.PARAMETERS, method="brute_force", **kwargs)
    assert fast.runtime_s == pytest.approx(every.runtime_s, rel=1e-4)


def test_nonsense_cut_offs_are_named():
    for kwargs, name in (
        ({"cutoff_soc": 1.0}, "cutoff_soc"),
        ({"cutoff_soc": 0.5, "initial": InitialState(soc=0.4)}, "cutoff_soc"),
        ({"cutoff_voltage_v": -3.0}, "cutoff_voltage_v"),
        ({"supply": FixedVoltage(voltage_v=8.0)}, "battery"),
    ):
        with pytest.raises(InputError, match=name):
            discharge(paper.PARAMETERS, **{"supply": DUTY, "cutting": paper.CUTTING, **kwargs})
