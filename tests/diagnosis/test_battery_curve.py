"""A battery's own open-circuit curve: as far as it was seen, and parallel to the configured one beyond."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.config import BatteryConfig
from sawbench.diagnosis.answer.channel_gap import forecast
from sawbench.diagnosis.answer.hold_out import HoldOut
from sawbench.diagnosis.inference.battery_curve import SeenCurve
from sawbench.modeling.configured_battery import open_circuit_voltage

from tests.rigs.scattered_strokes import problem_of, strokes

EQUATION = BatteryConfig(nominal_voltage_v=18.0, capacity_ah=2.0, beta=0.97, internal_resistance_ohm=0.03)
TABLE = BatteryConfig.model_validate(
    {
        "nominal_voltage_v": 20.0, "capacity_ah": 4.0,
        "open_circuit": {"soc": [0.0, 0.1, 0.5, 1.0], "share": [0.7, 0.85, 0.9, 1.0]},
    }
)  # fmt: skip
# V per charge used, and what a full battery has in surplus.
OWN = {"open_circuit_voltage_slope_v": -1.5, "open_circuit_voltage_surplus_2_v": 0.1}
SEEN = 0.1


def own_v(used):
    return -1.5 * used + 0.1 * np.exp(-used / 0.01)


def written(battery, own):
    curve = SeenCurve(most_used_as=SEEN * 3600.0 * battery.capacity_ah)
    retuned = battery.model_dump(exclude_none=True, exclude_unset=True)
    return BatteryConfig.model_validate(curve.table(battery, retuned, own))


@pytest.mark.unit
@pytest.mark.parametrize("battery", [EQUATION, TABLE], ids=["equation", "table"])
def test_a_written_curve_is_the_seen_one_and_parallel_beyond(battery):
    found = written(battery, OWN)
    assert (found.capacity_ah, found.internal_resistance_ohm) == (battery.capacity_ah, battery.internal_resistance_ohm)
    used = np.linspace(0.0, 0.8, 161)
    more = open_circuit_voltage(found, 1.0 - used) - open_circuit_voltage(battery, 1.0 - used)
    assert more == pytest.approx(own_v(np.minimum(used, SEEN)), abs=0.01)


@pytest.mark.unit
def test_a_curve_that_would_rise_with_the_charge_used_is_written_flat():
    """A configuration wants a voltage that falls as the battery empties."""
    found = written(EQUATION, {"open_circuit_voltage_slope_v": 6.0})
    used = np.linspace(0.0, SEEN, 21)
    volts = open_circuit_voltage(found, 1.0 - used)
    assert np.all(np.diff(volts) <= 0.0)
    # Nobody can say more of it in a table that falls: it stays between what was seen full and at the end.
    assert 18.0 <= volts.min() <= volts.max() <= 18.6


@pytest.fixture(scope="module")
def two_batteries():
    """Every second trial is of another battery; each gives a little of its charge."""

    def of_battery(state):
        number = state.setting.index
        setting = replace(state.setting, battery=number % 2)
        return replace(state, setting=setting, charge_used_as=np.full_like(state.charge_used_as, 20.0 * number))

    return problem_of([of_battery(state) for state in strokes()])


@pytest.mark.pipeline
def test_the_trials_of_another_battery_are_predicted_with_its_voltage(two_batteries):
    name, size = "nominal_voltage_v of battery 2", 2.0
    k = two_batteries.names.index(name)
    problem = replace(two_batteries, data=two_batteries.data + size * two_batteries.nuisance[:, k])
    hold_out = HoldOut(problem)
    found = forecast(hold_out, hold_out.climb([]), [])
    more_v = size * two_batteries.prior_std[k]
    is_second = {p.setting.label: p.setting.battery == 1 for p in problem.parts}
    for cycle in found.cycles:
        volts = {model: cycle.predicted[model]["battery_voltage_v"].mean() for model in ("nominal", "retuned")}
        expected = more_v if is_second[cycle.label] else 0.0
        assert volts["retuned"] - volts["nominal"] == pytest.approx(expected, abs=0.25 * more_v)
