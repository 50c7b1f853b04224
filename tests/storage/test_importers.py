"""Tables and campaigns in: what is understood, what is warned about, what is refused."""

from __future__ import annotations

import csv
import json
import os
import re
from datetime import UTC, datetime
from pathlib import Path

import h5py
import numpy as np
import pytest
from sawbench.bench.errors import ConfigError, InputError
from sawbench.bench.recording import Gap
from sawbench.storage.digest import sha256_of
from sawbench.storage.importers import FramesNeedDbc, import_path
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.unit

CONFIG = "[battery]\nnominal_voltage_v = 18.0\ncapacity_ah = 1.5\nbeta = 0.99\n"


def imported(folder, name, text):
    """Import a table given as text; return the recording and the warnings."""
    (folder / name).write_text(text, encoding="utf-8")
    report = import_path(folder / name, folder / "out")
    return read_recording(report.paths[0]), report.warnings


def table(columns, rows, delimiter=","):
    lines = [delimiter.join(columns), *(delimiter.join(str(cell) for cell in row) for row in rows)]
    return "\n".join(lines) + "\n"


def test_columns_in_any_order_and_some_missing(tmp_path):
    rows = [(f"{-0.75 * k}", f"{0.0002 * k:.4f}", f"{1.5 * k}") for k in range(100)]
    recording, warnings = imported(tmp_path, "t.csv", table(("motor_current_a", "time_s", "displacement_mm"), rows))
    assert warnings == ()
    assert list(recording.signals) == ["motor_current_a", "displacement_mm"]
    signal = recording.signal("displacement_mm")
    assert signal.unit == "mm"
    assert signal.time_s.tolist() == [float(f"{0.0002 * k:.4f}") for k in range(100)]
    assert signal.values.tolist() == [1.5 * k for k in range(100)]
    assert recording.trial.source == "import of t.csv"
    assert recording.trial.started_at is None
    assert recording.provenance["source_sha256"] == sha256_of(tmp_path / "t.csv")
    assert recording.is_complete


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("decimal", [".", ","])
def test_delimiters_and_decimal_signs(tmp_path, delimiter, decimal):
    rows = [(f"{0.001 * k:.3f}".replace(".", decimal), f"{k - 2.25}".replace(".", decimal)) for k in range(9)]
    text = table(("time_s", "force_n"), rows, delimiter)
    if delimiter == "," and decimal == ",":
        with pytest.raises(InputError, match="semicolons"):
            imported(tmp_path, "t.csv", text)
        return
    recording, _ = imported(tmp_path, "t.csv", text)
    assert recording.signal("force_n").values.tolist() == [k - 2.25 for k in range(9)]


def test_a_file_as_a_spreadsheet_saves_it(tmp_path):
    """Byte order mark, comment lines, spaces, Windows line ends, a delimiter at the end of the line."""
    text = "\ufeff# made by hand\r\n\r\n time_s ; force_n ;\r\n 0,00 ; 1,5 ;\r\n 0,01 ; -2,5e1 ;\r\n"
    recording, _ = imported(tmp_path, "t.csv", text)
    assert recording.signal("force_n").values.tolist() == [1.5, -25.0]


def test_empty_cells_are_gaps_of_that_channel_alone(tmp_path):
    rows = [(f"{0.001 * k:.3f}", 10.0 + k, "" if 3 <= k <= 5 else "nan" if k == 8 else k) for k in range(12)]
    recording, warnings = imported(tmp_path, "t.csv", table(("time_s", "force_n", "motor_current_a"), rows))
    assert recording.signal("force_n").gaps == ()
    current = recording.signal("motor_current_a")
    assert current.values.tolist() == [0, 1, 2, 6, 7, 9, 10, 11]
    assert current.gaps == (
        Gap(start_s=0.002, end_s=0.006, n_missing=3, reason="empty cells"),
        Gap(start_s=0.007, end_s=0.009, n_missing=1, reason="empty cells"),
    )
    assert "t.csv: samples are missing: 4 in 2 gaps (motor_current_a)" in warnings


