"""Tables as laboratories export them: encodings, separators, remarks, maps, other formats, and real files."""

from __future__ import annotations

import gzip
import json
import os
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from sawbench.bench.errors import ConfigError, InputError
from sawbench.bench.recording import Alignment
from sawbench.storage.importers import TableMap, import_path, load_map
from sawbench.storage.importers.dispatch import read_table
from sawbench.storage.reader import read_recording
from scipy.io import savemat

pytestmark = pytest.mark.unit

# Four rows that every export below holds: time in s, force in N.
TIME_S = [0.0, 0.001, 0.002, 0.003]
FORCE_N = [1.5, -2.25, 1234.5, 0.125]
PAGE_BLOCKS = ("csv", "toml", "console")
MAP = '[columns]\nforce_n = { column = "Fz", unit = "kN", sign = -1 }\n'


def table_map(folder, text):
    (folder / "map.toml").write_text(text, encoding="utf-8")
    return load_map(folder / "map.toml")


def taken_in(folder, name, content, mapped=None):
    """Import one file given as bytes or text; return the recording and the report."""
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    report = import_path(folder / name, folder / "out", table_map=mapped)
    return read_recording(report.paths[0]), report


def rows(separator=",", decimal=".", quote="", fmt=str):
    cells = [[fmt(t), fmt(f)] for t, f in zip(TIME_S, FORCE_N, strict=True)]
    return "\n".join(separator.join(f"{quote}{c.replace('.', decimal)}{quote}" for c in row) for row in cells) + "\n"


EXPORTS = {
    "UTF-16 with mark": ("time_s,force_n\n" + rows()).encode("utf-16"),
    "UTF-16 without mark": ("time_s,force_n\n" + rows()).encode("utf-16-le"),
    "UTF-16 big end first": ("time_s,force_n\n" + rows()).encode("utf-16-be"),
    "UTF-8 with mark": ("time_s,force_n\n" + rows()).encode("utf-8-sig"),
    "latin-1": ("# geprüft von Jörg, 20 °C\ntime_s;force_n\n" + rows(";", ",")).encode("latin-1"),
    "sep line": "sep=;\r\ntime_s;force_n\r\n" + rows(";", ","),
    "sep line, unusual": "sep=|\ntime_s|force_n\n" + rows("|"),
    "capitals": "TIME_S,FORCE_N\n" + rows(),
    "capitals with spaces": "Time S ; Force N\n" + rows(";"),
    "quoted decimal commas": "time_s,force_n\n" + rows(",", ",", '"'),
    "quoted header": '"time_s";"force_n"\n' + rows(";", ","),
    "tabs": "time_s\tforce_n\n" + rows("\t", ","),
    "spaces": "  time_s    force_n\n" + rows("    "),
    "units below": "time_s;force_n\ns;N\n" + rows(";"),
    "units in brackets below": "time_s,force_n\n[s],[N]\n" + rows(),
    "units in the header": "Time [s],Force [N]\n" + rows(),
    "remarks before": "Instrument;DAQ 7\nSerial;123\nRange;500\n\ntime_s;force_n\n" + rows(";"),
    "remarks padded by a spreadsheet": "Instrument;DAQ 7\nSerial;123\n;\ntime_s;force_n\n" + rows(";"),
    "per cent remarks, header among them": "% by hand\n% time_s, force_n\n" + rows(),
    "remarks between rows": "time_s,force_n\n" + rows().replace("0.002", "# pause\n0.002"),
    "no line end at the end": "time_s,force_n\n" + rows().rstrip(),
    "line ends of old Macs": ("time_s,force_n\n" + rows()).replace("\n", "\r"),
    "a separator at the end of rows": "time_s,force_n\n" + rows().replace("\n", ",\n"),
    "empty columns at the end": "time_s,force_n,,,\n" + rows().replace("\n", ",,,\n"),
    "empty lines": "time_s,force_n\n\n" + rows().replace("\n", "\n\n"),
}


@pytest.mark.parametrize("name", EXPORTS)
def test_export_is_read_as_it_was_meant(name, tmp_path):
    recording, _ = taken_in(tmp_path, "t.csv", EXPORTS[name])
    assert list(recording.signals) == ["force_n"]
    signal = recording.signal("force_n")
    assert signal.time_s.tolist() == TIME_S
    assert signal.values.tolist() == FORCE_N


