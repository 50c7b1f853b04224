"""The what-if sweep: nothing dropped, everything visible."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.commands.main import main
from sawbench.modeling.runtime import RuntimeSweep
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
    with pytest.raises(InputError, match="exists already"):
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
