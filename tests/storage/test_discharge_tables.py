"""Tables of battery testers: columns by their usual names, runs of one file by a map with stars."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.storage.importers import ColumnRule, TableMap
from sawbench.storage.importers.discharge_tables import read_discharge_tables
from scipy.io import savemat

pytestmark = pytest.mark.unit

ARBIN = """Data_Point,Test_Time(s),Step_Time(s),Cycle_Index,Current(A),Voltage(V),Temperature (C)_1
1,0.0,0.0,3,-2.0,4.10,23.5
2,10.0,10.0,3,-2.0,4.00,23.6
3,20.0,20.0,3,-2.0,,23.7
4,30.0,30.0,3,-2.0,3.90,23.8
"""
BIOLOGIC = "time/s\tEcell/V\t<I>/mA\tcycle number\n0,0\t4,10\t-500\t1\n10,0\t4,05\t-500\t1\n20,0\t4,00\t-500\t1\n"
NEWARE = "Total Time,Current(mA),Voltage(mV)\n00:00:00,-1500,4100\n00:01:00,-1500,4000\n00:02:00,-1500,3900\n"


def written(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_arbin_names_are_known_and_rows_with_an_empty_cell_left_out(tmp_path):
    (run,) = read_discharge_tables(written(tmp_path, "arbin.csv", ARBIN))
    assert run.label == "arbin"
    assert run.time_s.tolist() == [0.0, 10.0, 30.0]
    assert run.current_a.tolist() == [-2.0, -2.0, -2.0]
    assert run.voltage_v.tolist() == [4.1, 4.0, 3.9]
    assert run.cycle is not None
    assert run.cycle.tolist() == [3.0, 3.0, 3.0]


def test_biologic_units_behind_a_slash_count(tmp_path):
    (run,) = read_discharge_tables(written(tmp_path, "cell.txt", BIOLOGIC))
    assert run.current_a.tolist() == [-0.5, -0.5, -0.5]
    assert run.voltage_v.tolist() == [4.1, 4.05, 4.0]
    assert run.temperature_c is None


def test_neware_times_of_day_and_small_units_count(tmp_path):
    (run,) = read_discharge_tables(written(tmp_path, "cell.csv", NEWARE))
    assert run.time_s.tolist() == [0.0, 60.0, 120.0]
    assert run.current_a.tolist() == [-1.5, -1.5, -1.5]
    assert run.voltage_v.tolist() == pytest.approx([4.1, 4.0, 3.9])


@pytest.fixture
def rates(tmp_path):
    path = tmp_path / "rates.mat"
    runs = {
        name: {"t": 60.0 * np.arange(4), "i": np.full(4, i), "u": np.linspace(4.0, 3.0, 4)}
        for name, i in (("slow", 0.5), ("fast", 5.0))
    }
    savemat(path, {"cell": {"warm": runs}})
    return path


def star_map(group: str) -> TableMap:
    channels = {"time_s": "t", "battery_current_a": "i", "battery_voltage_v": "u"}
    return TableMap(columns={name: ColumnRule(column=f"{group}.{column}") for name, column in channels.items()})


def test_a_star_takes_one_run_after_the_other(rates):
    runs = read_discharge_tables(rates, star_map("warm.*"))
    assert {run.label: run.current_a[0] for run in runs} == {"rates slow": 0.5, "rates fast": 5.0}
    assert [run.label for run in read_discharge_tables(rates, star_map("*.fast"))] == ["rates warm"]


def test_what_cannot_be_found_is_one_clear_error(rates, tmp_path):
    with pytest.raises(InputError, match=r"no column matches 'cold\.\*\.t'"):
        read_discharge_tables(rates, star_map("cold.*"))
    with pytest.raises(InputError, match="no column found for time_s, battery_current_a, battery_voltage_v"):
        read_discharge_tables(rates)
    with pytest.raises(InputError, match="no column found for battery_current_a"):
        read_discharge_tables(written(tmp_path, "a.csv", "time_s,Voltage(V)\n0,4\n1,3\n"))
    half = TableMap(columns={"time_s": ColumnRule(column="t")})
    with pytest.raises(InputError, match="has no column for battery_current_a, battery_voltage_v"):
        read_discharge_tables(rates, half)


def test_several_columns_of_one_name_are_not_guessed_between(tmp_path):
    path = tmp_path / "rates.mat"
    run = {"time": np.arange(3.0), "current": np.ones(3), "voltage": np.arange(3.0)}
    savemat(path, {"a": run, "b": run})
    with pytest.raises(InputError, match="has 2 columns that may be time_s") as caught:
        read_discharge_tables(path)
    assert "'*.time'" in str(caught.value)


def test_runs_in_an_array_of_structs_are_taken_one_after_the_other(tmp_path):
    """As in cycling archives: cycle(k).data holds a charge, an impedance sweep without time, a discharge."""

    def run(current_a):
        return {"Time": 10.0 * np.arange(3), "Current_measured": np.full(3, current_a),
                "Voltage_measured": np.array([4.0, 3.9, 3.8])}  # fmt: skip

    cycle = np.empty(3, dtype=object)
    cycle[:] = [{"type": "charge", "data": run(1.5)}, {"type": "impedance", "data": {"Re": 0.1}},
                {"type": "discharge", "data": run(-2.0)}]  # fmt: skip
    path = tmp_path / "cell.mat"
    savemat(path, {"B1": {"cycle": cycle}})
    with pytest.raises(InputError, match=r"B1\.cycle\.\*\.data\.Time"):
        read_discharge_tables(path)
    of = {"time_s": "Time", "battery_current_a": "Current_measured", "battery_voltage_v": "Voltage_measured"}
    runs = read_discharge_tables(
        path, TableMap(columns={name: ColumnRule(column=f"B1.cycle.*.data.{c}") for name, c in of.items()})
    )
    assert {run.label: run.current_a.tolist() for run in runs} == {"cell 1": [1.5] * 3, "cell 3": [-2.0] * 3}