def test_row_of_units_converts(tmp_path):
    text = "time_s;force_n;displacement_mm\nms;kN;m\n0;0,5;0,001\n1;-0,25;0,002\n2;0;0\n"
    recording, report = taken_in(tmp_path, "t.csv", text)
    assert recording.signal("force_n").values.tolist() == [500.0, -250.0, 0.0]
    assert recording.signal("force_n").time_s.tolist() == [0.0, 0.001, 0.002]
    assert recording.signal("displacement_mm").values.tolist() == [1.0, 2.0, 0.0]
    assert report.taken["t.mcap"]["force_n"] == "column 'force_n' in kN, times 1000"


def test_map_converts_and_is_kept(tmp_path):
    recording, report = taken_in(tmp_path, "t.csv", "time_s,Fz\n0,0.5\n1e-3,-0.25\n", table_map(tmp_path, MAP))
    assert recording.signal("force_n").values.tolist() == [-500.0, 250.0]
    assert recording.signal("force_n").unit == "N"
    assert report.taken["t.mcap"]["force_n"] == "column 'Fz' in kN, times -1000"
    assert recording.provenance["column of force_n"] == "column 'Fz' in kN, times -1000"
    assert TableMap.model_validate({"columns": {"force_n": {"column": "Fz", "unit": "kN", "sign": -1}}}) == load_map(
        _written(tmp_path / "kept.toml", recording.provenance["map"])
    )


def _written(path, text):
    path.write_text(text)
    return path


UNITS = [
    ("force_n", "lbf", 4.4482216152605),
    ("force_n", "N", 1.0),
    ("displacement_mm", "m", 1000.0),
    ("displacement_mm", "in", 25.4),
    ("displacement_mm", "um", 0.001),
    ("displacement_mm", "µm", 0.001),
    ("motor_current_a", "mA", 0.001),
    ("battery_voltage_v", "mV", 0.001),
    ("time_s", "ms", 0.001),
    ("time_s", "us", 1e-6),
    ("drive_force_n", "kN", 1000.0),
]


@pytest.mark.parametrize(("channel", "unit", "factor"), UNITS)
def test_units(channel, unit, factor, tmp_path):
    text = f'[columns]\n{channel} = {{ column = "x", unit = "{unit}" }}\n'
    header = "x,force_n" if channel == "time_s" else "time_s,x"
    recording, _ = taken_in(tmp_path, "t.csv", f"{header}\n1,10\n2,20\n3,40\n", table_map(tmp_path, text))
    if channel == "time_s":
        assert recording.signal("force_n").time_s == pytest.approx(np.array([1, 2, 3]) * factor, rel=1e-12)
    else:
        assert recording.signal(channel).values == pytest.approx(np.array([10, 20, 40]) * factor, rel=1e-12)


def test_scale_and_offset_turn_volts_into_newton(tmp_path):
    text = '[columns]\nforce_n = { column = "U", scale = 50.0, offset = -125.0, sign = -1 }\n'
    recording, _ = taken_in(tmp_path, "t.csv", "time_s,U [V]\n0,2.5\n1e-3,3.5\n", table_map(tmp_path, text))
    assert recording.signal("force_n").values.tolist() == [0.0, -50.0]


def test_columns_without_names_go_by_their_places(tmp_path):
    text = "[columns]\ntime_s = 1\nmotor_current_a = 3\n"
    recording, _ = taken_in(tmp_path, "t.dat", "0 7 1.5\n0.001 8 2.5\n", table_map(tmp_path, text))
    assert recording.signal("motor_current_a").values.tolist() == [1.5, 2.5]
    assert list(recording.signals) == ["motor_current_a"]


def test_table_without_time_needs_its_rate(tmp_path):
    text = '[columns]\nforce_n = "Fz"\n[table]\nrate_hz = 2000\n'
    recording, _ = taken_in(tmp_path, "t.csv", "Fz\n1\n2\n3\n", table_map(tmp_path, text))
    assert recording.signal("force_n").time_s.tolist() == [0.0, 0.0005, 0.001]


def test_repeated_times_are_dropped_where_asked(tmp_path):
    text = "time_s,force_n\n0,1\n0,2\n0.1,3\n"
    with pytest.raises(InputError, match=r"t.csv, line 3: time_s does not increase"):
        taken_in(tmp_path, "t.csv", text)
    mapped = table_map(tmp_path, '[table]\nrepeated_times = "drop"\n')
    recording, report = taken_in(tmp_path, "t.csv", text, mapped)
    assert recording.signal("force_n").values.tolist() == [1.0, 3.0]
    assert "1 rows with a repeated time" in report.warnings[0]


