"""slcan: our receiver, our emulator, and python-can's own driver as the independent judge between them.

Commands and replies: Lawicel CAN232 manual, section 5.
"""

from __future__ import annotations

import os
import time

import numpy as np
import pytest
from sawbench.acquisition.can_signals import load_dbc
from sawbench.acquisition.devices.dbc_can_emulator import CanEmulator, EmulatedMessage
from sawbench.acquisition.devices.slcan_emulator import line_of
from sawbench.acquisition.transports.slcan import SlcanDecoder

pytestmark = pytest.mark.contract


class Plant:
    def read(self, channel, time_s):
        return {"motor_current_a": 40.0, "battery_voltage_v": 17.123}[channel] + 0.0 * time_s

    def trigger(self, time_s):
        raise AssertionError(time_s)


def emulator(bitrate=500_000):
    database = load_dbc("jigsaw_bench.dbc")
    messages = (
        EmulatedMessage(
            message=database.get_message_by_name("MotorStatus"),
            channels={"MotorCurrent": "motor_current_a"},
            counter="SampleCounter",
            rate_hz=1000.0,
        ),
        EmulatedMessage(
            message=database.get_message_by_name("BatteryStatus"),
            channels={"BatteryVoltage": "battery_voltage_v"},
            counter="SampleCounter",
            rate_hz=1000.0,
        ),
    )
    return CanEmulator(Plant(), messages, bitrate=bitrate)


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        (b"t10021133\r", (0x100, False, b"\x11\x33")),
        (b"t1002113312AB\r", (0x100, False, b"\x11\x33")),
        (b"T0CF0040080102030405060708\r", (0x0CF00400, True, bytes(range(1, 9)))),
        (b"t7FF0\r", (0x7FF, False, b"")),
    ],
)
def test_lines_of_the_manual(line, frame):
    assert [tuple(f) for f in SlcanDecoder().feed(line)] == [frame]


@pytest.mark.parametrize("line", [b"\r", b"z\r", b"Z\r", b"\a", b"r1002\r", b"V1013\r", b"NA123\r"])
def test_replies_and_remote_frames_hold_no_sample(line):
    decoder = SlcanDecoder()
    assert decoder.feed(line) == []
    assert decoder.n_discarded_bytes == 0


def test_damaged_lines_are_counted_and_the_next_is_read():
    decoder = SlcanDecoder()
    frames = decoder.feed(b"t1002113\rt10x21133\r\xff\xfe\rt10021133\r" + b"9" * 100)
    assert len(frames) == 1
    assert decoder.n_discarded_bytes == 9 + 10 + 3 + 100


def test_a_bell_in_front_of_a_frame_does_not_hide_it():
    decoder = SlcanDecoder()
    assert len(decoder.feed(b"\at10021133\r")) == 1
    assert decoder.n_refused == 1


def test_emulator_obeys_as_the_manual_says():
    adapter = emulator()
    assert adapter.receive(b"O\r", 0.0) == b"\a"
    assert adapter.receive(b"S6\r", 0.0) == b"\r"
    assert adapter.receive(b"V\rN\r", 0.0) == b"V1013\rNSIMU\r"
    assert adapter.receive(b"O\r", 0.0) == b"\r"
    assert adapter.receive(b"S5\r", 0.0) == b"\a"
    assert adapter.receive(b"F\rt1000\r", 0.0) == b"F00\rz\r"
    assert adapter.is_streaming
    assert adapter.receive(b"C\r", 0.0) == b"\r"
    assert not adapter.is_streaming


def test_a_wrong_bit_rate_hears_nothing():
    adapter = emulator(bitrate=250_000)
    adapter.receive(b"S6\rO\r", 0.0)
    assert adapter.advance(1.0) == b""


def test_counters_go_on_while_nobody_listens():
    adapter = emulator()
    adapter.advance(0.5)
    adapter.receive(b"S6\rO\r", 0.5)
    frames = SlcanDecoder().feed(adapter.advance(0.6))
    counts = [int.from_bytes(f.payload[:2], "little") for f in frames if f.identifier == 0x100]
    assert counts[0] == 500
    assert np.all(np.diff(counts) == 1)


@pytest.mark.skipif(os.name != "posix", reason="needs a pty")
def test_python_can_reads_the_emulator_as_we_do(tmp_path):
    from can.interfaces.slcan import slcanBus
    from sawbench.acquisition.simulation.endpoints import PtyEndpoint

    endpoint = PtyEndpoint(tmp_path / "adapter")
    endpoint.plug()
    adapter = emulator()
    bus = slcanBus(channel=endpoint.address, bitrate=500_000, sleep_after_open=0)
    try:
        answers = b""
        deadline = time.monotonic() + 5.0
        # What the bus has sent passes a pty: on a busy machine not all of it is there at once.
        while not adapter.is_streaming and time.monotonic() < deadline:
            answers += adapter.receive(endpoint.read(), 0.0)
        assert adapter.is_streaming
        lines = adapter.advance(0.02)
        endpoint.write(answers + lines)
        theirs = []
        while (message := bus.recv(0.05)) is not None:
            theirs.append((message.arbitration_id, message.is_extended_id, bytes(message.data)))
        ours = [tuple(f) for f in SlcanDecoder().feed(lines)]
        assert theirs == ours
        assert len(ours) == 40
    finally:
        bus.shutdown()
        endpoint.unplug()


@pytest.mark.skipif(os.name != "posix", reason="needs a pty")
def test_frames_from_before_the_start_are_no_samples(tmp_path):
    """Other instruments take seconds to open meanwhile; what gathered comes at once, as of a bus that is too fast."""
    from sawbench.acquisition.devices import validate_table
    from sawbench.acquisition.simulation.endpoints import PtyEndpoint

    endpoint = PtyEndpoint(tmp_path / "adapter")
    endpoint.plug()
    table = {"driver": "dbc_can", "signals": {"motor_current_a": "MotorStatus.MotorCurrent"}}
    instrument, settings = validate_table("power", {**table, "port": endpoint.address})
    device = instrument.make("power", settings, time.monotonic)
    try:
        device.open()
        endpoint.write(b"".join(line_of(0x100, count.to_bytes(8, "little")) for count in range(150)))
        device.start()
        endpoint.write(line_of(0x100, (7000).to_bytes(8, "little")))
        chunks, deadline = [], time.monotonic() + 5.0
        while not chunks and time.monotonic() < deadline:
            chunks += device.read()
        assert [len(chunk.raw) for chunk in chunks] == [1]
    finally:
        device.stop()
        endpoint.unplug()


def test_cantools_reads_the_values_that_were_put_in():
    adapter = emulator()
    adapter.receive(b"S6\rO\r", 0.0)
    database = load_dbc("jigsaw_bench.dbc")
    decoded = {}
    for frame in SlcanDecoder().feed(adapter.advance(0.003)):
        decoded.update(database.decode_message(frame.identifier, frame.payload))
    assert decoded["MotorCurrent"] == pytest.approx(40.0, abs=0.0025)
    assert decoded["BatteryVoltage"] == pytest.approx(17.123, abs=0.0005)
