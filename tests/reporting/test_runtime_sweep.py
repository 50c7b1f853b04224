"""The what-if sweep: nothing dropped, everything visible."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.commands.main import main
from sawbench.modeling.runtime_sweep import RuntimeSweep
from sawbench.reporting.runtime_sweep import draw_sweep, sweep_cells, sweep_rows, write_sweep_picture

pytestmark = pytest.mark.unit


@pytest.fixture
def sweep():
    shape = (3, 2, 2)
    runtime_s = np.arange(1.0, 13.0).reshape(shape) * 600.0
    status = np.full(shape, "ok", dtype="U16")
    status[2, 0, :], status[1, 1, 1] = "stalled", "cannot_start"
    runtime_s[status != "ok"] = np.nan
    return RuntimeSweep(
        k_fc_n_s_per_m=np.array([100.0, 200.0, 300.0]),
        duty=np.array([0.3, 0.6]),
        capacity_ah=np.array([1.5, 4.0]),
        runtime_s=runtime_s,
        mean_battery_current_a=np.where(np.isnan(runtime_s), np.nan, 5.0),
        status=status,
    )


def test_rows_hold_every_case_with_its_status(sweep):
    rows = sweep_rows(sweep)
    assert len(rows) == 12
    assert [row["status"] for row in rows].count("stalled") == 2
    for row in rows:
        assert (row["runtime_s"] is None) == (row["status"] != "ok")
    case = next(r for r in rows if (r["k_fc_n_s_per_m"], r["duty"], r["capacity_ah"]) == (200.0, 0.3, 4.0))
    assert case["runtime_s"] == 3600.0


def test_table_marks_what_has_no_runtime(sweep):
    headers, rows = sweep_cells(sweep, 1)
    assert headers == ["k_Fc / N·s/m", "duty 0.3", "duty 0.6"]
    assert rows == [["100", "1200 s", "2400 s"], ["200", "3600 s", "cannot start"], ["300", "stalls", "7200 s"]]


def test_picture_shows_every_line_and_every_case_without_a_runtime(sweep):
    figure = draw_sweep(sweep)
    figure.canvas.draw()
    assert [axis.get_title(loc="left") or axis.get_title() for axis in figure.axes] == ["1.5 Ah", "4 Ah"]
    for axis in figure.axes:
        low, high = axis.get_ylim()
        assert low == 0.0
        assert high > np.nanmax(sweep.runtime_s) / 60.0
    crosses = [sum(len(line.get_xdata()) for line in axis.lines if line.get_marker() == "x") for axis in figure.axes]
    assert crosses == [1, 2]


def test_picture_is_reproducible_and_not_overwritten(sweep, tmp_path):
    first = write_sweep_picture(tmp_path / "a.svg", sweep)
    second = write_sweep_picture(tmp_path / "b.svg", sweep)
    assert first.read_bytes() == second.read_bytes()
    assert write_sweep_picture(tmp_path / "a.png", sweep).read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(InputError, match="already exists"):
        write_sweep_picture(first, sweep)
    with pytest.raises(InputError, match="must end in"):
        write_sweep_picture(tmp_path / "a.bmp", sweep)


def test_command_agrees_with_the_single_prediction(tmp_path, capsys):
    table = tmp_path / "sweep.csv"
    asked = ["--k-fc-range", "120", "240", "2", "--duties", "0.4375", "--capacities", "1.5,3"]
    assert main(["runtime", "--k-fc", "240", "--sweep", *asked, "--csv", str(table), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(r["capacity_ah"], r["k_fc_n_s_per_m"]) for r in rows] == [(1.5, 120), (1.5, 240), (3, 120), (3, 240)]
    assert main(["runtime", "--k-fc", "240", "--json"]) == 0
    single = json.loads(capsys.readouterr().out)[0]
    assert rows[1]["runtime_s"] == pytest.approx(single["runtime_s"], rel=1e-6)
    with table.open() as file:
        written = list(csv.DictReader(file))
    assert [float(row["runtime_s"]) for row in written] == pytest.approx([r["runtime_s"] for r in rows])


def test_known_effects_and_a_fitted_battery_are_those_of_the_single_prediction(tmp_path, capsys):
    shipped = Path("bench_config.toml").read_text(encoding="utf-8")
    fitted = "fitted = { n_discharges = 4, runtime_rel_std = 0.04, current_a = [4.0, 6.0] }\n"
    effects = "[effects]\nguide_friction = { force_n = 5.1, std = 0.4 }\n"
    (tmp_path / "known.toml").write_text(
        shipped.replace("[cutting]", f"{fitted}{effects}[cutting]", 1), encoding="utf-8"
    )
    config = ["--config", str(tmp_path / "known.toml"), "--json"]
    asked = ["--k-fc-range", "120", "240", "2", "--duties", "0.4375", "--capacities", "1.5,3"]
    assert main(["runtime", "--k-fc", "240", "--sweep", *asked, *config]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert main(["runtime", "--k-fc", "240", *config]) == 0
    (single,) = json.loads(capsys.readouterr().out)
    assert rows[1]["runtime_s"] == pytest.approx(single["runtime_s"], rel=1e-4)
    shares = single["contributions_s"]
    assert rows[1]["effects_std_s"] == pytest.approx(shares["guide_friction.force_n"], rel=1e-3)
    assert rows[1]["battery_std_s"] == pytest.approx(shares["battery_fit"], rel=1e-3)
    assert rows[1]["note"] == ""
    assert rows[0]["note"].startswith("mean battery current 2.")
    assert rows[2]["note"].count("capacity 3 Ah lies outside the 1.5 Ah") == 1


def test_cases_outside_of_what_was_fitted_are_marked(sweep):
    sweep = replace(sweep, notes={(0, 0, 1): ("mean battery current 1 A lies outside",)})
    assert [row[1] for row in sweep_cells(sweep, 1)[1]] == ["1200 s*", "3600 s", "stalls"]
    assert [cell for row in sweep_cells(sweep, 0)[1] for cell in row if "*" in cell] == []
    assert [row["note"] for row in sweep_rows(sweep)].count("mean battery current 1 A lies outside") == 1
    hollow = [line for line in draw_sweep(sweep).axes[1].lines if line.get_markerfacecolor() == "white"]
    assert [tuple(line.get_xdata()) for line in hollow if len(line.get_xdata())] == [(100.0,)]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--duties", "0.3,1.5", "--sweep"], "--duties"),
        (["--capacities", "1.5,x", "--sweep"], "--capacities"),
        (["--k-fc-range", "300", "100", "5", "--sweep"], "--k-fc-range"),
        (["--duties", "0.3"], "--sweep"),
        (["--sweep", "--plot", "x.bmp"], ".svg"),
    ],
)
def test_wrong_options_are_named(options, words, capsys):
    assert main(["runtime", "--k-fc", "240", *options]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert "Traceback" not in said