def test_a_row_that_repeats_the_one_before_it_says_nothing_new(tmp_path):
    """A logger that writes a row twice; the time that a sample later stands with other values is refused."""
    text = "time_s,force_n,displacement_mm\n0,1,\n0,1,\n0.1,3,5\n0.1,3,5\n0.1,3,5\n0.2,4,6\n"
    recording, report = taken_in(tmp_path, "t.csv", text)
    assert recording.signal("force_n").time_s.tolist() == [0.0, 0.1, 0.2]
    assert recording.signal("force_n").values.tolist() == [1.0, 3.0, 4.0]
    assert recording.signal("displacement_mm").values.tolist() == [5.0, 6.0]
    assert "3 rows are left out: they repeat the row before them" in report.warnings[0]
    with pytest.raises(InputError, match=r"u.csv, line 9: time_s does not increase"):
        taken_in(tmp_path, "u.csv", text + "0.3,4,6\n0.3,4,7\n")


def test_a_map_states_how_well_the_times_of_its_columns_agree(tmp_path):
    text = "time_s,force_n,displacement_mm\n0,1,5\n0.1,2,6\n"
    mapped = table_map(tmp_path, "[table]\nalignment_std_s = 2e-5\n")
    recording, _ = taken_in(tmp_path, "t.csv", text, mapped)
    assert {s.alignment for s in recording.signals.values()} == {Alignment(std_s=2e-5, latency_s=0.0)}
    assert taken_in(tmp_path, "u.csv", text)[0].signal("force_n").alignment is None
    with pytest.raises(ConfigError, match=r"table\.alignment_std_s"):
        table_map(tmp_path, "[table]\nalignment_std_s = -1.0\n")


@pytest.mark.parametrize(
    ("cells", "thousands", "decimal"),
    [('0;"1,234.5"\n1;"2,000,000.25"\n', ",", "."), ("0;1.234,5\n1;2.000.000,25\n", ".", ",")],
    ids=["comma", "point"],
)
def test_thousands_are_refused_or_asked_for(cells, thousands, decimal, tmp_path):
    text = "time_s;force_n\n" + cells
    with pytest.raises(InputError, match="thousands separator") as caught:
        taken_in(tmp_path, "t.csv", text)
    assert "thousands =" in str(caught.value) and "t.csv" in str(caught.value)
    mapped = table_map(tmp_path, f"[table]\nthousands = '{thousands}'\ndecimal = '{decimal}'\n")
    recording, _ = taken_in(tmp_path, "t.csv", text, mapped)
    assert recording.signal("force_n").values.tolist() == [1234.5, 2000000.25]


def test_commas_that_may_be_either_are_asked_about(tmp_path):
    text = "time_s;force_n\n1;1,234\n2;2,345\n"
    with pytest.raises(InputError, match="'1,234': thousands separator or decimal sign"):
        taken_in(tmp_path, "t.csv", text)
    recording, _ = taken_in(tmp_path, "t.csv", text, table_map(tmp_path, "[table]\ndecimal = ','\n"))
    assert recording.signal("force_n").values.tolist() == [1.234, 2.345]


def test_decimal_commas_that_come_late_are_read(tmp_path):
    text = "time_s;force_n\n" + "".join(f"{k};{k}\n" for k in range(2000)) + "2000;0,5\n"
    recording, _ = taken_in(tmp_path, "t.csv", text)
    assert recording.signal("force_n").values[-1] == 0.5


def test_unit_that_cannot_be_converted_says_which_can(tmp_path):
    mapped = table_map(tmp_path, '[columns]\nforce_n = { column = "Fz", unit = "furlong" }\n')
    with pytest.raises(InputError, match="force_n cannot be converted from 'furlong' to N") as caught:
        taken_in(tmp_path, "t.csv", "time_s,Fz\n0,1\n1,2\n", mapped)
    said = str(caught.value)
    assert "t.csv, column Fz" in said and "kN" in said and "lbf" in said
    assert said.endswith("for another unit write in the map unit = 'N' and scale = N per unit of the column")


def test_column_in_a_unit_of_another_quantity_is_refused(tmp_path):
    with pytest.raises(InputError, match="force_n cannot be converted from 'mm'"):
        taken_in(tmp_path, "t.csv", "time_s,force_n\ns,mm\n0,1\n1,2\n")


def test_column_that_is_not_there_is_named_with_those_that_are(tmp_path):
    with pytest.raises(InputError, match="has no column 'Fz'; its columns are time_s, Fx, Fy") as caught:
        taken_in(tmp_path, "t.csv", "time_s,Fx,Fy\n0,1,2\n1,2,3\n", table_map(tmp_path, MAP))
    assert "did you mean 'Fx'" in str(caught.value) or "did you mean 'Fy'" in str(caught.value)


