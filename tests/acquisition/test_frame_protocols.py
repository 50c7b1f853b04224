"""Instruments that send frames or blocks: bytes from the documents, checksums from their published check values."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from sawbench.acquisition.devices import build_devices, validate_table
from sawbench.acquisition.devices.frames import CHECKSUMS, FrameFormat, FrameFramer
from sawbench.acquisition.devices.micro_epsilon_ethernet import BlockFramer
from sawbench.bench.config import BenchConfig
from sawbench.bench.errors import ConfigError, OtherInstrumentError

from tests.rigs.dialogue import opened

pytestmark = pytest.mark.contract


def values(pieces):
    return [value for piece in pieces for value in piece.values[:, 0].tolist()]


# --- frames of the configuration alone -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "check"),
    # Check values over "123456789": Koopman's and Cook's catalogues for the two CRCs; the sums by hand.
    [("sum8", 0xDD), ("xor8", 0x31), ("sum16", 0x1DD), ("crc16_modbus", 0x4B37), ("crc16_ccitt", 0x29B1)],
)
def test_checksums_have_their_published_values(name, check):
    rows = np.frombuffer(b"123456789" * 2, np.uint8).reshape(2, 9)
    assert CHECKSUMS[name][1](rows).tolist() == [check, check]


@pytest.mark.parametrize(
    ("fields", "payload", "columns", "numbers"),
    [
        ("<Hh", "0100 feff", (2, 1), (-2.0, 1.0)),
        (">Hh", "0001 fffe", (2, 1), (-2.0, 1.0)),
        ("<Bxf", "07 00 0000803f", (2,), (1.0,)),
        (">2hq", "0001 0002 ffffffffffffffff", (2, 3), (2.0, -1.0)),
        ("<d", "000000000000f0bf", (1,), (-1.0,)),
    ],
)
def test_fields_are_read_as_struct_writes_them(fields, payload, columns, numbers):
    frame = FrameFormat(sync=b"\xaa", fields=fields, columns=columns)
    assert frame.n_bytes == 1 + struct.calcsize(fields)
    framer = FrameFramer(frame)
    (piece,) = framer.feed((b"\xaa" + bytes.fromhex(payload)) * 3)
    assert piece.values.tolist() == [list(numbers)] * 3


def frames_of(numbers, *, checked):
    """Sync 55, a signed word low byte first, and where asked for the exclusive or of the two."""
    frames = []
    for number in numbers:
        low, high = number & 0xFF, number >> 8 & 0xFF
        frames.append(bytes([0x55, low, high, *([low ^ high] if checked else [])]))
    return frames


@pytest.mark.parametrize("checked", [True, False])
@pytest.mark.parametrize("n_dropped", [1, 2, 3, 4, 7])
def test_dropped_bytes_cost_few_frames_and_are_told(checked, n_dropped):
    # Now and then the sync byte stands in the numbers too.
    numbers = [k * 137 % 30000 for k in range(400)]
    data = b"".join(frames_of(numbers, checked=checked))
    at = len(data) // 2 + 1
    cut = data[:at] + data[at + n_dropped :]
    frame = FrameFormat(sync=b"\x55", fields="<h", columns=(1,), checksum="xor8" if checked else "")
    framer = FrameFramer(frame)
    read, told = [], 0
    for k in range(0, len(cut), 50):
        for piece in framer.feed(cut[k : k + 50]):
            read += piece.values[:, 0].tolist()
            told += piece.n_lost
    assert set(read) <= set(map(float, numbers))
    assert len(read) >= 390
    assert read[-1] == numbers[-1]
    assert n_dropped % len(frames_of([0], checked=checked)[0]) == 0 or (told >= 1 and framer.n_discarded_bytes > 0)


def test_a_flipped_bit_is_a_lost_frame_where_there_is_a_checksum():
    frames = frames_of(range(10), checked=True)
    frames[4] = bytes([0x55, 4 ^ 0x10, 0, 4])
    first, second = FrameFramer(FrameFormat(sync=b"\x55", fields="<h", columns=(1,), checksum="xor8")).feed(
        b"".join(frames)
    )
    assert values([first]) == [0, 1, 2, 3]
    assert (values([second]), second.n_lost) == ([5, 6, 7, 8, 9], 1)


def table(**changes):
    return {
        "driver": "binary_frames",
        "port": "COM3",
        "sync": "AA 55",
        "fields": "<Hh",
        "rate_hz": 1000,
        "channels": {"force_n": {"input": 2}},
        **changes,
    }


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sync": "AAA"}, "hexadecimal"),
        ({"fields": "Hh"}, "begin with <"),
        ({"fields": "<Hs"}, "holds 's'"),
        ({"fields": "<"}, "has no field"),
        ({"channels": {"force_n": {"input": 3}}}, "fields are numbered 1..2"),
        ({"counter_field": 2}, "without a sign"),
        ({"counter_field": 5}, "but field 5 is configured"),
        ({"time_field": 1}, "exactly one of"),
        ({"checksum": "crc32"}, "checksum"),
        ({"stop": "01"}, "stop needs start"),
    ],
)
def test_a_table_that_does_not_fit_together_is_one_clear_message(changes, message):
    with pytest.raises(ConfigError, match=message):
        build_devices(BenchConfig(devices={"cell": table(**changes)}))


def test_a_counter_tells_how_many_frames_were_lost(monkeypatch):
    def make(name, given, clock):
        instrument, settings = validate_table(name, given)
        return instrument.make(name, settings, clock)

    given = table(counter_field=1, start="01", stop="02")
    device, port = opened(monkeypatch, make, given)
    device.start()
    frames = ((65534, -20), (65535, -10), (2, 20), (3, 30))
    port.give(b"".join(b"\xaa\x55" + struct.pack("<Hh", count, value) for count, value in frames))
    first, second = device.read()
    device.stop()
    assert first.raw[:, 0].tolist() == [-20.0, -10.0]
    assert (second.raw[:, 0].tolist(), second.n_lost, second.is_loss_exact) == ([20.0, 30.0], 2, True)
    assert port.sent == [b"\x02", b"\x01", b"\x02"]


@pytest.mark.parametrize("kind", "BHIQ")
def test_a_counter_of_any_width_tells_what_was_lost(kind):
    instrument, settings = validate_table("f", table(fields=f"<{kind}h", counter_field=1))
    device = instrument.make("f", settings, lambda: 0.0)
    counts = [k for k in range(20) if k not in (7, 8, 9)]
    data = b"".join(b"\xaa\x55" + struct.pack(f"<{kind}h", k, k) for k in counts)
    chunks = device.decode(data, 1.0)
    assert [chunk.n_lost for chunk in chunks] == [0, 3]
    assert np.concatenate([chunk.raw[:, 0] for chunk in chunks]).tolist() == counts


# --- Micro-Epsilon over Ethernet -----------------------------------------------------------------------------

# capaNCDT 6200, 6.2: "MEAS", order number, serial number, channels (two bits each), status, M = 2 frames of 8 bytes,
# counter 100, then two values of 24 bits a frame.
CAPANCDT = bytes.fromhex(
    "4d454153 05000000 d2040000 0500000000000000 00000000 0200 0800 64000000 ffffff00 00008000 01000000 00000000"
)
# optoNCDT 2300, 8.2.3 and 9.2: preamble 4D454153h as a number, low byte first; flags 1, flags 2; distances in nm.
OPTONCDT = bytes.fromhex("5341454d 05000000 d2040000 00000000 00000000 0100 0400 64000000 00e1f505")


def test_a_capancdt_block_as_the_manual_says():
    framer = BlockFramer("capancdt", (1, 2))
    (piece,) = framer.feed(CAPANCDT)
    assert piece.values.tolist() == [[0xFFFFFF, 0x800000, 100.0], [1.0, 0.0, 101.0]]
    assert (framer.serial_number, framer.n_discarded_bytes) == ("1234", 0)


def test_an_optoncdt_block_as_the_manual_says():
    (piece,) = BlockFramer("optoncdt", (1,)).feed(OPTONCDT)
    # 100,000,000 nm
    assert piece.values.tolist() == [[1e8, 100.0]]


def test_blocks_split_anywhere_and_behind_garbage():
    for cut in range(len(CAPANCDT)):
        framer = BlockFramer("capancdt", (1,))
        pieces = framer.feed(b"\x00MEASgarbage" + CAPANCDT[:cut]) + framer.feed(CAPANCDT[cut:] + CAPANCDT)
        assert sum(len(piece.values) for piece in pieces) == 4
        assert framer.n_discarded_bytes == 12


def test_another_controller_is_refused(monkeypatch):
    def make(name, given, clock):
        instrument, settings = validate_table(name, given)
        device = instrument.make(name, settings, clock)
        device._link.give(CAPANCDT)
        return device

    given = {"driver": "micro_epsilon_ethernet", "port": "socket://h:1", "channels": {"displacement_mm": {"input": 1}}}
    device, _ = opened(monkeypatch, make, {**given, "serial_number": "1234"})
    assert device.describe()["serial_number"] == "1234"
    # What it drops when it starts tells no number, and must not make it unknown.
    device.start()
    assert device.describe()["serial_number"] == "1234"
    with pytest.raises(OtherInstrumentError, match="1234, the configuration names 77"):
        opened(monkeypatch, make, {**given, "serial_number": "77"})
