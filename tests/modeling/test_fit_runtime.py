"""Runtime: against an independent integration of the whole discharge, and how wide the interval is."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.config import BatteryConfig, PlantConfig
from sawbench.bench.errors import InputError
from sawbench.modeling.discharge import discharge
from sawbench.modeling.fit import fit_cutting_coefficient
from sawbench.modeling.machines import paper_jigsaw as paper
from sawbench.modeling.parts.eq16 import Eq16Battery
from sawbench.modeling.parts.linear import LinearCutting
from sawbench.modeling.results import ParameterEstimates
from sawbench.modeling.runtime import predict_runtime
from sawbench.modeling.supplies import FixedDuty, HeldVoltage
from sawbench.processing.measured_cycles import cycles_from_samples

from benchmarks import synthetic_trials as synthetic

pytestmark = pytest.mark.unit


TRUE = {name: value for name, (value, _) in synthetic.NOMINAL.items()}
PLANT = PlantConfig.model_validate(
    {name: {"nominal": v, "rel_std": s} for name, (v, s) in synthetic.NOMINAL.items()}
    | {"gear_ratio": synthetic.GEAR_RATIO}
)
SMALL = Eq16Battery(nominal_voltage_v=18.0, capacity_ah=0.05, beta=0.9, internal_resistance_ohm=0.02)
SUPPLY = FixedDuty(duty=0.4375, battery=SMALL)


@pytest.fixture(scope="module")
def independent():
    """Whole discharge of a small battery by the generator's own integrator."""
    run = synthetic.simulate(TRUE, np.full(3000, 240.0), 0.4375, 45.0, 1000.0, capacity_ah=0.05, beta=0.9)
    time_s, current, voltage, battery = run[0], run[1], run[5], run[6]
    return time_s, current, voltage, battery, np.cumsum(battery) * 1e-3


def test_runtime_matches_the_independent_discharge(independent):
    time_s, current, _, _, charge = independent
    end = float(np.interp(0.8 * 180.0, charge, time_s))
    found = predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=240.0)
    assert found.status == "ok"
    assert found.ended_by == "soc"
    assert found.runtime_s == pytest.approx(end, rel=2e-3)
    assert found.mean_battery_current_a == pytest.approx(144.0 / end, rel=2e-3)
    settled = (time_s > 1.0) & (time_s < end)
    assert found.mean_motor_current_a == pytest.approx(current[settled].mean(), rel=2e-3)


def test_runtime_to_a_voltage_matches_too(independent):
    _, _, voltage, _, _ = independent
    means = voltage[: len(voltage) // 1000 * 1000].reshape(-1, 1000).mean(axis=1)
    cutoff = 16.9
    end = float(np.interp(-cutoff, -means, np.arange(len(means)) + 0.5))
    found = predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=240.0, cutoff_voltage_v=cutoff)
    assert found.ended_by == "voltage"
    assert found.runtime_s == pytest.approx(end, rel=0.01)
    assert found.runtime_s < predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=240.0).runtime_s


def test_interval_is_the_slope_times_the_uncertainty_of_k_fc():
    high = predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=246.0).runtime_s
    low = predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=234.0).runtime_s
    found = predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=240.0, k_fc_std=12.0)
    assert found.std_s == pytest.approx(low - high, rel=0.03)
    assert found.contributions_s["k_fc_n_s_per_m"] == pytest.approx(found.std_s)


def test_independent_plant_errors_add_in_squares():
    found = predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=240.0, k_fc_std=5.0, plant=PLANT)
    assert found.std_s == pytest.approx(math.hypot(*found.contributions_s.values()), rel=1e-9)
    assert found.contributions_s["torque_constant_n_m_per_a"] > found.contributions_s["inductance_h"]


def test_errors_that_keep_the_current_right_cancel():
    """k_Fc and k_m wrong together, as a fit to the current makes them."""
    names = ("k_fc_n_s_per_m", "torque_constant_n_m_per_a")
    std = np.array([0.03 * 240.0, 0.03 * 0.005632])
    together = ParameterEstimates(
        names=names,
        values=np.array([240.0, 0.005632]),
        prior_std=np.array([np.inf, std[1]]),
        covariance=np.outer(std, std),
    )
    apart = ParameterEstimates(
        names=names, values=together.values, prior_std=together.prior_std, covariance=np.diag(std**2)
    )
    joint = predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=240.0, estimates=together)
    naive = predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=240.0, estimates=apart)
    assert joint.std_s < 0.25 * naive.std_s


