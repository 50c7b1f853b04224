"""Discharges found in the log of a battery tester."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.modeling.measured_discharge import BatteryLog, MeasuredDischarge, common_cutoff, discharges_in

pytestmark = pytest.mark.unit


def battery_log(sign: float = -1.0, short: bool = False) -> BatteryLog:
    """Rest, discharge with a rest inside, charge, second discharge; 151 samples, one a minute."""
    steps = [
        (0.0, 5, 4.1, 4.1),
        (2.0, 20, 4.0, 3.6),
        (0.0, 5, 3.7, 3.75),
        (2.0, 20, 3.6, 3.0),
        (-1.0, 60, 3.2, 4.2),
        (2.0, 5 if short else 38, 4.0, 3.1),
        (0.0, 3, 3.3, 3.35),
    ]
    current = np.concatenate([np.full(n, i) for i, n, _, _ in steps])
    voltage = np.concatenate([np.linspace(a, b, n) for _, n, a, b in steps])
    n = len(current)
    return BatteryLog(
        time_s=60.0 * np.arange(n),
        current_a=sign * current,
        voltage_v=voltage,
        label="log",
        temperature_c=np.linspace(20.0, 30.0, n),
        cycle=np.where(np.arange(n) < 110, 7.0, 8.0),
    )


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_both_discharges_are_found_whatever_the_sign(sign):
    found, notes = discharges_in(battery_log(sign))
    assert [d.label for d in found] == ["log #1", "log #2"]
    # 45 samples a minute apart, the rest inside included; 40 of them carry 2 A.
    assert found[0].duration_s == 44 * 60.0
    assert (found[0].current_a >= 0).all()
    assert found[0].current_a.max() == 2.0
    assert found[1].duration_s == 37 * 60.0
    assert found[1].charge_a_s[-1] == pytest.approx(37 * 60.0 * 2.0)
    assert [d.cycle for d in found] == [7.0, 8.0]
    assert found[0].start_temperature_c == pytest.approx(20.0 + 10.0 * 5 / 150)
    assert any("sign was reversed" in note for note in notes) == (sign < 0)


def test_a_short_discharge_is_left_out_and_said():
    found, notes = discharges_in(battery_log(short=True))
    assert [d.label for d in found] == ["log"]
    assert any("left out 1" in note for note in notes)


def test_a_log_without_discharge_is_refused():
    log = battery_log()
    ones = np.ones(len(log.time_s))
    rising = BatteryLog(time_s=log.time_s, current_a=ones, voltage_v=np.sort(log.voltage_v), label="x")
    with pytest.raises(InputError, match="no discharge"):
        discharges_in(rising)
    idle = BatteryLog(time_s=log.time_s, current_a=0.0 * log.time_s, voltage_v=log.voltage_v, label="x")
    with pytest.raises(InputError, match="no discharge"):
        discharges_in(idle)


def test_a_discharge_ends_where_its_voltage_crosses_the_cutoff():
    whole = MeasuredDischarge(time_s=[0, 10, 20, 30], current_a=[2, 2, 2, 2], voltage_v=[4.0, 3.5, 2.5, 2.0], label="a")
    ended = whole.ended_at(3.0)
    assert ended.time_s.tolist() == [0.0, 10.0, 15.0]
    assert ended.voltage_v[-1] == 3.0
    assert ended.charge_a_s[-1] == 30.0
    for cutoff_v in (1.9, 4.1):
        with pytest.raises(InputError, match="does not reach the cut-off"):
            whole.ended_at(cutoff_v)


def test_the_common_cutoff_is_one_that_all_reach():
    ends = [2.5, 2.8, 2.6]
    cells = [MeasuredDischarge(time_s=[0, 1], current_a=[1, 1], voltage_v=[4.0, end], label="a") for end in ends]
    assert common_cutoff(cells) == 2.8


def test_nonsense_is_refused_by_name():
    with pytest.raises(InputError, match="delivers no charge"):
        MeasuredDischarge(time_s=[0, 1], current_a=[-1, -1], voltage_v=[4, 3])
    with pytest.raises(InputError, match="time_s decreases"):
        MeasuredDischarge(time_s=[1, 0], current_a=[1, 1], voltage_v=[4, 3])
