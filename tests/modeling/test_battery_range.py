"""A fitted battery widens the runtime and warns where it is used outside its range."""

from __future__ import annotations

import math

import pytest
from sawbench.bench.config import BatteryConfig
from sawbench.modeling.battery_range import BatteryUse, with_battery_fit
from sawbench.modeling.results import RuntimePrediction

pytestmark = pytest.mark.unit

FITTED = {"runtime_rel_std": 0.04, "current_a": [2.0, 8.0], "temperature_c": [15.0, 25.0], "cycle": [0, 50]}


def battery(**changes) -> BatteryConfig:
    eq16 = {"nominal_voltage_v": 18.0, "capacity_ah": 1.5, "beta": 0.9, "cutoff_soc": 0.2}
    return BatteryConfig.model_validate(eq16 | changes)


def prediction(current_a: float = 4.0, status: str = "ok") -> RuntimePrediction:
    return RuntimePrediction(
        runtime_s=1000.0, std_s=30.0, mean_battery_current_a=current_a, mean_motor_current_a=9.0,
        appendix_a_runtime_s=None, ended_by="soc", numerical_error_s=0.1, status=status,
        contributions_s={"k_fc_n_s_per_m": 30.0},
    )  # type: ignore[arg-type]  # fmt: skip


def test_the_interval_grows_by_the_stated_uncertainty():
    found = with_battery_fit(prediction(), battery(fitted=FITTED))
    assert found.std_s == pytest.approx(math.hypot(30.0, 40.0))
    assert found.contributions_s == {"k_fc_n_s_per_m": 30.0, "battery_fit": 40.0}
    assert found.notes == ()
    assert "2 to 8 A" in found.battery_basis


def test_a_battery_that_nobody_fitted_changes_nothing():
    assert with_battery_fit(prediction(), battery()) == prediction()
    assert with_battery_fit(prediction(status="stalled"), battery(fitted=FITTED)) == prediction(status="stalled")


@pytest.mark.parametrize(
    ("current_a", "use", "named"),
    [
        (1.5, {}, "mean battery current 1.5 A"),
        (9.0, {}, "mean battery current 9 A"),
        (4.0, {"temperature_c": -5.0}, "temperature -5 degC"),
        (4.0, {"temperature_c": 40.0}, "temperature 40 degC"),
        (4.0, {"cycle": 300.0}, "cycle 300"),
    ],
)
def test_what_lies_outside_is_named(current_a, use, named):
    found = with_battery_fit(prediction(current_a), battery(fitted=FITTED), BatteryUse(**use))
    (note,) = found.notes
    assert note.startswith(named)
    assert "extrapolated" in note


def test_just_beside_the_range_still_counts_as_inside():
    use = BatteryUse(temperature_c=27.0, cycle=55.0)
    assert with_battery_fit(prediction(8.2), battery(fitted=FITTED), use).notes == ()


def test_a_condition_that_the_fit_does_not_state_is_not_known():
    bare = {key: FITTED[key] for key in ("runtime_rel_std", "current_a")}
    (note,) = with_battery_fit(prediction(), battery(fitted=bare), BatteryUse(temperature_c=20.0)).notes
    assert "unknown" in note


def test_a_deeper_cutoff_than_the_discharges_is_named():
    fitted = FITTED | {"soc": [0.3, 1.0]}
    (note,) = with_battery_fit(prediction(), battery(fitted=fitted)).notes
    assert note.startswith("cut-off state of charge 0.2")
