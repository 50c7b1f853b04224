"""Instruments that send lines: what the makers' documents and the common sketches say, byte for byte."""

from __future__ import annotations

import re

import numpy as np
import pytest
from sawbench.acquisition.devices import build_devices, validate_table
from sawbench.acquisition.devices.lines import LABELLED_NUMBER, LineFormat, LineFramer
from sawbench.bench.config import BenchConfig
from sawbench.bench.errors import ConfigError, NoAnswerError, OtherInstrumentError

from tests.rigs.dialogue import opened

pytestmark = pytest.mark.contract

FORCE = {"force_n": {"input": 1}}


def make(name, table, clock):
    instrument, settings = validate_table(name, {"port": "COM3", "channels": FORCE, **table})
    return instrument.make(name, settings, clock)


def values(pieces):
    return [value for piece in pieces for value in piece.values[:, 0].tolist()]


# --- lines ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "line", "numbers"),
    [
        ({"columns": (2,)}, "a  7.5\tb", (7.5,)),
        ({"columns": (2, 1), "separator": ","}, "-1, +2e-3 ,3", (2e-3, -1.0)),
        ({"columns": (1,), "separator": ";", "has_decimal_comma": True}, "1,25;0,5", (1.25,)),
        ({"columns": (1,), "pattern": re.compile(r"F=(\S+) N")}, "t=5 F=-3.0 N", (-3.0,)),
        ({"columns": (3,), "separator": ","}, "1,2", None),
        ({"columns": (1,)}, "1_0", None),
        ({"columns": (1,)}, "nan", None),
        ({"columns": (1,)}, "0x10", None),
        ({"columns": (1,)}, "", None),
    ],
)
def test_numbers_are_found_in_their_columns(options, line, numbers):
    assert LineFormat(**options).numbers(line) == numbers


def test_lines_split_anywhere():
    data = b"1.5\r\n2.5\r\n-3\r\n"
    for cut in range(len(data)):
        framer = LineFramer(LineFormat(columns=(1,)), is_begun=True)
        assert values(framer.feed(data[:cut])) + values(framer.feed(data[cut:])) == [1.5, 2.5, -3.0]
        assert framer.n_discarded_bytes == 0


@pytest.mark.parametrize("broken", [b"2\xb4.5\n", b"2.5x\n", b"2.5\r3.5\n", b"2..5\n"])
def test_a_broken_line_is_a_lost_sample_and_never_a_value(broken):
    framer = LineFramer(LineFormat(columns=(1,)), is_begun=True)
    first, second = framer.feed(b"1\n" + broken + b"4\n")
    assert (values([first]), first.n_lost) == ([1.0], 0)
    assert (values([second]), second.n_lost) == ([4.0], 1)
    assert framer.n_discarded_bytes == len(broken)


def test_what_never_ends_is_given_up():
    framer = LineFramer(LineFormat(columns=(1,)), is_begun=True)
    assert framer.feed(b"1" * 5000) == []
    assert framer.n_discarded_bytes > 5000
    assert values(framer.feed(b"\n7\n")) == [7.0]


# --- HX711 ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "number"),
    [
        ("-8421", -8421.0),
        ("HX711 reading: 8421", 8421.0),
        ("one reading:\t12.3\t| average:\t12.4", 12.3),
        ("Reading: -0.5 lbs calibration_factor: -7050", -0.5),
        ("Load_cell output val: 1.25", 1.25),
        ("HX711 reading: ", None),
        ("HX711 not found.", None),
        ("Reading: 12.5kg3", None),
        ("12.5, 13.0", 12.5),
        ("12.5\t13.0", 12.5),
        ("12.5 kg", 12.5),
        ("Weight: 12,5 kg", None),
        ("-0,75", None),
        ("1,234", None),
        ("Reading: 1 234", None),
        ("1  234 567", None),
    ],
)
def test_lines_of_the_common_sketches(line, number):
    expected = None if number is None else (number,)
    assert LineFormat(columns=(1,), pattern=LABELLED_NUMBER).numbers(line) == expected


