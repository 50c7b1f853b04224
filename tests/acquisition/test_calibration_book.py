"""The calibration book: order, history, what no longer fits, what is in force."""

from __future__ import annotations

import os
import threading
from datetime import UTC, datetime, timedelta

import pytest
from sawbench.acquisition import calibration_book
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.calibration_book import (
    BookEntry,
    CalibrationBook,
    add_entry,
    build_calibrated,
    not_in_book,
    provenance,
    read_book,
    refuse_uncalibrated,
    said_in_force,
    zeroed,
)
from sawbench.bench.config import parse_config
from sawbench.bench.errors import ConfigError, InputError
from sawbench.bench.units import CHANNEL_BY_NAME

pytestmark = pytest.mark.unit

TEXT = """[devices.cell]
driver = "gsv8"
port = "COM3"
[devices.cell.channels.force_n]
input = 1
raw_range = [-3.5, 3.5]
calibration = {{ scale = {scale}, raw_unit = "mV/V", source = "{source}" }}
[devices.power]
driver = "dbc_can"
port = "COM4"
signals = {{ motor_current_a = "MotorStatus.MotorCurrent" }}
"""
CONFIG = parse_config(TEXT.format(scale=250.0, source="nominal")).config
CONFIGURED = Calibration(scale=250.0, raw_unit="mV/V", source="nominal")
BEGUN = datetime(2026, 3, 2, 9, tzinfo=UTC)


def entry(kind, hour, **values):
    return BookEntry(
        kind=kind, device="cell", channel="force_n", made_at=BEGUN + timedelta(hours=hour), zero_std_raw=1e-4,
        result=Calibration(raw_unit="mV/V", **values), configured=CONFIGURED, seconds=5.0, operator="Kim",
        details={"points": [{"reference": 0.0}]},
    )  # fmt: skip


def in_force(*entries, config=CONFIG):
    devices, _ = build_calibrated(config, CalibrationBook(entries=entries))
    return {c.name: c.calibration for d in devices for s in d.streams for c in s.channels}


def test_without_a_book_the_configuration_holds():
    assert in_force()["force_n"] == CONFIGURED


def test_a_channel_without_any_calibration_is_refused():
    """A tare alone gives no scale; a calibration of the book does."""
    bare = {("cell", "force_n"): Calibration()}
    for book in (CalibrationBook(), CalibrationBook(entries=(entry("tare", 0, zero_raw=0.1),))):
        with pytest.raises(ConfigError, match="has no calibration") as caught:
            refuse_uncalibrated(book, bare, CHANNEL_BY_NAME)
        assert "[devices.cell] force_n" in str(caught.value) and "sawbench calibrate" in str(caught.value)
    refuse_uncalibrated(CalibrationBook(entries=(entry("calibration", 0, scale=245.0),)), bare, CHANNEL_BY_NAME)
    for present in (CONFIGURED, Calibration(source="sends N")):
        refuse_uncalibrated(CalibrationBook(), {("cell", "force_n"): present}, CHANNEL_BY_NAME)


def test_another_unit_without_a_scale_is_no_calibration():
    """A forgotten scale is 1: millivolts per volt would be recorded as newtons."""
    forgotten = {("cell", "force_n"): Calibration(raw_unit="mV/V", source="certificate 7")}
    with pytest.raises(ConfigError, match="raw_unit 'mV/V' but no scale: mV/V would be taken for N"):
        refuse_uncalibrated(CalibrationBook(), forgotten, CHANNEL_BY_NAME)
    calibrated = CalibrationBook(entries=(entry("calibration", 0, scale=245.0),))
    refuse_uncalibrated(calibrated, forgotten, CHANNEL_BY_NAME)
    for present in (
        Calibration(raw_unit="N", source="the instrument sends N"),
        Calibration(raw_unit="newton", scale=1.0, source="the instrument sends N"),
        Calibration(raw_unit="V", polynomial=(0.0, 100.0), source="certificate 7"),
    ):
        refuse_uncalibrated(CalibrationBook(), {("cell", "force_n"): present}, CHANNEL_BY_NAME)


