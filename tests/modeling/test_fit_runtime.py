"""Runtime: against an independent integration of the whole discharge, and how wide the interval is."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.config import BatteryConfig, PlantConfig
from sawbench.bench.correlated import covariance_of_means
from sawbench.bench.errors import InputError
from sawbench.modeling.discharge import discharge
from sawbench.modeling.fit import fit_cutting_coefficient
from sawbench.modeling.joint_fit import SensorPriors, fit_jointly
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
BATTERY = BatteryConfig(nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.99, internal_resistance_ohm=0.02)


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
        fit = fit_cutting_coefficient(cycles, plant=PLANT, battery=BATTERY)
        found = predict_runtime(
            paper.PARAMETERS, supply=SUPPLY, k_fc=fit.k_fc_n_s_per_m, estimates=fit.estimates, compiles=True
        )
        truth = discharge(
            paper.PARAMETERS.replace(**trial.true_plant),
            supply=SUPPLY,
            cutting=LinearCutting(k_fc_n_s_per_m=trial.true_k_fc),
            compiles=True,
        )
        z.append((found.runtime_s - truth.runtime_s) / found.std_s)
        assert found.std_s < 0.02 * found.runtime_s
    assert np.abs(z).max() < 3.3
    assert np.mean(np.square(z)) < 2.4


def test_interval_holds_the_true_runtime_where_strokes_are_correlated():
    """The scatter of the strokes is most of what is uncertain: sensors are exact, the plant is known well."""
    uncertain = [name for name in TRUE if name.startswith(("torque", "back_emf", "resistance", "motor_damping"))]
    known = {name: 0.5 * std if name in uncertain else 0.0 for name, (_, std) in synthetic.NOMINAL.items()}
    plant = PlantConfig.model_validate(
        {name: {"nominal": TRUE[name], "rel_std": std} for name, std in known.items()}
        | {"gear_ratio": synthetic.GEAR_RATIO}
    )
    exact = SensorPriors(
        force_gain_rel_std=0.0, current_gain_rel_std=0.0, voltage_gain_rel_std=0.0, angle_zero_std_rad=0.0,
        force_offset_std_n=0.0,
    )  # fmt: skip
    none = {"sensor_gain_std": 0.0, "voltage_gain_std": 0.0, "angle_zero_std_rad": 0.0, "force_offset_std_n": 0.0}
    rng, z = np.random.default_rng(17), []
    for seed in range(30):
        true = {name: value * (1 + known[name] * rng.normal()) for name, value in TRUE.items()}
        trial = synthetic.synthetic_trial(seed, seconds=8.0, correlation=0.5, plant=true, **none)
        cycles = cycles_from_samples(
            trial.angle_time_s, trial.angle_rad, trial.speed_rad_s, trial.channels, start_s=1.0, duty=trial.duty
        )
        estimates = fit_jointly([cycles], plant=plant, battery=BATTERY, sensors=exact).of_trial(0)
        found = predict_runtime(paper.PARAMETERS, supply=SUPPLY, k_fc=240.0, estimates=estimates, compiles=True)
        truth = discharge(
            paper.PARAMETERS.replace(**true), supply=SUPPLY, cutting=LinearCutting(k_fc_n_s_per_m=240.0), compiles=True
        )
        z.append((found.runtime_s - truth.runtime_s) / found.std_s)
    assert 0.5 < np.mean(np.square(z)) < 1.5


def test_strokes_whose_noise_cancels_leave_what_is_correlated():
    """The sum of two estimates has no noise of single strokes, which most of the scatter of each is."""
    rng, z = np.random.default_rng(3), []
    for _ in range(1000):
        slow, noise = synthetic.stroke_coefficients(rng, 150, 1.0, 1.0, 0.5) - 1.0, 2.0 * rng.normal(size=150)
        strokes = np.array([slow + noise, slow - noise]).T
        estimates = ParameterEstimates(
            names=("a", "b"), values=strokes.mean(axis=0), prior_std=np.full(2, np.inf),
            covariance=covariance_of_means(strokes), by_stroke=(strokes - strokes.mean(axis=0),),
        )  # fmt: skip
        z.append(estimates.values.sum() / estimates.std_along({"a": 1.0, "b": 1.0}))
    assert 0.91 < np.mean(np.abs(z) < 1.96) < 0.97


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
