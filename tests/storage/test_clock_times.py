"""When a trial started, by the times of its table."""

from __future__ import annotations

from datetime import UTC

import pytest
from sawbench.bench.errors import ConfigError, InputError
from sawbench.storage.importers import import_path, load_map
from sawbench.storage.importers.table_map import parse_map
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.unit

IN_MILLISECONDS = '[columns]\ntime_s = { column = "time_s", unit = "ms" }\n'
SAID = "when the trial started is not recorded"


def in_zone(name):
    return f'[table]\ntime_zone = "{name}"\n'


def taken_in(folder, first, second, map_toml=""):
    """Import a table of two rows; return its recording and what was said."""
    (folder / "t.csv").write_text(f"time_s,force_n\n{first},1\n{second},2\n")
    (folder / "map.toml").write_text(map_toml)
    report = import_path(folder / "t.csv", folder / "out", table_map=load_map(folder / "map.toml"))
    return read_recording(report.paths[0]), report.notes


@pytest.mark.parametrize(
    ("first", "second", "map_toml", "started"),
    [
        ("2026-03-02T09:00:00.250+01:00", "2026-03-02T09:00:00.251+01:00", "", "2026-03-02T08:00:00.250000+00:00"),
        ("2026-03-02 09:00:00.250 UTC", "2026-03-02 09:00:00.251 UTC", "", "2026-03-02T09:00:00.250000+00:00"),
        ("2026/03/02 11:59:59.999 PM Z", "2026/03/03 12:00:00.000 AM Z", "", "2026-03-02T23:59:59.999000+00:00"),
        ("02.03.2026 09:00:00.5", "02.03.2026 09:00:00.501", in_zone("+01:00"), "2026-03-02T08:00:00.500000+00:00"),
        ("02.07.2026 09:00:00.5", "02.07.2026 09:00:00.501", in_zone("Europe/Berlin"),
         "2026-07-02T07:00:00.500000+00:00"),
        ("1772442000.250", "1772442000.251", "", "2026-03-02T09:00:00.250000+00:00"),
        ("1772442000250", "1772442000251", IN_MILLISECONDS, "2026-03-02T09:00:00.250000+00:00"),
    ],
)  # fmt: skip
def test_times_with_date_and_zone_say_when_the_trial_started(first, second, map_toml, started, tmp_path):
    recording, notes = taken_in(tmp_path, first, second, map_toml)
    assert recording.trial.started_at.astimezone(UTC).isoformat() == started
    assert recording.signal("force_n").time_s == pytest.approx([0.0, 0.001], abs=1e-6)
    assert not any(SAID in note for note in notes)


@pytest.mark.parametrize("date", ["02.03.2026", "3/2/2026", "2026-13-45"])
def test_a_date_without_zone_or_order_is_said_to_tell_nothing(date, tmp_path):
    zone = in_zone("Z") if date != "02.03.2026" else ""
    recording, notes = taken_in(tmp_path, f"{date} 09:00:00.5", f"{date} 09:00:00.6", zone)
    assert recording.trial.started_at is None
    assert sum(SAID in note for note in notes) == 1
    assert recording.signal("force_n").time_s == pytest.approx([0.0, 0.1])


@pytest.mark.parametrize(
    ("first", "second"), [("09:00:00.5", "09:00:00.6"), ("0.5", "0.6"), ("3855265200", "3855265201")]
)
def test_other_times_say_nothing_of_a_start(first, second, tmp_path):
    recording, notes = taken_in(tmp_path, first, second)
    assert recording.trial.started_at is None
    assert not any(SAID in note for note in notes)


def test_what_the_campaign_states_counts_more_than_the_table(tmp_path):
    (tmp_path / "t.csv").write_text("time_s,force_n\n1772442000.0,1\n1772442000.5,2\n")
    (tmp_path / "campaign.toml").write_text('[[trial]]\nfile = "t.csv"\nstarted_at = "2026-03-02T10:00:00+01:30"\n')
    (path,) = import_path(tmp_path / "campaign.toml", tmp_path / "out").paths
    recording = read_recording(path)
    assert recording.trial.started_at.isoformat() == "2026-03-02T10:00:00+01:30"
    assert recording.signal("force_n").time_s.tolist() == [0.0, 0.5]


