"""Recordings for other programs: every bit of every sample, gaps that show, metadata that is kept."""

from __future__ import annotations

import csv
import json
from datetime import UTC, datetime

import numpy as np
import pyarrow.parquet
import pytest
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Event, Gap, Recording, Signal, Trial
from sawbench.storage.export import export_recording
from sawbench.storage.importers import import_path
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.unit

STARTED_AT = datetime(2026, 3, 2, 9, 0, 0, 123456, tzinfo=UTC)
# Numbers that a careless way loses: the sign of zero, the smallest and largest, a sum of rounded ones.
AWKWARD = np.array([-0.0, 5e-324, -1.7976931348623157e308, 0.1 + 0.2, 1 / 3, 12345678.000000002, 1e-7, np.pi])
LOST = Gap(start_s=3.0, end_s=7.0, n_missing=3, reason="the link was gone")
SILENT = Gap(start_s=9.5, end_s=12.5, n_missing=6, reason="the instrument was gone")


def signal(channel, unit, time_s, values, **kwargs):
    return Signal(channel=channel, unit=unit, time_s=time_s, values=values, **kwargs)


def a_recording(**kwargs):
    """Voltage and current of one device share their times; force and current each have a gap of their own."""
    force_s = np.array([0.0, 1.0, 2.0, 3.0, 7.0, 8.0, 9.0, 10.0])
    drive_s = np.linspace(0.0, 9.5, 20)
    power_s = np.sort(np.random.default_rng(5).uniform(-0.01, 10.0, 8))
    signals = [
        signal("force_n", "N", force_s, AWKWARD, raw=np.arange(8.0) - 3, gaps=(LOST,), device="load_cell"),
        signal("battery_voltage_v", "V", power_s, AWKWARD[::-1], device="power"),
        signal("motor_current_a", "A", drive_s, np.arange(20) / 7, gaps=(SILENT,), device="drive"),
        signal("battery_current_a", "A", power_s, AWKWARD / 3, device="power"),
    ]
    filled = {
        "trial": Trial(trial_id="T1", material="oak", duty=0.4375, operator="Kim", started_at=STARTED_AT, notes="ü"),
        "signals": {one.channel: one for one in signals},
        "events": (Event(kind="note", time_s=2.5, text="knot", end_s=3.0),),
        "config_toml": "[battery]\ncapacity_ah = 1.5\n",
        "provenance": {"calibration force_n": "12.5 N per mV/V"},
        "path": "some/where/T1.mcap",
    }
    return Recording(**filled | kwargs)


def written(tmp_path, file_format, recording=None, **kwargs):
    report = export_recording(recording or a_recording(), tmp_path / "out", file_format=file_format, **kwargs)
    return {path.name: path for path in report.paths}


def cells_of_csv(path):
    with path.open(newline="", encoding="utf-8") as stream:
        names, *rows = csv.reader(stream)
    return {name: [float(row[k]) if row[k] else None for row in rows] for k, name in enumerate(names)}


def cells_of_parquet(path):
    return pyarrow.parquet.read_table(path).to_pydict()


def samples_in(cells, channel):
    """Times and values of the rows that are no gap, as bytes."""
    rows = [(t, v) for t, v in zip(cells["time_s"], cells[channel], strict=True) if v is not None]
    return tuple(np.array(column).tobytes() for column in zip(*rows, strict=True))


@pytest.mark.parametrize(("file_format", "read"), [("csv", cells_of_csv), ("parquet", cells_of_parquet)])
def test_every_bit_of_every_sample_comes_back_from_a_table(tmp_path, file_format, read):
    recording = a_recording()
    files = written(tmp_path, file_format, recording, with_raw=True)
    about = json.loads(files[f"T1.{file_format}.json"].read_text())
    assert set(about["channels"]) == set(recording.signals)
    for channel, own in recording.signals.items():
        cells = read(files[about["channels"][channel]["file"]])
        assert samples_in(cells, channel) == (own.time_s.tobytes(), own.values.tobytes())
    force = read(files[f"T1.force_n.{file_format}"])
    assert [v for v in force["force_n_raw"] if v is not None] == [-3, -2, -1, 0, 1, 2, 3, 4]
    assert list(read(files[f"T1.battery_voltage_v+battery_current_a.{file_format}"])) == [
        "time_s", "battery_voltage_v", "battery_current_a",
    ]  # fmt: skip
    assert len(files) == 4


def test_every_bit_of_every_sample_comes_back_from_mf4_with_its_metadata(tmp_path):
    from asammdf import MDF

    recording = a_recording()
    files = written(tmp_path, "mf4", recording, with_raw=True)
    assert sorted(files) == ["T1.mf4", "T1.mf4.json"]
    with MDF(files["T1.mf4"]) as measurement:
        assert len(measurement.groups) == 3
        for channel, own in recording.signals.items():
            found = measurement.get(channel)
            is_sample = ~np.isnan(found.samples)
            assert found.samples[is_sample].tobytes() == own.values.tobytes()
            assert found.timestamps[is_sample].tobytes() == own.time_s.tobytes()
            assert (found.unit, found.comment) == (own.unit, own.device)
        assert measurement.get("force_n").timestamps[np.isnan(measurement.get("force_n").samples)] == [5.0]
        assert measurement.get("force_n_raw").samples.tolist()[:4] == [-3, -2, -1, 0]
        assert measurement.header.start_time == STARTED_AT
        assert bytes(measurement.extract_attachment(index=0)[0]) == files["T1.mf4.json"].read_bytes()