def test_interval_with_the_fits_covariance_holds_the_true_runtime():
    battery = BatteryConfig(nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.99, internal_resistance_ohm=0.02)
    z = []
    for seed in range(8):
        trial = synthetic.synthetic_trial(300 + seed, seconds=5.0)
        cycles = cycles_from_samples(
            trial.angle_time_s,
            trial.angle_rad,
            trial.speed_rad_s,
            trial.channels,
            start_s=1.5,
            duty=trial.duty,
        )
        fit = fit_cutting_coefficient(cycles, plant=PLANT, battery=battery)
        found = predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=fit.k_fc_n_s_per_m, estimates=fit.estimates)
        truth = discharge(
            paper.PARAMETERS.replace(**trial.true_plant),
            supply=SUPPLY,
            cutting=LinearCutting(k_fc_n_s_per_m=trial.true_k_fc),
        )
        z.append((found.runtime_s - truth.runtime_s) / found.std_s)
        assert found.std_s < 0.02 * found.runtime_s
    assert np.abs(z).max() < 3.3
    assert np.mean(np.square(z)) < 2.4


def test_appendix_a_beside_it():
    supply = FixedDuty(duty=0.4375, battery=Eq16Battery(nominal_voltage_v=18.0, capacity_ah=0.05, beta=0.9))
    found = predict_runtime(paper.PARAMETERS, supply=supply, k_fc=240.0, measured_mean_battery_current_a=4.0)
    assert found.appendix_a_runtime_s == pytest.approx(0.8 * 180.0 / 4.0)


def test_harder_wood_and_more_duty_cost_runtime_and_capacity_gives_it():
    def runtime_s(k_fc, duty, capacity_ah):
        supply = FixedDuty(duty=duty, battery=replace(SMALL, capacity_ah=capacity_ah))
        found = predict_runtime(paper.PARAMETERS, supply=supply, k_fc=k_fc)
        assert found.status == "ok"
        return found.runtime_s

    usual = runtime_s(240.0, 0.45, 0.03)
    assert runtime_s(900.0, 0.45, 0.03) < runtime_s(430.0, 0.45, 0.03) < usual
    assert runtime_s(240.0, 0.6, 0.03) < usual < runtime_s(240.0, 0.3, 0.03)
    assert runtime_s(240.0, 0.45, 0.06) == pytest.approx(2.0 * usual, rel=0.05)


def test_a_supply_that_never_empties_the_battery_is_a_status():
    weak = FixedDuty(duty=1e-6, battery=SMALL)
    found = predict_runtime(paper.PARAMETERS, supply=weak, k_fc=240.0)
    assert found.status in ("cannot_start", "never_reached")
    assert math.isnan(found.runtime_s)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"k_fc": -1.0}, "k_fc"),
        ({"k_fc": math.nan}, "k_fc"),
        ({"k_fc_std": -1.0}, "k_fc_std"),
        ({"cutoff_soc": 1.0}, "cutoff_soc"),
        ({"cutoff_voltage_v": -3.0}, "cutoff_voltage_v"),
        ({"measured_mean_battery_current_a": 0.0}, "measured_mean_battery_current_a"),
    ],
)
def test_nonsense_is_refused_by_name(change, message):
    with pytest.raises(InputError, match=message):
        predict_runtime(
            paper.PARAMETERS,
            **({"supply": HeldVoltage(voltage_v=7.9, battery=SMALL), "k_fc": 240.0} | change),
        )


def test_estimates_of_another_kind_are_refused():
    other = ParameterEstimates(
        names=("resistance_ohm",), values=np.array([0.2]), prior_std=np.array([0.1]), covariance=np.eye(1)
    )
    with pytest.raises(InputError, match="k_fc_n_s_per_m"):
        predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=240.0, estimates=other)