@pytest.mark.parametrize("line", [b"Weight: 12,5 kg\r\n", b"Reading: 1 234\r\n"])
def test_a_number_that_may_go_on_is_a_lost_sample(line):
    framer = LineFramer(LineFormat(columns=(1,), pattern=LABELLED_NUMBER), is_begun=True)
    pieces = framer.feed(b"1\r\n" + line + b"2\r\n")
    assert [(piece.values.tolist(), piece.n_lost) for piece in pieces] == [([[1.0]], 0), ([[2.0]], 1)]
    assert framer.n_discarded_bytes == len(line)


def test_a_sketch_that_prints_label_and_number_on_two_lines_loses_nothing(monkeypatch):
    def sketch(name, table, clock):
        device = make(name, table, clock)
        device._link.give(b"HX711 reading: \r\n1\r\n")
        return device

    device, port = opened(monkeypatch, sketch, {"driver": "hx711"})
    port.give(b"7\r\nHX711 reading: \r\n100\r\nHX711 reading: \r\n200\r\n")
    (chunk,) = device.read()
    assert (chunk.raw[:, 0].tolist(), chunk.n_lost) == ([100.0, 200.0], 0)
    assert port.sent == [b""]


def test_silence_is_said(monkeypatch):
    with pytest.raises(NoAnswerError, match="no readable data within 5 s"):
        opened(monkeypatch, make, {"driver": "hx711"})


# --- Loadstar ------------------------------------------------------------------------------------------------

ILOAD = {b"\r": b"A\r\n", b"SS1\r": b"F230\r\n"}


def test_iload_as_the_command_set_says(monkeypatch):
    device, port = opened(monkeypatch, make, {"driver": "loadstar", "serial_number": "F230"}, ILOAD)
    device.start()
    port.give(b"2345\r\n-12\r\n")
    (chunk,) = device.read()
    device.stop()
    # Millipounds: "if the reading returned is 2345, the sensor reading is equivalent to 2.345 lb".
    assert chunk.raw[:, 0].tolist() == [2345.0, -12.0]
    assert port.sent == [b"\r", b"\r", b"SS1\r", b"O0W0\r", b"\r"]
    assert device.describe()["serial_number"] == "F230"


def test_di_1000_as_the_command_set_says(monkeypatch):
    answers = {b"\r": b"A\r\n", b"ID\r": b"W1234-5678\r\n"}
    device, port = opened(monkeypatch, make, {"driver": "loadstar", "family": "di1000"}, answers)
    device.start()
    # %12.4f
    port.give(b"      3.0400\r\n     -0.0005\r\n")
    (chunk,) = device.read()
    assert chunk.raw[:, 0].tolist() == [3.04, -0.0005]
    assert port.sent[-1] == b"WC\r"


def test_another_loadstar_is_refused(monkeypatch):
    with pytest.raises(OtherInstrumentError, match="F230, the configuration names F999"):
        opened(monkeypatch, make, {"driver": "loadstar", "serial_number": "F999"}, ILOAD)


def test_what_does_not_answer_a_carriage_return_is_no_loadstar(monkeypatch):
    with pytest.raises(NoAnswerError, match="answered a carriage return with ''"):
        opened(monkeypatch, make, {"driver": "loadstar"})


# --- Mantracourt, ASCII --------------------------------------------------------------------------------------

DSC = {b"!001:SOUT?\r": b"+00032.100\r", b"!001:SERL?\r": b"+00345.000\r", b"!001:SERH?\r": b"+00012.000\r"}


def test_mantracourt_as_the_manual_says(monkeypatch):
    # 65536 * SERH + SERL
    device, port = opened(monkeypatch, make, {"driver": "mantracourt", "serial_number": "786777"}, DSC)
    device.start()
    (chunk,) = device.read()
    assert chunk.raw.tolist() == [[32.1]]
    asked_s, arrival_s = port.clock() - 1.0, float(chunk.arrival_s[0])
    assert asked_s < float(chunk.time_s[0]) < arrival_s
    assert port.sent[-1] == b"!001:SOUT?\r"