@pytest.mark.parametrize("started_at", [None, datetime(1969, 7, 20, tzinfo=UTC)])
def test_mf4_invents_no_start(tmp_path, started_at):
    from asammdf import MDF

    files = written(tmp_path, "mf4", a_recording(trial=Trial(trial_id="T1", started_at=started_at)))
    with MDF(files["T1.mf4"]) as measurement:
        assert measurement.header.start_time == datetime(1970, 1, 1, tzinfo=UTC)


def test_a_gap_is_one_row_without_values(tmp_path):
    files = written(tmp_path, "csv")
    lines = files["T1.force_n.csv"].read_text().splitlines()
    assert [k for k, line in enumerate(lines) if line.endswith(",")] == [5]
    assert lines[5] == "5,"
    # Nothing came any more: the row stands where the gap ends.
    assert files["T1.motor_current_a.csv"].read_text().splitlines()[-1] == "12.5,"
    assert ",\n" not in files["T1.battery_voltage_v+battery_current_a.csv"].read_text()


def test_an_export_that_is_imported_has_the_same_gap(tmp_path):
    time_s = np.r_[0:100, 130:200] * 1e-3
    gap = Gap(start_s=float(time_s[99]), end_s=float(time_s[100]), n_missing=30)
    own = signal("force_n", "N", time_s, 20 + np.arange(170.0), gaps=(gap,))
    files = written(tmp_path, "csv", a_recording(signals={"force_n": own}))
    assert list(files) == ["T1.csv", "T1.csv.json"]
    again = read_recording(import_path(files["T1.csv"], tmp_path / "again").paths[0]).signal("force_n")
    assert again.values.tobytes() == own.values.tobytes()
    (found,) = again.gaps
    assert (found.start_s, found.end_s, found.n_missing) == (gap.start_s, gap.end_s, 30)


def test_metadata_is_beside_the_tables_and_inside_parquet(tmp_path):
    files = written(tmp_path, "parquet", a_recording(is_complete=False), sha256="ab12")
    about = json.loads(files["T1.parquet.json"].read_text(encoding="utf-8"))
    assert about["recording"] == "T1.mcap"
    assert about["recording_sha256"] == "ab12"
    assert about["is_complete"] is False
    assert sorted([*about["files"], "T1.parquet.json"]) == sorted(files)
    assert about["trial"]["material"] == "oak"
    assert about["trial"]["notes"] == "ü"
    assert about["trial"]["started_at"] == "2026-03-02T09:00:00.123456+00:00"
    assert about["events"] == [
        {"kind": "note", "time_s": 2.5, "text": "knot", "device": "", "channel": "", "end_s": 3.0}
    ]
    assert about["provenance"] == {"calibration force_n": "12.5 N per mV/V"}
    assert about["config_toml"].startswith("[battery]")
    force = about["channels"]["force_n"]
    assert (force["unit"], force["device"], force["n_samples"], force["n_missing"]) == ("N", "load_cell", 8, 3)
    assert force["gaps"] == [{"start_s": 3.0, "end_s": 7.0, "n_missing": 3, "reason": "the link was gone"}]
    assert force["raw_column"] is None
    schema = pyarrow.parquet.read_schema(files["T1.force_n.parquet"])
    assert json.loads(schema.metadata[b"sawbench"]) == about
    assert schema.field("force_n").metadata[b"unit"] == b"N"


def test_one_table_that_exists_stops_the_export_before_anything_is_written(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "T1.motor_current_a.csv").write_text("mine")
    with pytest.raises(InputError, match="already exists"):
        written(tmp_path, "csv")
    assert [path.name for path in out.iterdir()] == ["T1.motor_current_a.csv"]
    files = written(tmp_path, "csv", overwrite=True)
    assert files["T1.motor_current_a.csv"].read_text().startswith("time_s,motor_current_a\n")


def test_channels_whose_names_are_no_file_names_keep_their_own_tables(tmp_path):
    values = {"a/b": 1.0, "a:b": 2.0, "A,B": 3.0}
    signals = {name: signal(name, "", [value, value + 1], [value, value]) for name, value in values.items()}
    files = written(tmp_path, "csv", a_recording(signals=signals))
    about = json.loads(files["T1.csv.json"].read_text())
    assert len({about["channels"][name]["file"].casefold() for name in values}) == 3
    for name, value in values.items():
        assert cells_of_csv(files[about["channels"][name]["file"]])[name] == [value, value]


def test_a_recording_without_samples_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"T1\.mcap: contains no samples"):
        written(tmp_path, "csv", a_recording(signals={}))


def test_a_raw_column_does_not_take_the_name_of_a_channel(tmp_path):
    with_raw = signal("x", "", [0.0, 1.0], [1.0, 2.0], raw=[3.0, 4.0])
    other = signal("x_raw", "", [0.0, 1.0], [5.0, 6.0])
    recording = a_recording(signals={"x": with_raw, "x_raw": other})
    with pytest.raises(InputError, match="two columns x_raw"):
        written(tmp_path, "csv", recording, with_raw=True)
    assert cells_of_csv(written(tmp_path, "csv", recording)["T1.csv"])["x_raw"] == [5.0, 6.0]