def test_missing_rows_are_gaps_of_every_channel(tmp_path):
    rows = [(f"{0.001 * k:.3f}", k, k) for k in range(50) if k not in (20, 21, 22)]
    recording, warnings = imported(tmp_path, "t.csv", table(("time_s", "force_n", "motor_current_a"), rows))
    said = "t.csv: samples are missing: 3 in 1 gap (force_n, motor_current_a)"
    assert [w for w in warnings if "missing" in w] == [said]
    for name in ("force_n", "motor_current_a"):
        (gap,) = recording.signal(name).gaps
        assert (gap.start_s, gap.end_s, gap.n_missing) == (0.019, 0.023, 3)


def test_a_slower_channel_has_no_gaps(tmp_path):
    rows = [(f"{0.001 * k:.3f}", k, k if k % 5 == 0 else "") for k in range(200) if k != 100]
    recording, _ = imported(tmp_path, "t.csv", table(("time_s", "force_n", "battery_voltage_v"), rows))
    slow = recording.signal("battery_voltage_v")
    assert slow.rate_hz == 200.0
    assert [(gap.start_s, gap.end_s, gap.n_missing) for gap in slow.gaps] == [(0.095, 0.105, 1)]


def test_instruments_with_rows_of_their_own_have_no_gaps_but_their_own(tmp_path):
    """The rows of a converter and of a current lie between those of the force, which misses one sample."""
    at = {0.00025 * k + 0.00014: ("force_n", k) for k in range(400) if k != 200}
    at |= {0.0005 * k + 0.0003: ("displacement_mm", k % 20) for k in range(200)}
    at |= {0.001 * k + 0.00035: ("motor_current_a", 3) for k in range(100)}
    names = ("force_n", "displacement_mm", "motor_current_a")
    rows = [(f"{t:.5f}", *(value if name == of else "" for name in names)) for t, (of, value) in sorted(at.items())]
    recording, _ = imported(tmp_path, "t.csv", table(("time_s", *names), rows))
    assert [(gap.start_s, gap.n_missing) for gap in recording.signal("force_n").gaps] == [(0.04989, 1)]
    assert recording.signal("displacement_mm").gaps == recording.signal("motor_current_a").gaps == ()


def test_rows_of_their_own_with_jitter_are_no_gaps(tmp_path):
    """A quarter of the sample period: an interval of one and a half periods is no missing sample."""
    rng = np.random.default_rng(5)
    at = {0.00025 * (k + 0.24 * rng.standard_normal()): ("force_n", k) for k in range(4000)}
    at |= {0.001 * k + 0.00035: ("motor_current_a", 3) for k in range(1000)}
    rows = [
        (f"{t:.7f}", value if of == "force_n" else "", value if of == "motor_current_a" else "")
        for t, (of, value) in sorted(at.items())
    ]
    recording, warnings = imported(tmp_path, "t.csv", table(("time_s", "force_n", "motor_current_a"), rows))
    assert recording.signal("force_n").gaps == recording.signal("motor_current_a").gaps == ()
    assert not any("missing" in warning for warning in warnings)


def test_unknown_and_empty_columns(tmp_path):
    rows = [(0.001 * k, k, 20 + k, "") for k in range(10)]
    columns = ("time_s", "Fforce_N", "temperature", "motor_current_a")
    recording, warnings = imported(tmp_path, "t.csv", table(columns, rows))
    assert list(recording.signals) == ["Fforce_N", "temperature"]
    assert recording.signal("temperature").unit == ""
    assert any("did you mean 'force_n'" in warning for warning in warnings)
    assert any("motor_current_a is empty" in warning for warning in warnings)
    assert [event.kind for event in recording.events] == ["warning"] * 3


