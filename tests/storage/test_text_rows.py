"""Rows of a text that are too short, a last line that was cut off, and the line of what is wrong."""

from __future__ import annotations

import re

import h5py
import numpy as np
import pytest
from sawbench.batteries import read_discharges
from sawbench.bench.errors import InputError
from sawbench.commands.main import main
from sawbench.storage.importers import TableMap, import_path
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.unit

N_ROWS = 1500
# As a logger writes them: remarks, decimal commas, a column of remarks that stays empty.
HEADER = "# logger 3\n# J. Meyer\n\ntime_s;force_n;displacement_mm;motor_current_a;remark\n"
ROWS = [f"0,{k:05d};-0,{12000 + k};1,{70000 + k};1{k:04d},5;" for k in range(N_ROWS)]


def taken_in(folder, text, table_map=None):
    (folder / "t.csv").write_text(text, encoding="utf-8", newline="")
    report = import_path(folder / "t.csv", folder / "out", table_map=table_map)
    return read_recording(report.paths[0]), report


def refused(folder, text):
    with pytest.raises(InputError) as caught:
        taken_in(folder, text)
    assert not (folder / "out").exists()
    return str(caught.value)


def text_of(rows, ending="\n"):
    return (HEADER + "\n".join(rows)).replace("\n", ending)


@pytest.mark.parametrize("row", [0, 7, 1200])
@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_a_row_without_one_of_its_cells_is_refused(row, ending, tmp_path):
    time, _, *others = ROWS[row].split(";")
    rows = [*ROWS[:row], ";".join([time, *others]), *ROWS[row + 1 :], ""]
    said = refused(tmp_path, text_of(rows, ending))
    assert f"t.csv, line {row + 5}: the row has 4 cells, the header has 5" in said


def test_rows_that_are_all_short_are_refused(tmp_path):
    said = refused(tmp_path, "time_s,force_n,displacement_mm\n0,1\n0.001,2\n0.002,3\n")
    assert "t.csv, line 2: the row has 2 cells, the header has 3" in said


def test_cells_between_spaces_are_counted(tmp_path):
    said = refused(tmp_path, "time_s force_n displacement_mm\n0.0  1  2\n0.1  2\n0.2  3  4\n")
    assert "t.csv, line 3: the row has 2 cells, the header has 3" in said


@pytest.mark.parametrize(
    "text",
    [
        "time_s,force_n,,\n0,1\n0.1,2,\n0.2,3,,\n",
        "time_s,force_n,remark\n0,1,\n\n# pause\n0.1,2,\n0.2,3,\n",
        'time_s,force_n,remark\n0,1,"one,\ntwo"\n0.1,2,\n0.2,3,\n',
        "time_s\tforce_n\tremark\n0\t1\t\n0.1\t2\t\n0.2\t3\t",
    ],
    ids=["columns without a name", "empty and comment lines", "a cell of two lines", "tabs, no line end"],
)
def test_rows_up_to_the_last_name_are_whole(text, tmp_path):
    recording, report = taken_in(tmp_path, text)
    assert recording.signal("force_n").values.tolist() == [1.0, 2.0, 3.0]
    assert not any("line" in warning for warning in report.warnings)


@pytest.mark.parametrize("end", [";", ""])
@pytest.mark.parametrize("n_characters", [3, 9, 12, 20, 27])
def test_a_last_line_that_was_cut_off_is_left_out(n_characters, end, tmp_path):
    cut = ROWS[-1][:n_characters].rstrip(";") + end * (n_characters < 27)
    recording, report = taken_in(tmp_path, text_of([*ROWS[:-1], cut]))
    assert f"t.csv: line {N_ROWS + 4}, the last one, is incomplete and left out: {cut!r}" in report.warnings
    assert {len(signal.values) for signal in recording.signals.values()} == {N_ROWS - 1}
    assert recording.signal("motor_current_a").values[-1] == 10000.5 + N_ROWS - 2


def test_a_short_last_line_is_left_out_with_its_line_end_too(tmp_path):
    recording, report = taken_in(tmp_path, text_of([*ROWS, "End of file", ""]))
    assert f"t.csv: line {N_ROWS + 5}, the last one, is incomplete and left out: 'End of file'" in report.warnings
    assert len(recording.signal("force_n").values) == N_ROWS


@pytest.mark.parametrize(
    ("end", "is_kept"), [("0.020,-200.12", False), ("0.020", False), ("0.020,-200.123", True), ("0.020,-2\n", True)]
)
def test_a_last_cell_without_all_of_its_digits_is_left_out(end, is_kept, tmp_path):
    lines = [f"0.{k:03d},-100.{k:03d}" for k in range(20)]
    recording, report = taken_in(tmp_path, "time_s,force_n\n" + "\n".join([*lines, end]))
    assert len(recording.signal("force_n").values) == 20 + is_kept
    assert any("line 22, the last one, is incomplete" in text for text in report.warnings) != is_kept


def test_import_warns_of_a_cut_line(tmp_path, capsys):
    (tmp_path / "t.csv").write_text(text_of([*ROWS[:-1], ROWS[-1][:21]]))
    assert main(["import", str(tmp_path / "t.csv"), "--out", str(tmp_path / "out")]) == 0
    assert f"warning: t.csv: line {N_ROWS + 4}, the last one" in capsys.readouterr().out


def test_a_battery_table_that_was_cut_off_is_said(tmp_path):
    rows = [f"{60 * k},-1.5,{4.1 - 0.02 * k:.3f}" for k in range(60)]
    (tmp_path / "t.csv").write_text("Test_Time(s),Current(A),Voltage(V)\n" + "\n".join([*rows, "3600,-1"]))
    _, notes = read_discharges([tmp_path / "t.csv"], None)
    assert "warning: t.csv: line 62, the last one, is incomplete and left out: '3600,-1'" in notes


def test_rows_that_a_map_drops_are_counted_where_a_line_is_named(tmp_path):
    mapped = TableMap.model_validate({"table": {"repeated_times": "drop"}})
    with pytest.raises(InputError, match=r"t\.csv, line 6: time_s does not increase: 0\.1 s is followed by 0\.05 s"):
        taken_in(tmp_path, "time_s,force_n\n0,1\n0,2\n\n0.1,3\n0.05,4\n", mapped)


def test_a_file_without_lines_has_rows(tmp_path):
    with h5py.File(tmp_path / "t.h5", "w") as store:
        store["time_s"], store["force_n"] = np.array([0.0, 0.1, 0.1]), np.arange(3.0)
    with pytest.raises(InputError, match=r"t\.h5, data row 3: time_s does not increase"):
        import_path(tmp_path / "t.h5", tmp_path / "out")


@pytest.mark.parametrize("cell", ["12#3", "1.#INF", "#DIV/0!"])
def test_a_comment_sign_within_a_row_is_no_comment(cell, tmp_path):
    """Half of a number, or of a row, is no value."""
    path = tmp_path / "t.csv"
    path.write_text(f"# by hand\ntime_s,force_n\n0,1\n  # a pause\n1,{cell}\n2,3\n", encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(f"column force_n has {cell!r}, not a number")) as caught:
        import_path(path, tmp_path / "out")
    assert "t.csv, line 5" in str(caught.value)
