"""Battery fits: known cells come back and predict their fast discharges."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.modeling.battery_choice import predicted_runtime_s
from sawbench.modeling.battery_fit import fit_battery
from sawbench.modeling.measured_discharge import MeasuredDischarge

pytestmark = pytest.mark.unit


def cell(current_a: float, *, v=4.1, beta=0.9, q_ah=5.6, r=0.05, cut_v=2.8, noise=0.0) -> MeasuredDischarge:
    charge = np.linspace(0.0, q_ah * 3600.0, 3000)[:-1]
    soc = 1.0 - charge / (q_ah * 3600.0)
    voltage = v * soc / (1.0 - beta * (1.0 - soc)) - r * current_a
    keep = voltage > cut_v
    voltage = voltage[keep] + noise * np.random.default_rng(4).normal(size=keep.sum())
    return MeasuredDischarge(
        time_s=charge[keep] / current_a, current_a=np.full(keep.sum(), current_a), voltage_v=voltage
    )


def test_free_capacity_and_resistance_come_back_from_two_rates():
    fit = fit_battery([cell(0.5, noise=0.002), cell(2.5, noise=0.002)], model="eq16_free_r")
    assert fit.nominal_voltage_v == pytest.approx(4.1, rel=1e-3)
    assert fit.beta == pytest.approx(0.9, abs=2e-3)
    assert fit.capacity_ah == pytest.approx(5.6, rel=2e-3)
    assert fit.internal_resistance_ohm == pytest.approx(0.05, rel=0.02)
    assert fit.rmse_v == pytest.approx(0.002, rel=0.1)


@pytest.mark.parametrize("model", ["eq16_free_r", "eq16_end_r", "ocv_r"])
def test_fast_discharge_is_predicted_from_slow_ones(model):
    fit = fit_battery([cell(0.5), cell(2.5)], model=model)
    fast = cell(8.0)
    assert predicted_runtime_s(fit, fast, float(fast.voltage_v[-1])) == pytest.approx(fast.duration_s, rel=5e-3)


def test_tied_capacity_fits_worse_than_free():
    slow = cell(2.5)
    tied, free = fit_battery([slow], model="eq16"), fit_battery([slow], model="eq16_free")
    assert tied.rmse_v > 10.0 * free.rmse_v


def test_a_fit_does_not_depend_on_how_often_the_tester_logged():
    dense = cell(2.5)
    keep = np.unique(
        np.concatenate([np.arange(0, 200), np.arange(200, len(dense.time_s), 20), [len(dense.time_s) - 1]])
    )
    thinned = MeasuredDischarge(
        time_s=dense.time_s[keep], current_a=dense.current_a[keep], voltage_v=dense.voltage_v[keep]
    )
    for model in ("eq16", "eq16_end"):
        often, seldom = fit_battery([dense], model=model), fit_battery([thinned], model=model)
        assert seldom.nominal_voltage_v == pytest.approx(often.nominal_voltage_v, rel=1e-3)
        assert seldom.beta == pytest.approx(often.beta, abs=1e-3)


def test_a_model_that_ends_too_early_or_never_is_said_so_by_its_runtime():
    fit = fit_battery([cell(0.5), cell(2.5)], model="eq16_free_r")
    slow = cell(2.5)
    # 60 A over 0.05 Ohm leave 4.1 V less than the 2.8 V of the cut-off from the first sample.
    fast = MeasuredDischarge(time_s=slow.time_s, current_a=24.0 * slow.current_a, voltage_v=slow.voltage_v)
    assert predicted_runtime_s(fit, fast, 2.8) == 0.0
    # Never to -1 V: it is stopped at three times the measured runtime.
    assert predicted_runtime_s(fit, slow, -1.0) == pytest.approx(3.0 * slow.duration_s)


def test_nonsense_is_refused_by_name():
    with pytest.raises(InputError, match="no discharge"):
        fit_battery([])
    with pytest.raises(InputError, match="model"):
        fit_battery([cell(1.0)], model="eq17")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="two different currents"):
        fit_battery([cell(1.0), cell(1.0)], model="eq16_free_r")
