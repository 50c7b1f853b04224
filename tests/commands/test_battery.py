"""`sawbench battery fit`: from a tester's tables to a runtime that knows its battery."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from sawbench.bench.config import load_config
from sawbench.commands.battery import VARIANTS
from sawbench.commands.main import main
from sawbench.modeling.battery_fit import BatteryModel
from scipy.io import savemat

from tests.rigs.cells import shepherd_discharge

pytestmark = pytest.mark.pipeline

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / "bench_config.toml"


def rate_table(folder: Path, current_a: float, **of) -> Path:
    """Table of one discharge as a tester exports it, every tenth sample and the last one."""
    path = folder / f"rate-{current_a:g}A.csv"
    rows = list(zip(*shepherd_discharge(current_a, **of), strict=True))
    lines = ["Test_Time(s),Current(A),Voltage(V),Temperature(C),Cycle_Index"]
    lines += [f"{t:.3f},{-i:.4f},{v:.5f},21.5,4" for t, i, v in [*rows[:-1:10], rows[-1]]]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_fitted_battery_reaches_the_runtime(tmp_path, capsys):
    tables = [str(rate_table(tmp_path, current_a)) for current_a in (1.0, 3.0, 6.0)]
    out = tmp_path / "fitted.toml"
    assert main(["battery", "fit", *tables, "--config", str(SHIPPED), "--series", "5", "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "is chosen" in shown
    assert "the current is negative on discharge" in shown
    battery = load_config(out).battery()
    assert battery.cutoff_soc == load_config(SHIPPED).battery().cutoff_soc
    assert battery.fitted is not None
    assert battery.fitted.current_a == (1.0, 6.0)
    assert battery.fitted.temperature_c == (21.5, 21.5)
    assert battery.fitted.cycle == (4.0, 4.0)
    # Five cells of 4.1 V in a row; they deliver 1.97 Ah until 3 V.
    assert 19.5 < battery.nominal_voltage_v < 21.5
    assert battery.capacity_ah == pytest.approx(1.97, abs=0.06)
    page = out.with_suffix(".html").read_text(encoding="utf-8")
    assert "rate-3A" in page
    assert page.count("<script") == 1

    assert main(["runtime", "--k-fc", "240", "--config", str(out), "--temperature", "-10", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    charge_ah = found["runtime_s"] * found["mean_battery_current_a"] / 3600.0
    assert charge_ah == pytest.approx(0.8 * battery.capacity_ah, rel=1e-3)
    assert found["contributions_s"]["battery_fit"] == pytest.approx(battery.fitted.runtime_rel_std * found["runtime_s"])
    assert any("temperature -10 degC" in note for note in found["notes"])


def test_a_testers_mat_files_are_fitted_without_a_map(tmp_path, capsys):
    """Structs as one common cycler exports them: meas.Time, .Voltage, .Current, .Battery_Temp_degC; cells of text."""
    tables = []
    for current_a in (1.0, 3.0, 6.0):
        time_s, current, voltage = (v[::10] for v in shepherd_discharge(current_a))
        told = {"Time": time_s, "Current": -current, "Voltage": voltage, "Ah": -np.cumsum(current)}
        told |= {"Battery_Temp_degC": np.full(len(time_s), 24.5), "TimeStamp": np.array(["noon"] * 3, dtype=object)}
        tables.append(tmp_path / f"rate-{current_a:g}.mat")
        savemat(tables[-1], {"meas": told})
    out = tmp_path / "battery.toml"
    assert main(["battery", "fit", *map(str, tables), "--series", "5", "--out", str(out)]) == 0
    assert "meas.Battery_Temp_degC" in capsys.readouterr().out
    (battery,) = tomllib.loads(out.read_text(encoding="utf-8")).values()
    assert battery["fitted"]["temperature_c"] == [24.5, 24.5]
    assert battery["fitted"]["current_a"] == [1.0, 6.0]
    # As from text: 1.97 Ah until 3 V; a tenth of the samples, so that a discharge may end 0.5 % early.
    assert battery["capacity_ah"] == pytest.approx(1.97, abs=0.06)


def test_every_model_can_be_asked_for():
    assert get_args(BatteryModel) == VARIANTS


def test_discharges_that_contradict_each_other_leave_no_file(tmp_path, capsys):
    tables = [str(rate_table(tmp_path, 1.0)), str(rate_table(tmp_path, 3.0, start=0.6)), str(rate_table(tmp_path, 6.0))]
    out = tmp_path / "battery.toml"
    assert main(["battery", "fit", *tables, "--out", str(out)]) == 1
    error = capsys.readouterr().err
    assert "does not reproduce its own data" in error
    assert "full charge" in error
    assert not out.exists()
    assert not out.with_suffix(".html").exists()


def test_nothing_is_overwritten_and_one_discharge_is_not_enough(tmp_path, capsys):
    one = str(rate_table(tmp_path, 2.0))
    out = tmp_path / "battery.toml"
    assert main(["battery", "fit", one, "--out", str(out)]) == 2
    assert "two discharges or more" in capsys.readouterr().err
    assert main(["battery", "fit", one, one, "--out", str(out)]) == 2
    assert "given more than once" in capsys.readouterr().err
    out.with_suffix(".html").write_text("mine", encoding="utf-8")
    assert main(["battery", "fit", one, "--out", str(out)]) == 2
    assert "already exists" in capsys.readouterr().err


def test_without_a_configuration_the_table_stands_alone(tmp_path, capsys):
    tables = [str(rate_table(tmp_path, current_a)) for current_a in (2.0, 4.0)]
    out = tmp_path / "battery.toml"
    assert main(["battery", "fit", *tables, "--variant", "eq16_end", "--out", str(out), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    written = tomllib.loads(out.read_text(encoding="utf-8"))
    assert list(written) == ["battery"]
    assert written == {"battery": shown["battery"]}
    assert [model["model"] for model in shown["models"]] == ["eq16_end"]