def test_a_byte_order_mark_and_open_brackets_in_the_book(tmp_path):
    path = tmp_path / "bench_config.calibration.toml"
    add_entry(path, entry("calibration", 0, scale=245.0))
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(read_book(path).entries) == 1
    path.write_text("x = " + 20_000 * "[")
    with pytest.raises(
        InputError, match="is not a calibration book: is not valid TOML: brackets are nested too deeply"
    ):
        read_book(path)


def test_the_latest_calibration_and_the_latest_tare_after_it_are_in_force():
    first, second = entry("tare", 0, scale=250.0, zero_raw=0.1), entry("tare", 1, scale=250.0, zero_raw=0.2)
    made = entry("calibration", 2, scale=245.0, zero_raw=0.3)
    after = entry("tare", 3, scale=245.0, zero_raw=0.4)
    assert in_force(first)["force_n"].zero_raw == 0.1
    assert in_force(first, second)["force_n"].zero_raw == 0.2
    found = in_force(first, second, made)["force_n"]
    assert (found.scale, found.zero_raw) == (245.0, 0.3)
    found = in_force(first, second, made, after)["force_n"]
    assert (found.scale, found.zero_raw) == (245.0, 0.4)
    assert "calibration of 2026-03-02T11:00" in found.source and "tare of 2026-03-02T12:00" in found.source
    assert "Kim" in found.source and "nominal" in found.source
    assert "09:00" not in found.source


def test_a_channel_on_the_bus_can_be_calibrated_too():
    base = in_force()["motor_current_a"]
    made = BookEntry(
        kind="tare", device="power", channel="motor_current_a", made_at=BEGUN, zero_std_raw=0.0, seconds=1.0,
        result=base.model_copy(update={"zero_raw": 0.25}), configured=base,
    )  # fmt: skip
    assert in_force(made)["motor_current_a"].apply(0.25) == pytest.approx(0.0)


def test_a_configuration_that_was_changed_since_is_refused():
    tare = entry("tare", 0, scale=250.0, zero_raw=0.1)
    other = parse_config(TEXT.format(scale=251.0, source="certificate")).config
    with pytest.raises(ConfigError, match="changed since the tare"):
        in_force(tare, config=other)
    # Other words for the same numbers change nothing.
    same = parse_config(TEXT.format(scale=250.0, source="certificate 4711")).config
    assert in_force(tare, config=same)["force_n"].zero_raw == 0.1


def test_an_entry_of_a_device_with_another_name_is_refused_with_both_names():
    """A calibration that is not applied must not get lost in silence; one of the new name makes up for it."""
    renamed = parse_config(TEXT.format(scale=250.0, source="nominal").replace("devices.cell", "devices.sensor")).config
    made, tare = entry("calibration", 0, scale=245.0), entry("tare", 1, scale=245.0, zero_raw=0.1)
    for book in ((made,), (tare,), (made, tare)):
        with pytest.raises(
            ConfigError, match="of device 'cell', which is not configured; force_n is given by 'sensor'"
        ):
            in_force(*book, config=renamed)
    new_tare = tare.model_copy(update={"device": "sensor"})
    new = made.model_copy(update={"device": "sensor", "result": Calibration(raw_unit="mV/V", scale=240.0)})
    assert in_force(tare, new_tare, config=renamed)["force_n"].zero_raw == 0.1
    assert in_force(made, tare, new, config=renamed)["force_n"].scale == 240.0
    # A tare has no gain.
    with pytest.raises(ConfigError, match="sawbench calibrate --channel force_n"):
        in_force(made, new_tare, config=renamed)


