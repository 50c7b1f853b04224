"""The battery of a configuration, as a function of the charge and as a part of the model."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.config import BatteryConfig
from sawbench.modeling.configured_battery import battery_from_config, open_circuit_voltage
from sawbench.modeling.machines import paper_jigsaw as paper
from sawbench.modeling.runtime import predict_runtime
from sawbench.modeling.supplies import FixedDuty

pytestmark = pytest.mark.unit


def test_a_battery_table_and_the_part_made_of_it_agree():
    base = {"nominal_voltage_v": 20.0, "capacity_ah": 2.0}
    share = {"soc": [0.0, 0.5, 1.0], "share": [0.7, 0.9, 1.0]}
    for config in (base | {"beta": 0.9, "shape_ratio": 1.25}, base | {"open_circuit": share}):
        battery = BatteryConfig.model_validate(config)
        part = battery_from_config(battery)
        for soc in (0.0, 0.3, 0.5, 1.0):
            voltage = float(open_circuit_voltage(battery, soc))
            assert part.open_circuit_voltage_v(soc) == pytest.approx(voltage)
    assert float(open_circuit_voltage(battery, 0.5)) == pytest.approx(18.0)
    # Of Eq. 16 at 1/1.25 of its charge taken: x = 0.2.
    eq16 = BatteryConfig.model_validate(base | {"beta": 0.9, "shape_ratio": 1.25})
    assert float(open_circuit_voltage(eq16, 0.0)) == pytest.approx(20.0 * 0.2 / (1.0 - 0.9 * 0.8))


def test_a_table_made_of_eq16_gives_its_runtime():
    base = {"nominal_voltage_v": 18.0, "capacity_ah": 1.5, "internal_resistance_ohm": 0.02}
    soc = np.linspace(0.0, 1.0, 101)
    eq16 = BatteryConfig.model_validate(base | {"beta": 0.9, "shape_ratio": 1.2})
    share = open_circuit_voltage(eq16, soc) / 18.0
    table = BatteryConfig.model_validate(base | {"open_circuit": {"soc": soc.tolist(), "share": share.tolist()}})
    found = [
        predict_runtime(
            paper.PARAMETERS,
            supply=FixedDuty(duty=0.4375, battery=battery_from_config(config)),
            k_fc=240.0,
            cutoff_voltage_v=14.0,
            cutoff_soc=0.01,
        )
        for config in (eq16, table)
    ]
    assert [one.ended_by for one in found] == ["voltage", "voltage"]
    assert found[1].runtime_s == pytest.approx(found[0].runtime_s, rel=1e-4)
