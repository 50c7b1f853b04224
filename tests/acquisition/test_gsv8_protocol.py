"""GSV-8 byte dialogues.

Vectors follow the maker's own descriptions: frame bits and commands from ME-Systeme's public Python library
(gsv86lib / gsv8pypi: sync AA, end 85, request 90 | n, answer 50 | n), data types and the binary offset
format from the header of their DLL (MEGSV86x64.h). Numbers inside are IEEE 754, worked out by hand.
"""

from __future__ import annotations

import struct
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sawbench.acquisition.devices import serial_instrument
from sawbench.acquisition.devices.device import joined
from sawbench.acquisition.devices.gsv8 import Gsv8, Gsv8Settings
from sawbench.acquisition.devices.gsv8_frames import Gsv8Framer, request
from sawbench.bench.errors import DeviceError, OtherInstrumentError

pytestmark = pytest.mark.contract

ONE, TWO = bytes.fromhex("aa10b03f80000085"), bytes.fromhex("aa10b04000000085")


@pytest.mark.parametrize(
    ("command", "parameters", "frame"),
    [
        (0x23, b"", "aa 90 23 85"),
        (0x24, b"", "aa 90 24 85"),
        (0x0C, b"\x01", "aa 91 0c 01 85"),
        (0x01, b"\x00", "aa 91 01 00 85"),
        (0x8B, struct.pack(">f", 6000.0), "aa 94 8b 45 bb 80 00 85"),
    ],
)
def test_requests(command, parameters, frame):
    assert request(command, parameters) == bytes.fromhex(frame)


def values_of(pieces):
    return np.concatenate([p.raw for p in pieces]) if pieces else np.empty((0, 0))


def test_float_frames_of_three_channels():
    framer = Gsv8Framer(n_values=3, data_type="float32")
    frame = bytes.fromhex("aa12b0 3f800000 c0000000 3f000000 85")
    assert values_of(framer.feed(frame * 2)).tolist() == [[1.0, -2.0, 0.5]] * 2


@pytest.mark.parametrize(
    ("data_type", "frame", "expected"),
    [
        ("int16", "aa1190 8000 c000 85", [0.0, 1.05]),
        ("int24", "aa11a0 800000 400000 85", [0.0, -1.05]),
    ],
)
def test_integers_are_binary_offset(data_type, frame, expected):
    framer = Gsv8Framer(n_values=2, data_type=data_type, full_scale=2.1)
    assert values_of(framer.feed(bytes.fromhex(frame) * 2))[0] == pytest.approx(expected)


def test_answers_between_measured_values():
    framer = Gsv8Framer(n_values=1, data_type="float32")
    assert values_of(framer.feed(ONE + ONE + bytes.fromhex("aa500085") + TWO))[:, 0].tolist() == [1, 1, 2]
    framer.feed(bytes.fromhex("aa517085 aa5101aa85") + ONE)
    assert [(a.error, a.payload) for a in framer.answers] == [(0, b""), (1, b"\xaa")]


def test_overload_bit_is_counted():
    framer = Gsv8Framer(n_values=1, data_type="float32")
    framer.feed(ONE + bytes.fromhex("aa10b13f80000085") + ONE)
    assert framer.n_overloads == 1


def test_sync_and_end_bytes_inside_the_payload_do_not_mislead():
    nasty = bytes.fromhex("aa10b0aaaaaa8585")
    framer = Gsv8Framer(n_values=1, data_type="float32")
    # Begin in the middle of a frame, so that the search has to find its way.
    raw = values_of(framer.feed((nasty * 50)[3:]))
    assert len(raw) == 49
    assert framer.n_discarded_bytes == 5


def test_a_payload_that_holds_a_whole_frame_is_passed_over():
    # Values 2 and 3 of four together spell a valid one-value frame header; the search starts inside.
    frame = b"\xaa\x13\xb0" + bytes.fromhex("00000000 aa10b03f 80000085 00000000") + b"\x85"
    framer = Gsv8Framer(n_values=4, data_type="float32")
    pieces = framer.feed((frame * 10)[5:])
    assert sum(len(p.raw) for p in pieces) == 9


def test_a_garbled_end_byte_costs_one_frame_and_is_counted_exactly():
    framer = Gsv8Framer(n_values=1, data_type="float32")
    bad = bytearray(ONE)
    bad[-1] = 0x00
    pieces = framer.feed(ONE * 5 + bytes(bad) + TWO * 5)
    assert [len(p.raw) for p in pieces] == [5, 5]
    assert (pieces[1].n_lost, pieces[1].is_loss_exact) == (1, True)
    assert framer.n_discarded_bytes == len(ONE)