@pytest.mark.parametrize(
    "clock",
    [
        ["23:59:59,999", "00:00:00,000", "00:00:00,001"],
        ["2026-03-02 09:00:00.000", "2026-03-02 09:00:00.001", "2026-03-02 09:00:00.002"],
        ["2026-03-02T09:00:00.000Z", "2026-03-02T09:00:00.001Z", "2026-03-02T09:00:00.002Z"],
        ["02.03.2026 09:00:00,5", "02.03.2026 09:00:00,501", "02.03.2026 09:00:00,502"],
    ],
    ids=["over midnight", "with date", "ISO 8601", "German"],
)
def test_times_of_day_become_seconds_from_the_first(clock, tmp_path):
    text = "Time;Force [N];Status\n" + "".join(f"{t};{k}.5;OK\n" for k, t in enumerate(clock))
    if "," in clock[0]:
        text = text.replace(".5;", ",5;")
    recording, _ = taken_in(tmp_path, "t.csv", text)
    assert recording.signal("force_n").time_s == pytest.approx([0.0, 0.001, 0.002], abs=1e-9)
    assert recording.signal("force_n").values.tolist() == [0.5, 1.5, 2.5]


def test_example_of_the_page(tmp_path):
    """The blocks of docs/tables.md, run as they stand there."""
    page = (Path(__file__).parents[2] / "docs" / "tables.md").read_text(encoding="utf-8")
    csv_text, toml_text, console = (re.search(rf"```{kind}\n(.*?)```", page, re.S)[1] for kind in PAGE_BLOCKS)
    recording, report = taken_in(tmp_path, "run7.csv", csv_text, table_map(tmp_path, toml_text))
    assert report.warnings == ()
    words = [f"{channel} <- {text}" for channel, text in report.taken["run7.mcap"].items()]
    assert [line for line in console.splitlines() if "<-" in line] == words
    assert set(report.notes) < set(console.splitlines())
    assert recording.signal("force_n").values == pytest.approx([1.5, 2.1, 3.4])
    assert recording.signal("motor_current_a").values == pytest.approx([8.24, 8.5, 8.62])
    assert recording.signal("force_n").time_s == pytest.approx([0.0, 0.01, 0.02])


def test_text_in_a_column_nobody_asked_for_does_not_matter(tmp_path):
    text = "time_s,status,force_n\n0,OK,1\n1e-3,late,2\n"
    recording, report = taken_in(tmp_path, "t.csv", text)
    assert list(recording.signals) == ["force_n"]
    assert "column status does not contain numbers" in report.warnings[0]


def test_wrong_maps_are_refused_by_key(tmp_path):
    for text, named in [
        ('[columns]\nforce_n = { colum = "Fz" }', "did you mean 'column'"),
        ("[columns]\nforce_n = { column = true }", "columns.force_n.column: must be the name of a column"),
        ("[columns]\nforce_n = 0", "columns.force_n.column: must be .* counted from 1 .got 0"),
        ('[columns]\nforce_n = { column = "Fz", sign = 2 }', "columns.force_n.sign"),
        ('[columns]\nforce_n = { column = "Fz", scale = 0 }', "scale must not be 0"),
        ('[columns]\nforce_n = { column = "Fz", scale = true }', "columns.force_n.scale"),
        ('[table]\nrate_hz = 5\n[columns]\ntime_s = "t"', "keep one"),
        ("x = " + 20_000 * "[", "nested too deeply"),
    ]:
        with pytest.raises(ConfigError, match=named) as caught:
            table_map(tmp_path, text)
        assert "map.toml" in str(caught.value)


def test_matlab_5_and_7_3_are_the_same(tmp_path):
    columns = {"t": np.arange(5) / 1e3, "Fz": np.arange(5) / 10}
    savemat(tmp_path / "five.mat", {"run": columns, "gain": 3.0, "operator": "J"})
    with h5py.File(tmp_path / "seven.mat", "w", userblock_size=512) as store:
        for name, values in columns.items():
            store.create_group("run") if "run" not in store else None
            store["run"][name] = values.reshape(1, -1)
    mapped = table_map(tmp_path, MAP + 'time_s = "run.t"\n')
    for name in ("five.mat", "seven.mat"):
        recording = read_recording(import_path(tmp_path / name, tmp_path / "out", table_map=mapped).paths[0])
        assert recording.signal("force_n").values == pytest.approx(-100.0 * np.arange(5))
        assert recording.signal("force_n").time_s.tolist() == columns["t"].tolist()