def test_tables_of_two_clocks_with_dates_are_placed_over_days_and_zones(tmp_path):
    (tmp_path / "daq.csv").write_text("time_s,force_n\n2026-03-02T23:59:59.5+01:00,1\n2026-03-02T23:59:59.6+01:00,2\n")
    (tmp_path / "can.csv").write_text("time_s,motor_current_a\n1772492400.25,3\n1772492400.35,4\n")
    (tmp_path / "campaign.toml").write_text('[[trial]]\nfile = "daq.csv"\n[[trial.further]]\nfile = "can.csv"\n')
    (path,) = import_path(tmp_path / "campaign.toml", tmp_path / "out").paths
    # 1772492400 is 2026-03-02 23:00 UTC, which is midnight of the other clock.
    assert read_recording(path).signal("motor_current_a").time_s == pytest.approx([0.75, 0.85], abs=1e-6)


def test_a_time_zone_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"table\.time_zone: must be an offset such as .\+01:00.") as caught:
        parse_map({"table": {"time_zone": "Berlin"}}, where=tmp_path)
    assert "Berlin" in str(caught.value)


@pytest.mark.parametrize(
    ("first", "second", "apart_s"),
    [
        ("2026-03-02T09:00:00Z", "2026-03-04T09:00:01Z", 172801.0),
        ("2026-10-25T02:59:59.5+02:00", "2026-10-25T02:00:00.0+01:00", 0.5),
        ("11:59:59.5 AM", "12:00:00 PM", 0.5),
    ],
    ids=["two days", "summer time ends", "noon"],
)
def test_dates_and_zones_of_every_row_count(first, second, apart_s, tmp_path):
    recording, _ = taken_in(tmp_path, first, second)
    assert recording.signal("force_n").time_s == pytest.approx([0.0, apart_s])


def test_a_date_that_goes_back_is_refused(tmp_path):
    with pytest.raises(InputError, match="time_s does not increase"):
        taken_in(tmp_path, "2026-03-02T09:00:00Z", "2026-03-01T09:00:01Z")


@pytest.mark.parametrize(
    ("name", "unit", "first"),
    [("t.csv", "s", "1772442000.123456"), ("t.csv", "us", "1772442000123456"), ("t.json", "us", "1772442000123456")],
)
def test_no_digit_of_seconds_since_1970_is_lost(name, unit, first, tmp_path):
    """At 1 MHz a float64 of such a time is off by a quarter of a sample."""
    times = [f"{first[:-1]}{k}" for k in (0, 1, 2, 3)]
    if name == "t.csv":
        (tmp_path / name).write_text("time_s,force_n\n" + "".join(f"{t},{k}\n" for k, t in enumerate(times)))
    else:
        (tmp_path / name).write_text(f'{{"time_s": [{", ".join(times)}], "force_n": [0, 1, 2, 3]}}')
    (tmp_path / "map.toml").write_text(f'[columns]\ntime_s = {{ column = "time_s", unit = "{unit}" }}\n')
    (path,) = import_path(tmp_path / name, tmp_path / "out", table_map=load_map(tmp_path / "map.toml")).paths
    assert read_recording(path).signal("force_n").time_s == pytest.approx([0.0, 1e-6, 2e-6, 3e-6], abs=1e-10)


def test_milliseconds_since_1970_ask_for_their_unit(tmp_path):
    with pytest.raises(InputError, match="probably ms since 1970") as caught:
        taken_in(tmp_path, "1772442000250", "1772442000251")
    assert "t.csv, column time_s" in str(caught.value) and "unit = 'ms'" in str(caught.value)


def test_a_table_of_another_day_is_asked_about(tmp_path):
    (tmp_path / "daq.csv").write_text("time_s,force_n\n2026-03-02T09:00:00Z,1\n2026-03-02T09:00:01Z,2\n")
    (tmp_path / "can.csv").write_text("time_s,motor_current_a\n2026-03-03T09:00:00Z,3\n2026-03-03T09:00:01Z,4\n")
    (tmp_path / "campaign.toml").write_text('[[trial]]\nfile = "daq.csv"\n[[trial.further]]\nfile = "can.csv"\n')
    report = import_path(tmp_path / "campaign.toml", tmp_path / "out")
    said = [text for text in report.warnings if text.startswith("can.csv: its times, 86400 to 86401 s, ")]
    assert len(said) == 1 and "do not overlap" in said[0]
    assert any("do not overlap" in event.text for event in read_recording(report.paths[0]).events)
