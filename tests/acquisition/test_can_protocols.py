"""MantraCAN and CiA 404: frames from the manuals, and the nodes as python's `canopen` sees them."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.devices import build_devices, validate_table
from sawbench.acquisition.devices.cia404 import PdoValue
from sawbench.acquisition.devices.slcan_emulator import SlcanAdapter
from sawbench.acquisition.transports.can_batch import CanBatch, ParsedFrame
from sawbench.bench.config import BenchConfig
from sawbench.bench.errors import ConfigError, DeviceError, NoAnswerError, OtherInstrumentError

pytestmark = pytest.mark.contract

FORCE = {"force_n": {"input": 1}}


class Bus:
    """`answers`: (identifier, data) -> frames that follow it; keeps what was sent as text, like candump."""

    def __init__(self, answers):
        self._answers = answers
        self._waiting = []
        self._now_s = 0.0
        self.sent = []
        self.n_discarded_bytes = 0
        self.time_source = "test"
        self.facts = {}

    def clock(self):
        self._now_s += 0.01
        return self._now_s

    def open(self):
        pass

    def close(self):
        pass

    def send(self, frame):
        text = f"{frame.identifier:03X}#{frame.payload.hex().upper()}"
        self.sent.append(text)
        self._waiting += [
            ParsedFrame(int(a[:3], 16), False, bytes.fromhex(a[4:])) for a in self._answers.get(text, "").split()
        ]

    def give(self, *frames):
        self._waiting += [ParsedFrame(int(a[:3], 16), False, bytes.fromhex(a[4:])) for a in frames]

    def read(self):
        waiting, self._waiting = self._waiting, []
        return CanBatch.of(waiting, self.clock())


def node(monkeypatch, answers, **table):
    bus = Bus(answers)
    monkeypatch.setattr("sawbench.acquisition.devices.can_instrument.make_can_source", lambda *_a, **_k: bus)
    instrument, settings = validate_table("cell", {"port": "COM3", "channels": FORCE, **table})
    device = instrument.make("cell", settings, bus.clock)
    device.open()
    return device, bus


# --- MantraCAN -----------------------------------------------------------------------------------------------


def test_the_read_example_of_the_manual(monkeypatch):
    # "read SYS from an ID of 100": 64h: 01 0A; response 65h: 06 0A 3F 80 00 00.
    answers = {"064#010A": "065#060A3F800000"}
    device, bus = node(monkeypatch, answers, driver="mantracourt_can", base_id=100)
    device.start()
    (chunk,) = device.read()
    assert chunk.raw.tolist() == [[1.0]]
    assert float(chunk.time_s[0]) < float(chunk.arrival_s[0])
    assert set(bus.sent) == {"064#010A"}


def test_a_refused_read_is_said(monkeypatch):
    # NAK is 15h: "if the device did not support command number 10".
    with pytest.raises(DeviceError, match="refused command number 10"):
        node(monkeypatch, {"064#010A": "065#150A"}, driver="mantracourt_can", base_id=100)


def test_no_module_is_said(monkeypatch):
    with pytest.raises(NoAnswerError, match="identifier 1"):
        node(monkeypatch, {}, driver="mantracourt_can")


def test_a_stream_begins_and_ends_with_the_messages_of_the_manual(monkeypatch):
    # Start: ID 0, 01 00; stop: ID 0, 02 00; the float high byte first.
    table = {"driver": "mantracourt_can", "stream_id": 0x181, "rate_hz": 250.0, "stream_byte": 2}
    device, bus = node(monkeypatch, {}, **table)
    device.start()
    bus.give("181#0000C2C80000", "182#000042C80000", "181#0000")
    (chunk,) = device.read()
    device.stop()
    assert chunk.raw.tolist() == [[-100.0]]
    assert bus.sent == ["000#0200", "000#0100", "000#0200"]


def test_a_stream_needs_its_rate():
    table = {"driver": "mantracourt_can", "port": "x", "channels": FORCE, "stream_id": 0x181}
    with pytest.raises(ConfigError, match="must be given together"):
        build_devices(BenchConfig(devices={"cell": table}))


# --- CiA 404 -------------------------------------------------------------------------------------------------

# Manual of Baumer DSRT 22DJ: 1000h is 00020194h (404d), serial number 123, process value of 16 bit, two digits.
DSRT = {
    "605#4000100000000000": "585#4300100094010200",
    "605#4018100400000000": "585#431810047B000000",
    "605#4000180100000000": "585#4300180185010000",
    "605#40001A0000000000": "585#4F001A0001000000",
    "605#40001A0100000000": "585#43001A0110013071",
    "605#4032610100000000": "585#4F32610102000000",
    "605#2F001802FF000000": "585#6000180200000000",
    "605#2B0018050A000000": "585#6000180500000000",
}


def test_a_transmitter_as_the_manual_says(monkeypatch):
    device, bus = node(monkeypatch, DSRT, driver="cia404", node=5, serial_number="123")
    device.start()
    bus.give("185#9CFF", "186#0000", "185#FF7F")
    (chunk,) = device.read()
    device.stop()
    assert chunk.raw[:, 0].tolist() == [-1.0, 327.67]
    # CiA 301: 80h pre-operational, 01h start, 02h stop, each with the node.
    assert [text for text in bus.sent if text.startswith("000#")] == ["000#8005", "000#0105", "000#0205"]
    assert set(bus.sent) >= set(DSRT)
    assert device.describe()["serial_number"] == "123"


def test_another_transmitter_is_refused(monkeypatch):
    with pytest.raises(OtherInstrumentError, match="123, the configuration names 9"):
        node(monkeypatch, DSRT, driver="cia404", node=5, serial_number="9")


def test_a_node_of_another_profile_is_refused(monkeypatch):
    answers = {**DSRT, "605#4000100000000000": "585#4300100091010200"}
    with pytest.raises(DeviceError, match="device profile 401, not 404"):
        node(monkeypatch, answers, driver="cia404", node=5)


def test_a_value_in_no_pdo_is_said(monkeypatch):
    # Abort code 06020000h: the object does not exist.
    others = {f"605#40{pdo:02X}180100000000": f"585#80{pdo:02X}180100000206" for pdo in (1, 2, 3)}
    answers = {**DSRT, **others, "605#40001A0000000000": "585#4F001A0000000000"}
    with pytest.raises(DeviceError, match="no transmit PDO"):
        node(monkeypatch, answers, driver="cia404", node=5)


@pytest.mark.parametrize(
    ("payload", "n_bytes", "is_real", "expected"),
    [
        ("9cff", 2, False, -1.0),
        ("ffff7f", 3, False, 83886.07),
        ("9cffff", 3, False, -1.0),
        ("15cd5b07", 4, False, 1234567.89),
        ("00002041", 4, True, 10.0),
    ],
)
def test_process_values_of_every_length(payload, n_bytes, is_real, expected):
    cells = np.zeros((1, 8), dtype=np.uint8)
    cells[0, 1 : 1 + n_bytes] = list(bytes.fromhex(payload))
    value = PdoValue(first_byte=1, n_bytes=n_bytes, is_real=is_real, digits=2)
    assert value.read(cells).tolist() == pytest.approx([expected])


def test_a_period_that_is_no_whole_millisecond_is_refused():
    table = {"driver": "cia404", "port": "x", "channels": FORCE, "rate_hz": 300.0}
    with pytest.raises(ConfigError, match="whole number of milliseconds"):
        build_devices(BenchConfig(devices={"cell": table}))


def test_an_open_adapter_receipts_what_the_host_sends():
    adapter = SlcanAdapter(bitrate=125_000)
    adapter.receive(b"S4\rO\r", 0.0)
    # Lawicel: z and a carriage return for a frame of 11 bit, a bell for what is none.
    assert adapter.receive(b"t00028001\rt0002zz\r", 0.0) == b"z\r\a"