@pytest.mark.parametrize("is_upright", [True, False])
def test_columns_of_a_matlab_matrix_go_by_their_places(is_upright, tmp_path):
    matrix = np.column_stack([np.arange(5) / 1e3, np.arange(5) / 10, np.ones(5)])
    savemat(tmp_path / "m.mat", {"M": matrix if is_upright else matrix.T})
    mapped = table_map(tmp_path, '[columns]\ntime_s = "M.1"\nforce_n = "M.2"\n')
    recording = read_recording(import_path(tmp_path / "m.mat", tmp_path / "out", table_map=mapped).paths[0])
    assert recording.signal("force_n").time_s.tolist() == matrix[:, 0].tolist()
    assert recording.signal("force_n").values.tolist() == matrix[:, 1].tolist()


@pytest.mark.parametrize(
    "content",
    [
        {"run": {"t": [0, 0.001, 0.002], "Fz": [1, None, 3]}},
        [{"t": 0, "Fz": 1}, {"t": 0.001, "Fz": None}, {"t": 0.002, "Fz": 3}],
        {"columns": ["t", "Fz"], "data": [[0, 1], [0.001, None], [0.002, 3]]},
    ],
    ids=["lists", "records", "rows"],
)
def test_json(content, tmp_path):
    mapped = table_map(tmp_path, MAP + 'time_s = "t"\n')
    recording, _ = taken_in(tmp_path, "t.json", json.dumps(content), mapped)
    assert recording.signal("force_n").values.tolist() == [-1000.0, -3000.0]
    assert recording.signal("force_n").time_s.tolist() == [0.0, 0.002]


def test_json_text_for_numbers_is_said_where_it_is_asked_for(tmp_path):
    content = {"time_s": [0, 0.001], "force_n": ["0,5", "1,0"], "operator": ["J", "J"]}
    with pytest.raises(InputError, match=r"t\.json: column force_n has '0,5', not a number\n  -> write numbers"):
        taken_in(tmp_path, "t.json", json.dumps(content))
    recording, _ = taken_in(tmp_path, "t.json", json.dumps(content | {"force_n": [1, 2]}))
    assert list(recording.signals) == ["force_n"]


def test_json_rows_without_names(tmp_path):
    mapped = table_map(tmp_path, "[columns]\ntime_s = 1\nforce_n = 2\n")
    recording, _ = taken_in(tmp_path, "t.json", json.dumps({"data": [[0, 1], [0.001, 2]]}), mapped)
    assert recording.signal("force_n").values.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,force_n\n0,1\nsecond part\n0.001,2\n", "t.csv, line 3: the row has 1 cells, the header has 2"),
        ("time_s,force_n\n0,1\nEnd,of file\n", "t.csv, line 3: column time_s has 'End', not a number"),
        ("time_s," + 200_000 * "a" + "\n0,1\n", "cannot be read as a table: field larger than"),
        ("time_s,force_n\n0,\n1,\n", "has no channel with values; column force_n is empty"),
        ("Fz\n0,5\n1,5\n", "has no column time_s; its columns are Fz"),
        ("time_s,force_n\n0,1\n0.001,2,3\n", "t.csv, line 3: the row has 3 cells, the header has 2"),
        (
            "made by x\ntime_s,force_n\n" + "".join(f"{k},1.5\n" for k in range(4000)) + "4000,2.0,3\n",
            "t.csv, line 4003: the row has 3 cells, the header has 2",
        ),
    ],
    ids=[
        "a line of text",
        "a line of text at the end",
        "a cell without end",
        "empty",
        "one column of decimal commas",
        "too long",
        "far down",
    ],
)
def test_what_is_wrong_is_said_where_it_stands(text, message, tmp_path):
    with pytest.raises(InputError, match=message):
        taken_in(tmp_path, "t.csv", text)


def test_one_word_among_decimal_commas_is_said_where_it_stands(tmp_path):
    lines = [f"0,{k:03d};1,5" for k in range(20)]
    lines[12] = "0,012;OVL"
    with pytest.raises(InputError, match=r"t\.csv, line 14: column force_n has 'OVL', not a number"):
        taken_in(tmp_path, "t.csv", "time_s;force_n\n" + "\n".join(lines) + "\n")