def test_a_refused_question_is_no_reading(monkeypatch):
    with pytest.raises(NoAnswerError, match="SOUT"):
        opened(monkeypatch, make, {"driver": "mantracourt"}, dict.fromkeys(DSC, b"?\r"))


def test_the_station_is_in_the_question(monkeypatch):
    answers = {b"!042:SYS?\r": b"-00001.500\r"}
    device, _ = opened(monkeypatch, make, {"driver": "mantracourt", "station": 42, "parameter": "SYS"}, answers)
    assert device.read()[0].raw.tolist() == [[-1.5]]
    assert "serial_number" not in device.describe()


# --- lines of the configuration alone ------------------------------------------------------------------------


def test_a_polled_instrument_of_the_configuration(monkeypatch):
    # Keyence DL-RS1A: M0 reads all sensors, ER is an error.
    table = {"driver": "text_lines", "question": "M0\r\n", "separator": ",", "channels": {"force_n": {"input": 2}}}
    device, port = opened(monkeypatch, make, table, {b"M0\r\n": b"M0,+00012.345\r\n"})
    assert device.read()[0].raw.tolist() == [[12.345]]
    port._answers[b"M0\r\n"] = b"ER,M0,21\r\n"
    assert device.read() == []


def test_the_time_stamps_of_the_instrument_are_its_times(monkeypatch):
    table = {"driver": "text_lines", "time_column": 1, "time_bits": 32, "channels": {"force_n": {"input": 2}}}

    def sending(name, table, clock):
        device = make(name, table, clock)
        device._link.give(b"0 0\n1 1\n")
        return device

    device, _ = opened(monkeypatch, sending, table)
    assert device.streams[0].rate_hz == 0.0
    # Every 10 ms by micros(), which begins at 0 again; all arrive 1 ms later, in steps of 100 ms.
    taken_s = np.arange(100) * 0.01
    times_s = []
    device.decode(b"\n", 0.0)
    for k in range(0, 100, 10):
        stamps = (2**32 - 500_000 + np.round(taken_s[k : k + 10] * 1e6).astype(int)) % 2**32
        lines = b"".join(b"%d %d\n" % (stamp, i) for i, stamp in enumerate(stamps))
        for chunk in device.decode(lines, 7.001 + taken_s[k + 9]):
            times_s += chunk.time_s.tolist()
    assert len(times_s) == 100
    assert times_s == pytest.approx((7.001 + taken_s).tolist(), abs=2e-5)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, "exactly one of rate_hz, time_column and question"),
        ({"rate_hz": 10, "question": "?"}, "exactly one of"),
        ({"question": "?", "counter_column": 2}, "counter_column needs rate_hz"),
        ({"rate_hz": 10, "stop": "x"}, "stop needs start"),
        ({"rate_hz": 10, "pattern": "("}, "is not a regular expression"),
        ({"rate_hz": 10, "pattern": "a"}, "has no group"),
        (
            {"rate_hz": 10, "pattern": "(a)", "channels": {"force_n": {"input": 2}}},
            "1 groups, but group 2 is configured",
        ),
        ({"rate_hz": 10, "pattern": "(a)", "separator": ","}, "not both"),
        ({"rate_hz": 10, "decimal": ",", "separator": ","}, "cannot be told apart"),
        ({"rate_hz": 10, "channels": {"force_n": {"input": 65}}}, "columns are numbered 1..64"),
    ],
)
def test_a_table_that_does_not_fit_together_is_one_clear_message(table, message):
    given = {"driver": "text_lines", "port": "COM3", "channels": FORCE, **table}
    with pytest.raises(ConfigError, match=message):
        build_devices(BenchConfig(devices={"cell": given}))
