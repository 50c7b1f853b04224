"""Simulated bench in its own process -> ports -> drivers -> recorder: real bytes in real time."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from sawbench.acquisition.devices import build_devices
from sawbench.acquisition.recorder import RecorderLimits, record
from sawbench.bench.config import load_config
from sawbench.bench.errors import DeviceError
from sawbench.bench.recording import Event, SampleBlock

pytestmark = pytest.mark.pipeline

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "bench_config.toml"
RATES = {
    "force_n": 6000,
    "displacement_mm": 6000,
    "motor_current_a": 1000,
    "battery_voltage_v": 1000,
    "battery_current_a": 1000,
}
needs_pty = pytest.mark.skipif(os.name != "posix", reason="this system has no pty")


class Writer:
    def __init__(self):
        self.blocks, self.events = [], []

    def write_block(self, block: SampleBlock):
        self.blocks.append(block)

    def write_event(self, event: Event):
        self.events.append(event)

    def close(self, **_):
        pass

    def joined(self, channel):
        blocks = [b for b in self.blocks if b.channel == channel]
        index = np.concatenate([b.first_index + np.arange(len(b.time_s)) for b in blocks])
        return index, np.concatenate([b.time_s for b in blocks]), np.concatenate([b.values for b in blocks])


@contextlib.contextmanager
def bench(**options):
    command = [
        sys.executable,
        str(ROOT / "tests" / "rigs" / "sine.py"),
        str(CONFIG),
        json.dumps(options),
    ]
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        announced = process.stdout.readline()
        if not announced:
            pytest.fail(f"the bench did not start: {process.stderr.read()}")
        yield process, json.loads(announced)
    finally:
        process.stdin.close()
        process.wait(timeout=20)
        process.stdout.close()
        process.stderr.close()


def channels_of(summary):
    return {c.channel: c for c in summary.channels}


def fit_sine(time_s, values):
    """Time shift of the 10 Hz sine (s), and standard deviation of what remains, relative to its amplitude."""
    angle = 2 * np.pi * 10.0 * time_s
    basis = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    a, b, c = np.linalg.lstsq(basis, values, rcond=None)[0]
    remains = values - basis @ np.array([a, b, c])
    return np.arctan2(b, a) / (2 * np.pi * 10.0), remains.std() / np.hypot(a, b)


@pytest.mark.parametrize("transport", [pytest.param("pty", marks=needs_pty), "tcp"])
def test_every_sample_arrives(transport):
    """In real time; when samples arrive hangs on the machine, so their times are tested below in simulated time."""
    writer = Writer()
    with bench(transport=transport, trigger_after_s=0.3) as (process, ports):
        summary = record(build_devices(load_config(CONFIG).config, ports), writer, seconds=1.5)
        process.stdin.close()
        assert process.wait(timeout=20) == 0
        assert "triggered" in process.stderr.read()
    for channel, rate_hz in RATES.items():
        index, time_s, values = writer.joined(channel)
        assert np.all(np.diff(index) == 1)
        assert np.all(np.diff(time_s) > 0)
        # Over the sample count a sine stays a sine, but for quantisation: none lost, none twice.
        assert fit_sine(index / rate_hz, values)[1] < 0.01
    assert [d.n_discarded_bytes for d in summary.devices] == [0, 0, 0]


def sines():
    """Every channel is the same sine, so that a shift between channels shows."""
    amplitude = {"force_n": 200.0, "displacement_mm": 10.0, "motor_current_a": 40.0, "battery_voltage_v": 2.0}
    mean = {"displacement_mm": 10.0, "battery_voltage_v": 17.0}

    def of(channel):
        return lambda time_s, noise: (
            mean.get(channel, 0.0) + amplitude.get(channel, 20.0) * np.sin(2 * np.pi * 10.0 * time_s)
        )

    return {channel: of(channel) for channel in RATES}


def recorded_in_simulated_time(seconds, **options):
    from tests.rigs.resting import resting_bench

    writer = Writer()
    with resting_bench(sines(), **options) as rig:
        devices = build_devices(load_config(CONFIG).config, rig.ports, clock=rig.clock)
        # A reader that is further ahead of the recorder waits, and time with it.
        limits = RecorderLimits(queue_length=1)
        summary = record(devices, writer, seconds=seconds, clock=rig.clock, limits=limits)
    return writer, summary


@needs_pty
def test_all_channels_agree_in_time():
    writer, summary = recorded_in_simulated_time(1.5, clock_error_ppm={"load_cell": 40.0, "power": -40.0})
    shifts = []
    for channel, rate_hz in RATES.items():
        index, time_s, values = writer.joined(channel)
        assert np.all(np.diff(index) == 1)
        # The clock places the two ends of the recording to half a millisecond.
        assert len(index) == pytest.approx(1.5 * rate_hz, abs=1 + 0.5e-3 * rate_hz)
        assert np.all(np.diff(time_s) > 0)
        assert 0 <= time_s[0] < time_s[-1] < 1.5
        shifts.append(fit_sine(time_s, values)[0])
        assert channels_of(summary)[channel].n_gaps == 0
    assert np.ptp(shifts) < 0.005
    assert summary.is_complete
    assert not [e for e in writer.events if e.kind == "gap"]


@needs_pty
def test_an_unplugged_instrument_comes_back_into_the_same_recording():
    faults = [
        {"device": "load_cell", "kind": "unplug", "at_s": 1.0, "seconds": 0.4},
        {"device": "power", "kind": "unplug", "at_s": 1.3, "seconds": 0.3},
        {"device": "stroke_sensor", "kind": "garble_bytes", "at_s": 1.4, "n_bytes": 8},
    ]
    writer, summary = recorded_in_simulated_time(3.0, faults=faults)
    found = channels_of(summary)
    reconnects = {d.device: d.n_reconnects for d in summary.devices}
    assert reconnects == {"load_cell": 1, "stroke_sensor": 0, "power": 1}
    for channel, rate_hz in RATES.items():
        index, time_s, _ = writer.joined(channel)
        assert np.all(np.diff(index) >= 1)
        assert np.all(np.diff(time_s) > 0)
        total = found[channel].n_samples + found[channel].n_missing
        assert total == pytest.approx(3.0 * rate_hz, rel=0.005)
        assert found[channel].n_gaps == 1
    assert found["displacement_mm"].n_missing <= 3
    assert found["force_n"].n_missing >= 0.4 * 6000
    assert {e.device for e in writer.events if e.kind == "device" and "link lost" in e.text} == {
        "load_cell",
        "power",
    }


@needs_pty
def test_an_instrument_gone_for_good_leaves_no_complete_recording():
    faults = [{"device": "load_cell", "kind": "unplug", "at_s": 1.0, "seconds": 60.0}]
    writer, summary = recorded_in_simulated_time(3.5, faults=faults)
    force = channels_of(summary)["force_n"]
    assert not summary.is_complete
    assert force.n_samples + force.n_missing == pytest.approx(3.5 * 6000, rel=0.005)
    assert force.rate_hz == pytest.approx(6000, rel=0.01)
    assert [loss.split(":")[0] for loss in summary.losses] == ["force_n"]
    (gap,) = [e for e in writer.events if e.kind == "gap"]
    assert gap.end_s == pytest.approx(3.5, abs=1e-6)


@needs_pty
def test_a_silent_instrument_is_named_at_the_start():
    with bench(faults=[{"device": "power", "kind": "silence", "at_s": 0.0, "seconds": 60.0}]) as (_, ports):
        devices = build_devices(load_config(CONFIG).config, ports)
        with pytest.raises(DeviceError, match=r"sent no(thing| sample)") as caught:
            record(devices, Writer(), seconds=2.0)
    assert caught.value.where.startswith("power on ")


@needs_pty
def test_a_port_in_use_is_said(tmp_path):
    from sawbench.acquisition.simulation.endpoints import PtyEndpoint
    from sawbench.acquisition.transports.serial_port import SerialPort

    endpoint = PtyEndpoint(tmp_path / "port")
    endpoint.plug()
    first, second = (SerialPort(endpoint.address, device="load_cell") for _ in range(2))
    try:
        first.open()
        with pytest.raises(DeviceError, match="in use"):
            second.open()
        endpoint.write(b"\xaa" * 3000)
        received = b""
        while len(received) < 3000:
            received += first.read()
        endpoint.unplug()
        with pytest.raises(DeviceError, match="connection was lost"):
            first.read()
    finally:
        first.close()
        second.close()
        endpoint.unplug()


def test_nobody_listens_on_the_socket():
    from sawbench.acquisition.simulation.endpoints import TcpEndpoint
    from sawbench.acquisition.transports.serial_port import SerialPort

    endpoint = TcpEndpoint()
    endpoint.plug()
    endpoint.unplug()
    with pytest.raises(DeviceError, match="cannot connect"):
        SerialPort(endpoint.address, device="load_cell").open()


def test_frames_over_python_can():
    """The other receiver: python-can's own bus, here the one inside the process."""
    import can
    from sawbench.bench.config import BenchConfig

    table = {
        "driver": "dbc_can",
        "interface": "virtual",
        "port": "sawbench-test",
        "signals": {"motor_current_a": "MotorStatus.MotorCurrent"},
    }
    (device,) = build_devices(BenchConfig(devices={"power": table}))
    device.open()
    sender = can.Bus(interface="virtual", channel="sawbench-test")
    try:
        for count in (0, 1, 2, 5, 6):
            data = count.to_bytes(2, "little") + (200 * count).to_bytes(2, "little", signed=True)
            sender.send(can.Message(arbitration_id=0x100, is_extended_id=False, data=data))
        chunks = device.read()
        assert [(c.n_lost, c.raw[:, 0].tolist()) for c in chunks] == [(0, [0.0, 1.0, 2.0]), (2, [5.0, 6.0])]
        assert all(len(c.arrival_s) == len(c.raw) for c in chunks)
        # An error frame of the class "bus off": what came before it counts, then the link is lost, until opened again.
        sender.send(can.Message(arbitration_id=0x100, is_extended_id=False, data=bytes((7, 0, 0, 0))))
        sender.send(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
        assert sum(len(c.raw) for c in device.read()) == 1
        with pytest.raises(DeviceError, match="the bus is off"):
            device.read()
        device.stop()
        device.open()
        assert device.read() == []
    finally:
        sender.shutdown()
        device.stop()


@pytest.mark.parametrize("jump_s", [0.0, 2.0, -2.0, 3600.0, -3600.0])
def test_a_wall_clock_that_is_set_moves_no_frame(monkeypatch, jump_s):
    """Frames are stamped by the wall clock; the one read together with the jump holds frames from before and after."""
    import can
    from sawbench.acquisition.transports.can_bus import PythonCanBus

    now = {"monotonic": 100.0, "wall": 1.7e9}
    arrived = []

    class Bus:
        def recv(self, _timeout):
            return can.Message(arbitration_id=1, timestamp=arrived.pop(0)) if arrived else None

        def shutdown(self):
            pass

    def after(seconds, jump=0.0):
        now["monotonic"] += seconds
        now["wall"] += seconds + jump

    monkeypatch.setattr(can, "Bus", lambda **_: Bus())
    source = PythonCanBus(
        "x", "y", device="power", bitrate=500_000, clock=lambda: now["monotonic"], wall_clock=lambda: now["wall"]
    )
    source.open()
    received = []
    for jump in (0.0, 0.0, jump_s, 0.0):
        after(0.02)
        arrived.append(now["wall"])
        after(0.02, jump)
        arrived.append(now["wall"])
        after(0.02)
        received += source.read().arrival_s.tolist()
    source.close()
    expected = [100.0 + 0.06 * k + within for k in range(4) for within in (0.02, 0.04)]
    assert received == pytest.approx(expected, abs=1e-5)
    assert source.time_source == "time stamps of the bus"