def test_a_channel_of_the_map_that_is_nearly_one_of_the_bench_is_said(tmp_path):
    mapped = table_map(tmp_path, '[columns]\ntime_s = "t"\nforce_n = "F"\ndisplacment_mm = "x"\nforce_2_n = "G"\n')
    _, report = taken_in(tmp_path, "t.csv", "t,F,x,G\n0,1,2,3\n0.001,1,2,3\n", mapped)
    (said,) = [text for text in report.warnings if "did you mean" in text]
    assert "displacment_mm" in said and "'displacement_mm'" in said


@pytest.mark.parametrize("name", ["t.mat", "t.json", "t.csv.gz", "t.h5"])
def test_damaged_files(name, tmp_path):
    with pytest.raises(InputError, match=f"{name}: "):
        taken_in(tmp_path, name, b"\x89nothing of the kind")


@pytest.mark.parametrize("name", ["t.h5", "t.mat", "t.csv", "t.json", "t.mf4"])
@pytest.mark.filterwarnings("ignore")
def test_flipped_bytes_are_an_error_or_a_table_and_nothing_else(name, tmp_path):
    path = tmp_path / name
    _write_sound(path)
    sound = path.read_bytes()
    rng = np.random.default_rng(5)
    n_refused = 0
    for _ in range(3 if name in ("t.mat", "t.mf4") else 60):
        content = np.frombuffer(sound, dtype=np.uint8).copy()
        content[rng.integers(0, len(content), 8)] = rng.integers(0, 256, 8)
        path.write_bytes(content.tobytes())
        try:
            assert read_table(path).signals
        except InputError as error:
            assert name in str(error)
            n_refused += 1
    assert n_refused > 0


def _write_sound(path):
    columns = {"time_s": np.arange(5.0), "force_n": np.arange(5.0)}
    if path.suffix == ".h5":
        with h5py.File(path, "w") as store:
            for name, values in columns.items():
                store[name] = values
    elif path.suffix == ".mat":
        savemat(path, columns)
    elif path.suffix == ".mf4":
        from asammdf import MDF, Signal

        with MDF(version="4.10") as measurement:
            measurement.append([Signal(columns["force_n"], columns["time_s"], name="force_n", unit="N")])
            measurement.save(path, overwrite=True)
    elif path.suffix == ".json":
        path.write_text(json.dumps({name: values.tolist() for name, values in columns.items()}))
    else:
        path.write_text("time_s,force_n\n" + rows())


def test_mf4_with_a_map(tmp_path):
    path = tmp_path / "t.mf4"
    _write_sound(path)
    mapped = table_map(tmp_path, '[columns]\nguide_force_n = { column = "force_n", unit = "kN", sign = -1 }\n')
    content = read_table(path, mapped)
    assert content.signals["guide_force_n"].values.tolist() == [0.0, -1e3, -2e3, -3e3, -4e3]
    assert content.signals["guide_force_n"].time_s.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert "the map states kN, the file 'N'" in content.warnings[0]


def test_packed_text(tmp_path):
    recording, report = taken_in(tmp_path, "t.csv.gz", gzip.compress(EXPORTS["sep line"].encode()))
    assert report.paths[0].name == "t.mcap"
    assert recording.signal("force_n").values.tolist() == FORCE_N


@pytest.mark.parametrize("way", ["file", "file of a trial", "in the campaign"])
def test_campaign_with_a_map(way, tmp_path):
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "a.csv").write_text("time_s,Fz\n0,0.5\n1e-3,-0.25\n")
    top = {"file": 'map = "map.toml"\n', "in the campaign": "", "file of a trial": ""}[way]
    trial = '[[trial]]\nfile = "a.csv"\nduty = 0.5\n' + 'map = "map.toml"\n' * (way == "file of a trial")
    (tmp_path / "campaign.toml").write_text(top + trial + MAP * (way == "in the campaign"))
    recording = read_recording(import_path(tmp_path / "campaign.toml", tmp_path / "out").paths[0])
    assert recording.signal("force_n").values.tolist() == [-500.0, 250.0]
    assert "Fz" in recording.provenance["map"]
    assert recording.trial.duty == 0.5


def test_campaign_with_a_map_twice_is_refused(tmp_path):
    (tmp_path / "map.toml").write_text(MAP)
    (tmp_path / "a.csv").write_text("time_s,Fz\n0,0.5\n1e-3,-0.25\n")
    (tmp_path / "campaign.toml").write_text('map = "map.toml"\n[[trial]]\nfile = "a.csv"\n' + MAP)
    with pytest.raises(ConfigError, match="has both map = 'map"):
        import_path(tmp_path / "campaign.toml", tmp_path / "out")


# --- real files -----------------------------------------------------------------------------------------------

SHARED = Path(os.environ.get("SAWBENCH_SHARED") or Path(__file__).parents[3] / "shared") / "data"