def test_what_is_said_to_be_in_force_is_what_is_applied(tmp_path):
    """A channel that no device gives is not said; one without an entry is, with where its book would be."""
    book = CalibrationBook(entries=(entry("calibration", 0, scale=245.0),))
    bus = {("power", "motor_current_a"): Calibration()}
    cell, path = {("cell", "force_n"): CONFIGURED}, tmp_path / "improved_model.calibration.toml"
    assert said_in_force(book, bus, BEGUN) == []
    (line,) = said_in_force(book, bus | cell, BEGUN)
    assert line.startswith("force_n: calibration of 2026-03-02")
    assert not_in_book(book, bus | cell, CHANNEL_BY_NAME, path) == []
    ((device, channel, what),) = not_in_book(CalibrationBook(), bus | cell, CHANNEL_BY_NAME, path)
    assert (device, channel) == ("cell", "force_n") and f"no calibration book was found at {path}" in what
    path.touch()
    ((_, _, what),) = not_in_book(CalibrationBook(), bus | cell, CHANNEL_BY_NAME, path)
    assert f"{path} has no entry of it" in what


def test_the_file_keeps_everything_and_comes_back(tmp_path):
    path = tmp_path / "bench_config.calibration.toml"
    assert read_book(path).entries == ()
    entries = [
        entry("tare", 0, scale=250.0, zero_raw=1 / 3),
        entry("calibration", 1, scale=245.0, zero_raw=0.1),
        entry("calibration", 2, scale=246.0, zero_raw=0.1),
    ]
    for one in entries:
        add_entry(path, one)
    assert read_book(path).entries == tuple(entries)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.skipif(os.name != "posix", reason="this system has no lock of a folder")
def test_two_entries_at_once_are_both_kept(tmp_path, monkeypatch):
    """While the first is being written, a second one comes."""
    path, write, others = tmp_path / "book.toml", calibration_book.write_whole, []

    def slow(*arguments, **options):
        if not others:
            second = entry("tare", 1, scale=251.0)
            others.append(threading.Thread(target=lambda: add_entry(path, second)))
            others[0].start()
            others[0].join(0.3)
        return write(*arguments, **options)

    monkeypatch.setattr(calibration_book, "write_whole", slow)
    add_entry(path, entry("tare", 0, scale=250.0))
    others[0].join()
    assert [kept.result.scale for kept in read_book(path).entries] == [250.0, 251.0]


@pytest.mark.parametrize("text", ["entries = 3", "[[entries]]\nkind = 'guess'\n", "=", "schema_version = 2"])
def test_a_broken_book_is_an_input_error_and_stays(tmp_path, text):
    path = tmp_path / "book.toml"
    path.write_text(text)
    with pytest.raises(InputError, match="not a calibration book"):
        add_entry(path, entry("tare", 0, scale=250.0))
    assert path.read_text() == text


def test_provenance_holds_the_entries_in_force_whole():
    tare = entry("tare", 0, scale=250.0, zero_raw=0.1)
    book = CalibrationBook(entries=(entry("tare", -1, scale=250.0, zero_raw=0.7), tare))
    kept = provenance(book, {("cell", "force_n"): CONFIGURED, ("power", "motor_current_a"): Calibration()})
    assert list(kept) == ["calibration book force_n"]
    import json

    (found,) = json.loads(kept["calibration book force_n"])
    assert BookEntry.model_validate(found) == tare


@pytest.mark.parametrize(
    "calibration",
    [
        Calibration(scale=-3.0, offset=7.0, zero_raw=0.2),
        Calibration(polynomial=(1.0, 20.0, 0.5)),
        Calibration(polynomial=(1.0, 20.0, 0.5), zero_raw=0.3),
    ],
)
def test_zeroed_is_zero_at_rest_and_keeps_the_slope_there(calibration):
    found = zeroed(calibration, 0.11)
    assert found.apply(0.11) == pytest.approx(0.0, abs=1e-12)
    assert found.slope_at(0.11) * calibration.slope_at(0.11) > 0
    with pytest.raises(InputError, match="has no zero"):
        zeroed(Calibration(polynomial=(1.0, 0.0, 1.0)), 0.0)