@pytest.mark.parametrize(
    ("columns", "scale", "hint"),
    [
        ({"time_s": 1000.0}, {}, "milliseconds"),
        ({}, {"force_n": 1e-3}, "kN"),
        ({}, {"displacement_mm": 1e-3}, "metres"),
        ({}, {"motor_current_a": 1e3}, "check the unit"),
        ({}, {"battery_voltage_v": 1e3}, "check the unit"),
    ],
)
def test_what_looks_like_another_unit_is_said_and_not_changed(tmp_path, columns, scale, hint):
    time_s = np.arange(500) / 5000
    angle = 2 * np.pi * 15 * time_s
    true = {
        "force_n": 280 * np.maximum(-np.sin(angle), 0),
        "displacement_mm": 10 * (1 - np.cos(angle)),
        "motor_current_a": 10 + 3 * np.sin(angle),
        "battery_voltage_v": 18 - 0.1 * np.sin(angle),
    }
    found = {name: values * scale.get(name, 1.0) for name, values in true.items()}
    rows = zip(time_s * columns.get("time_s", 1.0), *found.values(), strict=True)
    text = table(("time_s", *found), [[repr(float(cell)) for cell in row] for row in rows])
    recording, warnings = imported(tmp_path, "t.csv", text)
    assert len(warnings) == 1
    assert hint in warnings[0]
    for name, values in found.items():
        assert np.array_equal(recording.signal(name).values, values)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("time_s,force_n\n", "no data rows"),
        ("0.0,1.0\n0.1,2.0\n", "no header"),
        ("t,force_n\n0,1\n", "no column time_s"),
        ("time_s\n0\n1\n", "no channel"),
        ("time_s,force_n,force_n\n0,1,1\n", "more than once"),
        ("time_s,force_n\n0,1\n0.1,2\n0.1,3\n", "t.csv, line 4: time_s does not increase: 0.1 s is followed by 0.1 s"),
        ("time_s,force_n\n0,1\n,2\n", "t.csv, line 3: time_s is empty or not a finite number"),
        ("time_s,force_n\n0,1\n0.1,abc\n", "t.csv, line 3: column force_n has 'abc', not a number"),
        ("time_s,force_n\n0,1\n0.1,inf\n", "t.csv, line 3: column force_n is infinite"),
        ("time_s,force_n\n0,1\n0.1,2,3\n", "t.csv, line 3: the row has 3 cells"),
        ("time_s,force_n\n" + "0,1\n" * 1500 + "0,1,2\n", "line 1502: the row has 3 cells"),
    ],
)
def test_wrong_tables_are_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message) as caught:
        imported(tmp_path, "t.csv", text)
    assert "t.csv" in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_bytes_that_are_no_text(tmp_path):
    (tmp_path / "t.csv").write_bytes(bytes(range(256)) * 20)
    with pytest.raises(InputError):
        import_path(tmp_path / "t.csv", tmp_path / "out")


def test_hdf5(tmp_path):
    path = tmp_path / "t.h5"
    with h5py.File(path, "w") as store:
        group = store.create_group("run")
        group["time_s"] = np.arange(50) / 1000
        group["force_n"] = np.arange(50, dtype=np.float32)
        group["force_n"].attrs["unit"] = "kN"
        group["picture"] = np.zeros((3, 3))
    report = import_path(path, tmp_path / "out")
    assert np.array_equal(read_recording(report.paths[0]).signal("force_n").values, 1e3 * np.arange(50.0))
    assert report.taken["t.mcap"]["force_n"] == "column 'run.force_n' in kN, times 1000"


@pytest.mark.parametrize("suffix", [".h5", ".mf4"])
def test_damaged_binary_files(tmp_path, suffix):
    path = tmp_path / f"t{suffix}"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(InputError, match="damaged"):
        import_path(path, tmp_path / "out")


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_mf4_channels_keep_their_own_time(tmp_path):
    from asammdf import MDF, Signal

    path = tmp_path / "t.mf4"
    with MDF(version="4.10") as measurement:
        fast, slow = np.arange(100) / 5000, np.arange(20) / 1000
        measurement.append([Signal(np.sin(fast) * 50, fast, name="force_n", unit="N")])
        measurement.append([Signal(slow * 3, slow, name="motor_current_a", unit="A")])
        measurement.append([Signal(slow, slow, name="oil", unit="K")])
        measurement.save(path, overwrite=True)
    report = import_path(path, tmp_path / "out")
    recording = read_recording(report.paths[0])
    assert np.array_equal(recording.signal("force_n").values, np.sin(fast) * 50)
    assert np.array_equal(recording.signal("motor_current_a").time_s, slow)
    assert any("oil" in warning for warning in report.warnings)