def test_lost_bytes_are_a_loss_of_unknown_size():
    framer = Gsv8Framer(n_values=1, data_type="float32")
    stream = ONE * 20
    pieces = framer.feed(stream[: 5 * 8 + 3] + stream[8 * 8 + 5 :])
    assert pieces[1].n_lost >= 1
    assert not pieces[1].is_loss_exact
    assert sum(len(p.raw) for p in pieces) == 5 + 11


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=8, max_size=40),
    cuts=st.lists(st.integers(1, 300), max_size=10),
    bad_at=st.integers(0, 300),
    n_bad=st.integers(0, 30),
    flip=st.integers(1, 255),
)
def test_any_damage_in_any_split_loses_only_what_was_damaged(values, cuts, bad_at, n_bad, flip):
    frames = [b"\xaa\x10\xb0" + struct.pack(">f", v) + b"\x85" for v in values]
    stream = bytearray(b"".join(frames))
    bad_at = min(bad_at, len(stream))
    for k in range(bad_at, min(len(stream), bad_at + n_bad)):
        stream[k] ^= flip
    framer = Gsv8Framer(n_values=1, data_type="float32")
    edges = sorted({0, *(c for c in cuts if c < len(stream)), len(stream)})
    pieces = [p for a, b in pairwise(edges) for p in framer.feed(bytes(stream[a:b]))]
    got = len(values_of(pieces))
    n_touched = (min(len(stream), bad_at + n_bad) - 1) // 8 - bad_at // 8 + 1 if n_bad and bad_at < len(stream) else 0
    # Getting into step again needs two good frames in a row, so the damage may cost two neighbours.
    assert len(frames) - n_touched - 3 <= got <= len(frames)
    if not n_touched:
        assert got == len(frames)
        assert framer.n_discarded_bytes == 0


class ScriptedPort:
    """Stands in for the serial port: expects writes, gives the scripted answers, ends with silence."""

    def __init__(self, script, clock):
        self.script = [(bytes.fromhex(a), bytes.fromhex(b)) for a, b in script]
        self.clock = clock
        self.to_read = b""
        self.is_open = False

    def open(self):
        self.is_open = True

    def write(self, data):
        expected, answer = self.script.pop(0)
        assert data == expected
        self.to_read += answer

    def read(self):
        self.clock.now_s += 0.05
        data, self.to_read = self.to_read, b""
        return data

    def close(self):
        self.is_open = False


class Clock:
    now_s = 0.0

    def __call__(self):
        return self.now_s


STOP = ("aa902385", "aa500085")
IDENTITY = ("aa91010085", "aa54000813400185")
RATE = ("aa948b45bb800085", "aa500085")
FIRMWARE = ("aa902b85", "aa5200012a85")
SERIAL = ("aa901f85", "aa540001350caf85")


def device_with(monkeypatch, script, **settings):
    clock = Clock()
    port = ScriptedPort(script, clock)
    monkeypatch.setattr(serial_instrument, "SerialPort", lambda *_a, **_k: port)
    table = Gsv8Settings.model_validate({"port": "COM3", "channels": {"force_n": {"input": 1}}, **settings})
    return Gsv8("load_cell", table, clock=clock), port


def test_dialogue_of_a_measurement(monkeypatch):
    script = [
        STOP,
        IDENTITY,
        SERIAL,
        RATE,
        FIRMWARE,
        ("aa902485", "aa500085"),
        ("aa910c0185", "aa500085"),
        ("aa902385", ""),
    ]
    device, port = device_with(monkeypatch, script)
    device.open()
    device.start()
    port.to_read = ONE + TWO + ONE
    (chunk,) = device.read()
    assert chunk.raw[:, 0].tolist() == [1.0, 2.0, 1.0]
    device.set_zero("force_n")
    device.stop()
    assert not port.script
    assert not port.is_open
    assert device.describe()["model"] == "GSV-8"
    assert device.describe()["serial_number"] == str(0x01350CAF)


def test_identity_says_one_value_of_type_float():
    # 08: GSV-8; 13: one object, not transmitting, type 3.
    assert IDENTITY[1] == "aa54" + "00" + "08134001" + "85"


