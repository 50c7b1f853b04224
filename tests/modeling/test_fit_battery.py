"""Battery fits: known cells come back, and the real ones predict their fast discharges."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.modeling.battery_fit import MeasuredDischarge, fit_battery, predict_discharge

from benchmarks import battery_cells

pytestmark = pytest.mark.unit

ROOT = Path(__file__).resolve().parents[2]
CELLS = Path(os.environ.get("SAWBENCH_SHARED", ROOT.parent / "shared" / "data")) / "pybop_cells"
needs_cells = pytest.mark.skipif(not CELLS.exists(), reason="the cell measurements are not here")


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


@pytest.mark.parametrize("model", ["eq16_free_r", "ocv_r"])
def test_fast_discharge_is_predicted_from_slow_ones(model):
    fit = fit_battery([cell(0.5), cell(2.5)], model=model)
    fast = cell(8.0)
    predicted = predict_discharge(fit, current_a=8.0, cutoff_voltage_v=2.8)
    assert predicted.status == "ok"
    assert predicted.duration_s == pytest.approx(fast.duration_s, rel=5e-3)
    assert predicted.delivered_ah == pytest.approx(fast.charge_a_s[-1] / 3600.0, rel=5e-3)


def test_tied_capacity_fits_worse_than_free():
    slow = cell(2.5)
    tied, free = fit_battery([slow], model="eq16"), fit_battery([slow], model="eq16_free")
    assert tied.rmse_v > 10.0 * free.rmse_v


def test_prediction_says_when_the_voltage_is_never_reached_or_missed_from_the_start():
    fit = fit_battery([cell(0.5), cell(2.5)], model="eq16_free_r")
    assert predict_discharge(fit, current_a=200.0, cutoff_voltage_v=2.8).status == "below_at_start"
    table = fit_battery([cell(0.5), cell(2.5)], model="ocv_r")
    assert predict_discharge(table, current_a=1e-6, cutoff_voltage_v=1.0).status == "never_reached"


def test_nonsense_is_refused_by_name():
    with pytest.raises(InputError, match="no discharge"):
        fit_battery([])
    with pytest.raises(InputError, match="model"):
        fit_battery([cell(1.0)], model="eq17")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="two different currents"):
        fit_battery([cell(1.0), cell(1.0)], model="eq16_free_r")
    with pytest.raises(InputError, match="delivers no charge"):
        MeasuredDischarge(time_s=[0, 1], current_a=[-1, -1], voltage_v=[4, 3])
    with pytest.raises(InputError, match="current_a"):
        predict_discharge(fit_battery([cell(1.0)]), current_a=-1.0, cutoff_voltage_v=2.5)


@needs_cells
def test_real_cells_fitted_slowly_predict_two_c():
    table = battery_cells.rows(battery_cells.read_cells(CELLS))
    chosen = [row for row in table if row["model"] == battery_cells.CHOSEN and row["rate"] == "2C"]
    errors = {row["temperature"]: row["error"] for row in chosen}
    assert not any(row["is_fitted"] for row in chosen)
    assert abs(errors["10"]) < 0.03
    assert abs(errors["25"]) < 0.03


@needs_cells
def test_page_of_the_real_cells_is_what_the_program_writes():
    table = battery_cells.rows(battery_cells.read_cells(CELLS))
    assert len(table) == 4 * 16
    assert (ROOT / "docs" / "battery.md").read_text(encoding="utf-8") == battery_cells.page(table)