def campaign(folder, extra="", **entry):
    """Write a campaign of two trials; `entry` changes the first, `extra` is put at the top."""
    rows = [(0.001 * k, 50.0 + k) for k in range(20)]
    (folder / "bench_config.toml").write_text(CONFIG)
    first = {"file": "trial-01.csv", "duty": 0.4375, "workpiece": "oak", "thickness_mm": 20, "feed_mm_s": 4.0}
    first |= {"blade": "B1", "battery": "P1", "started_at": "2026-03-02T09:00:00Z"} | entry
    text = f'config = "bench_config.toml"\n{extra}\n[[trial]]\n'
    text += "".join(f"{key} = {json.dumps(value)}\n" for key, value in first.items())
    text += '[[trial]]\nfile = "trial-02.csv"\nworkpiece = "none"\nstarted_at = 2026-03-02T10:30:00+01:00\n'
    for name in ("trial-01.csv", "trial-02.csv"):
        (folder / name).write_text(table(("time_s", "force_n"), rows))
    (folder / "campaign.toml").write_text(text)
    return folder / "campaign.toml"


def test_a_campaign_becomes_one_recording_a_trial(tmp_path):
    calls = []
    report = import_path(campaign(tmp_path), tmp_path / "out", on_trial=lambda *row: calls.append(row))
    assert [path.name for path in report.paths] == ["trial-01.mcap", "trial-02.mcap"]
    assert report.n_samples == 40
    assert calls == [(0, 2, "trial-01"), (1, 2, "trial-02")]
    first, second = map(read_recording, report.paths)
    trial = first.trial
    assert (trial.trial_id, trial.material, trial.duty, trial.thickness_mm) == (
        "trial-01",
        "oak",
        0.4375,
        20.0,
    )
    assert (trial.feed_mm_s, trial.blade, trial.battery) == (4.0, "B1", "P1")
    assert trial.started_at == datetime(2026, 3, 2, 9, tzinfo=UTC)
    assert first.config_toml == CONFIG
    assert second.trial.is_idle
    assert second.trial.duty is None
    assert second.trial.started_at == datetime(2026, 3, 2, 9, 30, tzinfo=UTC)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"material": "oak"}, "trial 1: unknown key 'material'; did you mean 'workpiece'"),
        ({"workpice": "oak"}, "trial 1: unknown key 'workpice'; did you mean 'workpiece'"),
        ({"duty": 43.75}, "trial 1: duty: must be a fraction"),
        ({"duty": True}, "trial 1: duty: .*number.*True"),
        ({"thickness_mm": "20"}, "trial 1: thickness_mm: .*number.*'20'"),
        ({"thickness_mm": -1}, "trial 1: thickness_mm"),
        ({"started_at": "2026-03-02T09:00:00"}, "trial 1: started_at"),
        ({"file": "trial-03.csv"}, "trial-03.csv"),
        ({"file": "trial-02.csv"}, "more than once"),
        ({"extra": "confg = 'x'"}, "did you mean 'config'"),
    ],
)
def test_wrong_campaigns_are_refused(tmp_path, change, message):
    with pytest.raises(ConfigError, match=message):
        import_path(campaign(tmp_path, **change), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_campaign_with_a_wrong_table_leaves_no_part_of_it_behind(tmp_path):
    """Two of six trials stayed: they were diagnosed as a campaign, and stood in the way of the corrected call."""
    whole = campaign(tmp_path)
    good = (tmp_path / "trial-02.csv").read_text()
    (tmp_path / "trial-02.csv").write_text(good.replace("\n0.003,", "\n0.001,"))
    kept = tmp_path / "out" / "notes.txt"
    kept.parent.mkdir()
    kept.write_text("of the user")
    with pytest.raises(InputError, match="does not increase"):
        import_path(whole, tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == [kept]
    (tmp_path / "trial-02.csv").write_text(good)
    assert [path.parent for path in import_path(whole, tmp_path / "out").paths] == [tmp_path / "out"] * 2


def test_all_wrong_tables_of_a_campaign_are_named(tmp_path):
    whole = campaign(tmp_path)
    for name, wrong in (("trial-01.csv", "\n0.003,"), ("trial-02.csv", "\n0.002,")):
        text = (tmp_path / name).read_text()
        assert wrong in text
        (tmp_path / name).write_text(text.replace(wrong, "\n0.001,"))
    with pytest.raises(InputError, match=r"^2 of 2 trials cannot be imported") as refused:
        import_path(whole, tmp_path / "out")
    assert re.findall(r"trial-0\d\.csv, line \d+: time_s does not increase", str(refused.value))
    assert str(refused.value).count("does not increase") == 2
    assert "repeated_times = 'drop'" in str(refused.value)


TWO_TABLES = """
[[trial]]
file = "daq.csv"
[[trial.further]]
file = "logger.csv"
map = "logger.toml"
"""


def two_tables(folder, daq_times, logger_times, extra=""):
    """One trial of two instruments; the logger calls its current I and counts it negative."""
    (folder / "daq.csv").write_text(table(("time_s", "force_n"), [(t, 5.0) for t in daq_times]))
    (folder / "logger.csv").write_text(table(("clock", "I"), [(t, -k) for k, t in enumerate(logger_times)]))
    (folder / "logger.toml").write_text('[columns]\ntime_s = "clock"\nmotor_current_a = { column = "I", sign = -1 }\n')
    (folder / "campaign.toml").write_text(TWO_TABLES + extra)
    return import_path(folder / "campaign.toml", folder / "out")


def test_a_trial_may_have_tables_of_several_instruments(tmp_path):
    report = two_tables(tmp_path, [0.0, 0.1, 0.2], [0.0, 0.5, 1.0, 1.5], "time_shift_s = 0.25\n")
    (recording,) = map(read_recording, report.paths)
    assert (recording.trial.trial_id, report.n_samples) == ("daq", 7)
    assert recording.signals["force_n"].time_s.tolist() == [0.0, 0.1, 0.2]
    current = recording.signals["motor_current_a"]
    assert current.time_s.tolist() == [0.25, 0.75, 1.25, 1.75] and current.values.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert recording.provenance["source_file"] == "daq.csv" and recording.provenance["source_file 2"] == "logger.csv"
    assert list(report.taken["daq.mcap"]) == ["time_s", "force_n", "time_s of logger.csv", "motor_current_a"]
    assert "sign = -1" in recording.provenance["map 2"] and "map" not in recording.provenance


@pytest.mark.parametrize(
    ("daq_start", "logger_start", "apart_s"), [("09:00:01", "09:00:00", -1.0), ("23:59:59", "00:00:01", 2.0)]
)
def test_tables_with_times_of_day_are_placed_by_these(tmp_path, daq_start, logger_start, apart_s):
    times = [[f"{start}.{k}00" for k in range(3)] for start in (daq_start, logger_start)]
    report = two_tables(tmp_path, *times)
    (recording,) = map(read_recording, report.paths)
    assert recording.signals["force_n"].time_s[0] == 0.0
    assert recording.signals["motor_current_a"].time_s == pytest.approx([apart_s, apart_s + 0.1, apart_s + 0.2])


def test_two_tables_of_a_trial_with_the_same_channel_are_refused(tmp_path):
    campaign(tmp_path)
    path = tmp_path / "campaign.toml"
    path.write_text(path.read_text() + '[[trial.further]]\nfile = "trial-01.csv"\n')
    with pytest.raises(InputError, match="has force_n, which another table of the trial has too"):
        import_path(path, tmp_path / "out")
    path.write_text(path.read_text().replace('further]]\nfile = "trial-01.csv"', 'further]]\nfile = "nowhere.csv"'))
    with pytest.raises(ConfigError, match=r"do not exist: nowhere\.csv"):
        import_path(path, tmp_path / "out")


def test_a_campaign_with_a_byte_order_mark_is_read(tmp_path):
    path = campaign(tmp_path)
    path.write_text("\ufeff" + path.read_text(encoding="utf-8"), encoding="utf-8")
    assert len(import_path(path, tmp_path / "out").paths) == 2


def test_a_link_out_of_the_folder_is_refused(tmp_path):
    (tmp_path / "campaign").mkdir()
    path = campaign(tmp_path / "campaign")
    secret = path.with_name("trial-01.csv").rename(tmp_path / "secret.csv")
    path.with_name("trial-01.csv").symlink_to(secret)
    with pytest.raises(ConfigError, match=r"trial-01\.csv: is a link to a file outside") as caught:
        import_path(path, tmp_path / "out")
    assert "copy the file to the folder" in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_table_of_another_folder_may_be_named(tmp_path):
    (tmp_path / "campaign").mkdir()
    path = campaign(tmp_path / "campaign", file="../elsewhere.csv")
    path.with_name("trial-01.csv").rename(tmp_path / "elsewhere.csv")
    assert import_path(path, tmp_path / "out").paths[0].name == "elsewhere.mcap"


@pytest.mark.parametrize(
    "text", ["", "x = " + 20_000 * "[", "config = 1 = 2", "config = 'none.toml'\n[[trial]]\nfile = 'trial-01.csv'"]
)
def test_broken_campaign_files(tmp_path, text):
    path = campaign(tmp_path)
    path.write_text(text)
    with pytest.raises(ConfigError):
        import_path(path, tmp_path / "out")


def test_nothing_is_imported_over_an_existing_recording(tmp_path):
    path = campaign(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "trial-02.mcap").write_bytes(b"precious")
    with pytest.raises(InputError, match="--force"):
        import_path(path, tmp_path / "out")
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["trial-02.mcap"]
    import_path(path, tmp_path / "out", overwrite=True)
    assert read_recording(tmp_path / "out" / "trial-02.mcap").is_complete


def test_other_kinds_of_files(tmp_path):
    for name in ("frames.log", "frames.log.gz", "frames.asc", "frames.blf"):
        with pytest.raises(FramesNeedDbc, match="DBC"):
            import_path(tmp_path / name, tmp_path)
    with pytest.raises(InputError, match="is already a recording"):
        import_path(tmp_path / "a.mcap", tmp_path)
    with pytest.raises(InputError, match="unknown format"):
        import_path(tmp_path / "a.docx", tmp_path)
    with pytest.raises(InputError, match="no such file"):
        import_path(tmp_path / "a.csv", tmp_path)


DAMPER = Path(os.environ.get("SAWBENCH_SHARED") or Path(__file__).parents[3] / "shared") / "data"
DAMPER = DAMPER / "friction_backlash_damper" / "d3_1Hz_30lb_1in.csv"


@pytest.mark.skipif(not DAMPER.is_file(), reason="shared data absent")
def test_a_real_table_comes_in_as_it_is(tmp_path):
    recording = read_recording(import_path(DAMPER, tmp_path).paths[0])
    with DAMPER.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    for name in ("displacement_mm", "force_n"):
        signal = recording.signal(name)
        assert signal.values.tolist() == [float(row[name]) for row in rows]
        assert signal.time_s.tolist() == [float(row["time_s"]) for row in rows]
        assert not signal.gaps


AXIS = """[linear_axis]
moving_mass_kg = { nominal = 95.0, rel_std = 0.1 }
viscous_damping_n_s_per_m = { nominal = 200.0, rel_std = 0.3 }
drive_channel = "force_n"
"""


@pytest.mark.parametrize(("config", "is_said"), [(AXIS, False), ("", True)])
def test_only_a_saw_has_the_travel_and_the_forces_of_a_saw(tmp_path, config, is_said):
    rows = [(0.001 * k, 20.0 * k, 900.0 * k) for k in range(20)]
    path = tmp_path / "moves.csv"
    path.write_text(table(("time_s", "displacement_mm", "force_n"), rows))
    report = import_path(path, tmp_path / "out", config_toml=config)
    assert [name in " ".join(report.warnings) for name in ("outside -200 to 200 mm", "outside -5000 to 5000 N")] == [
        is_said,
        is_said,
    ]