def shared(name):
    if not (SHARED / name).exists():
        pytest.skip(f"shared data absent: {name}")
    return SHARED / name


def test_emps_axis(tmp_path):
    from scipy.io import loadmat

    path = shared("emps/DATA_EMPS.mat")
    text = '[columns]\ntime_s = "t"\ndisplacement_mm = { column = "qm", unit = "m" }\n'
    text += 'drive_force_n = { column = "vir", scale = 35.15065188248547 }\n'
    recording = read_recording(import_path(path, tmp_path, table_map=table_map(tmp_path, text)).paths[0])
    truth = loadmat(path, squeeze_me=True)
    assert recording.signal("displacement_mm").values == pytest.approx(1e3 * truth["qm"], rel=1e-12)
    assert recording.signal("drive_force_n").values == pytest.approx(truth["gtau"] * truth["vir"], rel=1e-12)
    assert recording.signal("drive_force_n").unit == "N"


def test_instrument_text_with_its_header_among_the_remarks(tmp_path):
    path = shared("davinci_motor/L4_00.TXT.gz")
    text = '[columns]\ntime_s = { column = "Back-end Time", unit = "s" }\nmotor_current_a = "Measured Current [Amps]"\n'
    report = import_path(path, tmp_path, table_map=table_map(tmp_path, text))
    signal = read_recording(report.paths[0]).signal("motor_current_a")
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()
    cells = [line.split(",") for line in lines if line and not line.startswith("%")]
    assert signal.values.tolist() == [float(row[3]) for row in cells]
    assert signal.time_s.tolist() == [float(row[0]) for row in cells]


def test_machine_tool_whose_time_is_an_index(tmp_path):
    path = shared("cnc_spindle_current/Data_KS-NPC-6FF_0.mat")
    text = '[columns]\ntime_s = { column = "Time", unit = "ms" }\nmotor_current_a = "Current_MainSpindle"\n'
    report = import_path(path, tmp_path, table_map=table_map(tmp_path, text))
    signal = read_recording(report.paths[0]).signal("motor_current_a")
    assert (len(signal.values), round(signal.rate_hz, 6)) == (177000, 1000.0)


@pytest.mark.parametrize("repeats", ["", '[table]\nrepeated_times = "drop"\n'])
def test_cell_whose_log_repeats_rows(tmp_path, repeats):
    path = shared("pybop_cells/LGM50_5Ah_RateTest.mat")
    text = '[columns]\ntime_s = "T25.cRate_2C.timeVec"\nbattery_voltage_v = "T25/cRate_2C/volVec"\n'
    text += 'battery_current_a = { column = "T25.cRate_2C.currVec", sign = -1 }\n'
    report = import_path(path, tmp_path / "out", table_map=table_map(tmp_path, text + repeats))
    assert "repeat" in report.warnings[0]
    recording = read_recording(report.paths[0])
    current = recording.signal("battery_current_a")
    is_loaded = current.values > 1.0
    # Published with the file: 2 C is 10 A, and the cell gives 4.86 Ah down to 2.5 V at 25 degrees.
    assert np.median(current.values[is_loaded]) == pytest.approx(10.0, abs=0.02)
    step_s = np.append(np.diff(current.time_s), 0.0)
    assert np.sum(current.values[is_loaded] * step_s[is_loaded]) / 3600 == pytest.approx(4.86, abs=0.01)


@pytest.mark.parametrize("header", ["Time [ms]", "Time / ms", "Time in ms", "time_ms", "TIME_MS"])
def test_a_unit_behind_the_name_is_seen(header, tmp_path):
    recording, report = taken_in(tmp_path, "t.csv", f"{header},force_kN\n0,0.5\n1,0.25\n2,0.5\n")
    assert recording.signal("force_n").time_s.tolist() == [0.0, 0.001, 0.002]
    assert recording.signal("force_n").values.tolist() == [500.0, 250.0, 500.0]
    assert report.warnings == ()


def test_a_name_with_a_slash_or_an_underscore_stays_a_name(tmp_path):
    recording, _ = taken_in(tmp_path, "t.csv", "time_s,force_n,rev/min,guide_mm,made in China\n0,1,2,3,4\n1,2,3,4,5\n")
    assert set(recording.signals) == {"force_n", "rev/min", "guide_mm", "made in China"}