def test_stop_is_repeated_while_values_pour_in(monkeypatch):
    script = [("aa902385", (ONE * 4).hex()), STOP, IDENTITY, SERIAL, RATE, FIRMWARE]
    device, port = device_with(monkeypatch, script)
    device.open()
    assert not port.script


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ([("aa902385", "")] * 3, "did not answer"),
        ([("aa902385", "aa507085")], "access denied"),
        ([STOP, ("aa91010085", "aa54000513400185")], "not as a GSV-8"),
        ([STOP, ("aa91010085", "aa54000803400185")], "input 1 is configured"),
        ([STOP, IDENTITY, SERIAL, ("aa948b45bb800085", "aa505485")], "value too large"),
        (
            [STOP, IDENTITY, SERIAL, ("aa948b45bb800085", "aa500185"), ("aa908a85", "aa540045 2f000085")],
            "uses 2800 Hz",
        ),
    ],
)
def test_what_can_go_wrong_is_said(monkeypatch, script, message):
    device, _ = device_with(monkeypatch, script)
    with pytest.raises(DeviceError, match=message) as caught:
        device.open()
    assert "load_cell" in str(caught.value)
    assert "COM3" in str(caught.value)
    assert caught.value.remedy


def test_the_amplifier_that_the_configuration_names_is_taken(monkeypatch):
    script = [STOP, IDENTITY, SERIAL, RATE, FIRMWARE]
    device, port = device_with(monkeypatch, script, serial_number="20253871")
    device.open()
    assert not port.script


def test_another_amplifier_is_refused_before_anything_is_set(monkeypatch):
    device, port = device_with(monkeypatch, [STOP, IDENTITY, SERIAL], serial_number="20253872")
    with pytest.raises(OtherInstrumentError, match=r"load_cell.*COM3.*20253871.*names 20253872") as caught:
        device.open()
    assert "[devices.load_cell]" in caught.value.remedy
    assert not port.script


def test_a_rate_the_amplifier_rounded_is_taken_over(monkeypatch):
    # 5988.0 Hz is 45 BB 20 00.
    rounded = [("aa948b45bb800085", "aa500185"), ("aa908a85", "aa540045bb200085")]
    device, _ = device_with(monkeypatch, [STOP, IDENTITY, SERIAL, *rounded, FIRMWARE])
    device.open()
    assert device.streams[0].rate_hz == 5988.0


def as_plain(chunks):
    return [(c.raw[:, 0].tolist(), c.arrival_s.tolist(), c.n_lost, c.is_loss_exact) for c in chunks]


@settings(max_examples=100, deadline=None)
@given(
    cuts=st.lists(st.integers(0, 320), max_size=4),
    bad_at=st.integers(0, 319),
    n_bad=st.integers(0, 30),
    n_gone=st.integers(0, 30),
)
def test_what_is_decoded_together_is_what_each_read_would_have_given(cuts, bad_at, n_bad, n_gone):
    stream = bytearray(b"".join(b"\xaa\x10\xb0" + struct.pack(">f", k) + b"\x85" for k in range(40)))
    for k in range(bad_at, min(len(stream), bad_at + n_bad)):
        stream[k] ^= 0x55
    del stream[bad_at : bad_at + n_gone]
    edges = sorted({0, *(cut for cut in cuts if cut < len(stream)), len(stream)})
    table = Gsv8Settings.model_validate({"port": "COM3", "channels": {"force_n": {"input": 1}}})
    clock = Clock()
    later, at_once = Gsv8("load_cell", table, clock=clock), Gsv8("load_cell", table, clock=clock)
    reads = [bytes(stream[a:b]) for a, b in pairwise(edges)]
    later._link = SimpleNamespace(read=iter(reads).__next__)
    chunks = []
    for received in reads:
        clock.now_s += 0.05
        later.receive()
        chunks = joined(chunks, at_once.decode(received, clock.now_s))
    assert as_plain(later.decoded()) == as_plain(chunks)
    assert later.n_discarded_bytes == at_once.n_discarded_bytes
    assert later.decoded() == []


def test_samples_before_a_loss_keep_the_arrival_of_their_own_read():
    device = Gsv8("load_cell", Gsv8Settings.model_validate({"port": "COM3", "channels": {"force_n": {"input": 1}}}))
    reads = [(ONE * 2, 1.0), (bytes(8) + TWO * 2, 1.04), (TWO, 1.08)]
    device._link = SimpleNamespace(read=iter([content for content, _ in reads]).__next__)
    device._clock = iter([arrival_s for _, arrival_s in reads]).__next__
    for _ in reads:
        device.receive()
    assert as_plain(device.decoded()) == [([1, 1], [1.0], 0, True), ([2, 2, 2], [1.08], 1, True)]
