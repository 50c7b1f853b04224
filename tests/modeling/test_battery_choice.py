"""The battery model is chosen by what it says of withheld discharges; the cells are those of another equation."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.config import BatteryConfig
from sawbench.bench.errors import InputError, UntrustedResult
from sawbench.modeling.battery_choice import (
    battery_config,
    battery_table,
    choose_battery,
    miss_of,
    predicted_runtime_s,
)
from sawbench.modeling.battery_fit import BatteryFit, fit_battery
from sawbench.modeling.configured_battery import open_circuit_voltage
from sawbench.modeling.measured_discharge import MeasuredDischarge

from benchmarks import battery_cells
from tests.rigs.cells import shepherd_discharge

pytestmark = pytest.mark.unit

ROOT = Path(__file__).resolve().parents[2]
CELLS = Path(os.environ.get("SAWBENCH_SHARED") or ROOT.parent / "shared") / "data" / "pybop_cells"
needs_cells = pytest.mark.skipif(not CELLS.exists(), reason="the cell measurements are not here")
CURRENTS_A = (1.0, 2.0, 4.0, 8.0)


def measured(current_a: float, *, label: str | None = None, time_factor: float = 1.0, **of) -> MeasuredDischarge:
    time_s, current, voltage = shepherd_discharge(current_a, **of)
    return MeasuredDischarge(
        time_s=time_factor * time_s, current_a=current, voltage_v=voltage, label=label or f"{current_a:g} A",
        start_temperature_c=20.0 + current_a,
    )  # fmt: skip


@pytest.fixture(scope="module")
def choice():
    return choose_battery([measured(current_a, noise_v=0.002, seed=int(current_a)) for current_a in CURRENTS_A])


def test_an_unseen_discharge_lies_within_the_stated_uncertainty(choice):
    for current_a in (1.5, 3.0, 6.0):
        unseen = measured(current_a).ended_at(choice.cutoff_voltage_v)
        error = miss_of(choice.fit, unseen, choice.cutoff_voltage_v).runtime_error
        assert abs(error) < 1.96 * choice.chosen.rel_std


def test_withheld_means_fitted_to_the_others_alone(choice):
    others = [d for d in choice.discharges if d.label != "4 A"]
    fit = fit_battery(others, model=choice.chosen.model)
    left = next(d for d in choice.discharges if d.label == "4 A")
    stated = next(miss for miss in choice.chosen.withheld if miss.label == "4 A")
    assert stated.predicted_s == pytest.approx(predicted_runtime_s(fit, left, choice.cutoff_voltage_v))
    assert stated.measured_s == pytest.approx(left.duration_s)


def test_the_chosen_model_errs_least_and_its_uncertainty_is_no_less_than_its_errors(choice):
    taken = [trial for trial in choice.trials if not trial.refusal]
    assert choice.chosen.rel_std == min(trial.rel_std for trial in taken)
    rms = math.sqrt(np.mean([m.runtime_error**2 + m.voltage_error**2 for m in choice.chosen.withheld]))
    # Student's t for four discharges is 2.776 where the normal distribution has 1.960.
    assert choice.chosen.rel_std == pytest.approx(rms * 2.776 / 1.960, rel=1e-3)
    assert choice.chosen.largest_own_miss <= 0.05


def test_least_squares_of_the_curve_alone_is_refused_where_it_misses_its_own_runtime():
    cells = [measured(current_a) for current_a in CURRENTS_A]
    free = fit_battery([d.ended_at(3.0) for d in cells], model="eq16_free")
    own = [miss_of(free, d.ended_at(3.0), 3.0).runtime_error for d in cells]
    assert max(map(abs, own)) > 0.05
    with pytest.raises(UntrustedResult, match="eq16_free: does not reproduce its own data"):
        choose_battery(cells, models=["eq16_free"])
    # Nor does it help to allow that: withheld runtimes are missed by more than themselves.
    with pytest.raises(UntrustedResult, match="eq16_free: predicts no withheld discharge"):
        choose_battery(cells, models=["eq16_free"], largest_own_miss=0.9)


@pytest.mark.parametrize("wrong", [{"time_factor": 0.6}, {"start": 0.7}], ids=["wrong clock", "not full at the start"])
def test_a_discharge_that_contradicts_the_others_is_refused_by_name(wrong):
    cells = [measured(1.0), measured(2.0), measured(4.0, **wrong), measured(4.0, label="second 4 A"), measured(8.0)]
    with pytest.raises(UntrustedResult, match="does not reproduce its own data: runtime error of 4 A"):
        choose_battery(cells)


def test_a_model_that_misses_withheld_runtimes_by_more_than_themselves_is_refused():
    cells = [measured(1.0), measured(4.0, time_factor=0.55)]
    with pytest.raises(UntrustedResult, match="eq16: predicts no withheld discharge: u"):
        choose_battery(cells, models=["eq16"], largest_own_miss=1.0)


def test_what_cannot_be_judged_is_wrong_input():
    with pytest.raises(InputError, match="1 discharge is not enough"):
        choose_battery([measured(1.0)])
    with pytest.raises(InputError, match="1 A: runs from"):
        choose_battery([measured(1.0), measured(2.0)], cutoff_voltage_v=2.0)


def test_two_currents_leave_only_models_without_a_resistance():
    choice = choose_battery([measured(2.0), measured(4.0)])
    refused = {trial.model: trial.refusal for trial in choice.trials if not trial.withheld}
    assert set(refused) == {"eq16_free_r", "eq16_end_r", "ocv_r"}
    assert all("two different currents" in why for why in refused.values())


@pytest.mark.parametrize("model", ["eq16_end_r", "ocv_r"])
def test_the_table_is_the_fitted_battery(model):
    choice = choose_battery([measured(current_a) for current_a in CURRENTS_A], models=[model], largest_own_miss=0.5)
    config = BatteryConfig.model_validate(battery_config(choice))
    assert config.cutoff_voltage_v == pytest.approx(choice.cutoff_voltage_v, rel=1e-5)
    soc = np.linspace(0.02, 1.0, 60)
    charge = (1.0 - soc) * 3600.0 * config.capacity_ah
    voltage = open_circuit_voltage(config, soc) - config.internal_resistance_ohm * 3.0
    np.testing.assert_allclose(voltage, choice.fit.voltage_v(charge, 3.0), atol=0.006)
    assert config.fitted is not None
    assert config.fitted.current_a == (1.0, 8.0)
    assert config.fitted.temperature_c == (21.0, 28.0)
    assert config.fitted.cycle is None
    assert config.fitted.runtime_rel_std == pytest.approx(choice.chosen.rel_std, rel=1e-2)
    # From full to the cut-off the generator delivers a little less than its 2 Ah.
    assert config.capacity_ah == pytest.approx(1.97, abs=0.05)


def test_the_table_of_a_flat_battery_is_still_its_curve():
    flat = BatteryFit(
        model="eq16_end", nominal_voltage_v=3.3, beta=1.0 - 3.7e-7, capacity_ah=2.0, internal_resistance_ohm=0.0,
        rmse_v=0.0,
    )  # fmt: skip
    config = BatteryConfig.model_validate(battery_table(flat, 2.4) | {"cutoff_soc": 0.01})
    # Eq. 16 solved for 2.4 V: x = (1 - beta) V / (V_nom - beta V) = 9.87e-7 of the charge is left.
    assert config.capacity_ah == pytest.approx(2.0, rel=1e-5)
    assert 1.0 - config.beta == pytest.approx(3.7e-7, rel=1e-5)


@needs_cells
def test_real_cells_are_predicted_within_the_stated_uncertainty():
    cells = battery_cells.read_cells(CELLS)
    assert {name: list(rates) for name, rates in cells.items()} == {
        "0": ["0.1C", "0.5C", "1C", "2C"],
        "10": ["0.1C", "0.5C", "1C", "2C"],
        "25": ["0.1C", "0.5C", "1C", "2C"],
        "45": ["0.1C", "0.5C", "1C", "1.5C"],
    }
    # Known of these measurements: 35608, 6973, 3443.5 and 1749.6 s at 25 degC.
    measured_s = [d.duration_s for d in cells["25"].values()]
    assert measured_s == pytest.approx([35608.0, 6973.0, 3443.5, 1749.6], rel=1e-3)
    choice = battery_cells.choices({"25": cells["25"]})["25"]
    assert choice.chosen.rel_std < 0.05
    assert all(abs(miss.runtime_error) < 0.03 for miss in choice.chosen.withheld)
    assert {t.model for t in choice.trials if t.refusal} == {"eq16_free", "eq16_free_r"}


@needs_cells
@pytest.mark.slow
def test_page_of_the_real_cells_is_what_the_program_writes():
    cells = battery_cells.read_cells(CELLS)
    chosen, refusal = battery_cells.choices(cells), battery_cells.refused_together(cells)
    assert (ROOT / "docs" / "battery_cells.md").read_text(encoding="utf-8") == battery_cells.page(chosen, refusal)