def test_marks_of_an_overload_are_missing_samples(tmp_path):
    """9.9e37 is what SCPI instruments write, here as milliampere."""
    text = "time_s,Motor current [mA]\n" + "".join(f"{k},{9.9e37 if k in (3, 4) else 1000 + k}\n" for k in range(8))
    recording, report = taken_in(tmp_path, "t.csv", text)
    current = recording.signal("motor_current_a")
    assert current.time_s.tolist() == [0.0, 1.0, 2.0, 5.0, 6.0, 7.0]
    assert [gap.n_missing for gap in current.gaps] == [2]
    assert any("motor_current_a: 2 cells beyond 1e+30" in text and "line 5" in text for text in report.warnings)


def test_a_single_impossible_value_is_said(tmp_path):
    text = "time_s,force_n\n" + "".join(f"{k / 1000},{32767 if k == 3 else k % 7}\n" for k in range(1000))
    _, report = taken_in(tmp_path, "t.csv", text)
    assert any("force_n: 1 of 1000 of the values are outside -5000 to 5000 N" in text for text in report.warnings)


def test_empty_cells_at_the_ends_of_a_channel_are_said(tmp_path):
    cells = ["" if k < 5 or k > 7 else "1" for k in range(10)]
    text = "time_s,force_n,displacement_mm\n" + "".join(f"{k / 1000},{cell},{k}\n" for k, cell in enumerate(cells))
    _, report = taken_in(tmp_path, "t.csv", text)
    said = [text for text in report.warnings if "cells are empty" in text]
    assert said == ["t.csv: force_n begins 0.005 s after the table and ends 0.002 s before the table: cells are empty"]


def test_a_column_for_two_channels_is_said(tmp_path):
    mapped = table_map(tmp_path, '[columns]\nforce_n = "Fx"\nmotor_current_a = "Fx"\n')
    _, report = taken_in(tmp_path, "t.csv", "time_s,Fx\n0,1\n1,2\n", mapped)
    assert any("takes column Fx for force_n, motor_current_a" in text for text in report.warnings)


@pytest.mark.parametrize("header", ["time_s,v", "time_s,N", "time_s,a"])
def test_names_that_look_like_units_are_names(header, tmp_path):
    recording, _ = taken_in(tmp_path, "t.csv", f"{header}\n0,1\n1,2\n")
    assert list(recording.signals) == [header.split(",")[1]]


def test_a_name_without_its_unit_in_a_map_is_asked_about(tmp_path):
    mapped = table_map(tmp_path, '[columns]\nforce = "Fz"\n')
    _, report = taken_in(tmp_path, "t.csv", "time_s,Fz\n0,1\n1,2\n", mapped)
    assert any("did you mean 'force_n'?" in text for text in report.warnings)


@pytest.mark.parametrize("space", [" ", "\u00a0", "\u202f"], ids=["plain", "no break", "narrow"])
def test_a_space_may_stand_between_thousands(space, tmp_path):
    mapped = table_map(tmp_path, f'[table]\nthousands = "{space}"\n')
    text = f"time_s;force_n\n0,250;1{space}234,500\n1,250;2{space}000{space}000,125\n"
    recording, _ = taken_in(tmp_path, "t.csv", text, mapped)
    assert recording.signal("force_n").values.tolist() == [1234.5, 2000000.125]


@pytest.mark.parametrize("comment", ["", "\t"], ids=["no cell", "an empty cell"])
def test_a_labview_measurement_file(comment, tmp_path):
    """Two headers, of the file and of its segment, and a column that has a cell only where somebody wrote a comment."""
    text = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\nX_Columns\tOne\n"
        "Date\t2026/11/30\nTime\t08:00:00,123\n***End_of_Header***\t\n\t\nChannels\t2\nSamples\t3\t3\n"
        "Date\t2026/11/30\t2026/11/30\nTime\t08:00:00,123\t08:00:00,123\nY_Unit_Label\tNewton\tAmpere\n"
        "X_Dimension\tTime\tTime\nX0\t0,0\t0,0\nDelta_X\t0,001\t0,001\n***End_of_Header***\t\t\n"
        "X_Value\tforce_n\tmotor_current_a\tComment\n"
    ) + "".join(f"0,00{k}\t{k},5\t{k + 1}{comment}\n" for k in range(5))
    recording, _ = taken_in(tmp_path, "a.lvm", text, table_map(tmp_path, '[columns]\ntime_s = "X_Value"\n'))
    assert recording.signal("force_n").time_s == pytest.approx([0.0, 0.001, 0.002, 0.003, 0.004])
    assert recording.signal("force_n").values.tolist() == [0.5, 1.5, 2.5, 3.5, 4.5]
    assert recording.signal("motor_current_a").values.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
