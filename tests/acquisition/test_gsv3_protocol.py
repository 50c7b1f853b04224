"""GSV-3 byte dialogue: `A5` and a 16-bit number, (x - 32768) / 32768 of full scale; 23 stop, 24 start, 0C zero."""

from __future__ import annotations

import os

import numpy as np
import pytest
from sawbench.acquisition.devices import build_devices
from sawbench.acquisition.devices.gsv3 import INSTRUMENT, Gsv3, Gsv3Emulator, Gsv3Framer, Gsv3Settings
from sawbench.acquisition.recorder import record
from sawbench.acquisition.simulation.sensor import EmulatedSensor
from sawbench.bench.config import BenchConfig, load_config
from sawbench.bench.errors import ConfigError, DeviceError
from sawbench.bench.recording import Trial
from sawbench.bench.units import CHANNEL_BY_NAME
from sawbench.storage.reader import read_recording
from sawbench.storage.writer import RecordingWriter

from tests.rigs.resting import CONFIG, resting_bench

pytestmark = pytest.mark.contract

TABLE = {"driver": "gsv3", "port": "COM3", **INSTRUMENT.example}


def frames_of(codes):
    return b"".join(b"\xa5" + int(code).to_bytes(2, "big") for code in codes)


@pytest.mark.parametrize(
    ("frame", "share"), [("a50000", -1.0), ("a58000", 0.0), ("a5c000", 0.5), ("a5a5a5", 0.29409790)]
)
def test_the_number_is_a_share_of_full_scale(frame, share):
    values, n_lost = Gsv3Framer().feed(bytes.fromhex(frame))
    assert values.tolist() == pytest.approx([share], abs=1e-8)
    assert n_lost == 0


def test_the_ends_of_the_converter_are_no_measurement():
    """An overloaded input stands on the last code, whatever the force is."""
    device = Gsv3("cell", Gsv3Settings.model_validate(TABLE, context={"channels": CHANNEL_BY_NAME}))
    (chunk,) = device.decode(frames_of([0, 1, 32768, 65534, 65535]), 1.0)
    assert np.isnan(chunk.raw[:, 0]).tolist() == [True, False, False, False, True]


def test_split_anywhere():
    data = frames_of([100, 40000, 0xA5A5, 7])
    for cut in range(len(data)):
        framer = Gsv3Framer()
        first, second = framer.feed(data[:cut])[0], framer.feed(data[cut:])[0]
        assert len(first) + len(second) == 4
        assert framer.n_discarded_bytes == 0


@pytest.mark.parametrize("n_dropped", [1, 2, 4, 5])
def test_dropped_bytes_cost_few_frames_and_are_told(n_dropped):
    # Codes from A000 to C6F5: now and then the prefix stands in the numbers too.
    codes = 0xA000 + 137 * np.arange(400) % 9973
    data = frames_of(codes)
    cut = data[:601] + data[601 + n_dropped :]
    framer = Gsv3Framer()
    values, told = [], 0
    for k in range(0, len(cut), 50):
        piece, n_lost = framer.feed(cut[k : k + 50])
        values += piece.tolist()
        told += n_lost
    sent = ((codes - 32768) / 32768).tolist()
    assert framer.n_discarded_bytes > 0
    assert told >= 1
    # All that is left are numbers that were sent, in their order; at most the frames around the cut are missing.
    assert set(values) <= set(sent)
    assert len(values) >= 395
    assert values[-1] == sent[-1]


class ScriptedPort:
    def __init__(self):
        self.sent, self.answers, self.is_open = [], [], False

    def open(self):
        self.is_open = True

    def write(self, data):
        self.sent.append(data)

    def read(self):
        return self.answers.pop(0) if self.answers else b""

    def close(self):
        self.is_open = False


def test_dialogue_of_a_measurement(monkeypatch):
    port = ScriptedPort()
    monkeypatch.setattr("sawbench.acquisition.devices.serial_instrument.SerialPort", lambda *_a, **_k: port)
    device = Gsv3("cell", Gsv3Settings.model_validate(TABLE), clock=lambda: 0.0)
    # What was under way when the stop arrived is no measurement of ours.
    port.answers = [frames_of([1, 2])]
    device.open()
    device.start()
    port.answers = [frames_of([0xC000, 0x4000])]
    (chunk,) = device.read()
    assert chunk.raw[:, 0].tolist() == [1.0, -1.0]
    device.set_zero("force_n")
    device.stop()
    assert port.sent == [b"\x23", b"\x24", b"\x0c", b"\x23"]
    assert not port.is_open


def test_an_instrument_that_does_not_stop_is_refused(monkeypatch):
    port, ticks = ScriptedPort(), iter(range(1000))
    monkeypatch.setattr("sawbench.acquisition.devices.serial_instrument.SerialPort", lambda *_a, **_k: port)
    port.answers = [b"noise"] * 100
    device = Gsv3("cell", Gsv3Settings.model_validate(TABLE), clock=lambda: 0.1 * next(ticks))
    with pytest.raises(DeviceError, match="still sends data"):
        device.open()


def test_a_second_input_is_refused():
    table = {"driver": "gsv3", "port": "COM3", "channels": {"force_n": {"input": 2}}}
    with pytest.raises(ConfigError, match="one input"):
        build_devices(BenchConfig(devices={"cell": table}))


class Ramp:
    def read(self, channel, time_s):
        return 100.0 * np.asarray(time_s)

    def trigger(self, time_s):
        raise AssertionError(time_s)


def test_the_emulator_obeys_the_bytes():
    settings = Gsv3Settings.model_validate(TABLE)
    sensor = EmulatedSensor(channel="force_n", input=1, scale=100.0)
    unit = Gsv3Emulator(Ramp(), sensor, settings, clock_error_ppm=1000.0)
    assert unit.receive(b"\x24", 0.0) == b""
    data = unit.advance(0.9995)
    assert len(data) == 3 * 1001
    assert data[:3] == bytes.fromhex("a58000")
    # 1 V at 2 V full scale, after 0.999001 s.
    assert data[-3:] == b"\xa5" + round(32768 * (1 + 1000 / 1001 / 2)).to_bytes(2, "big")
    unit.receive(b"\x0c\x23", 1.0)
    assert unit.advance(2.0) == b""


@pytest.mark.skipif(os.name != "posix", reason="this system has no pty")
def test_recorded_end_to_end_through_a_pty(tmp_path):
    config = load_config(CONFIG).config
    config = config.model_copy(update={"devices": {"cell": {**TABLE, "port": "/nowhere"}}})
    behaviour = {"force_n": lambda t, _noise: 50.0 + 100.0 * t}
    path = tmp_path / "t.mcap"
    with resting_bench(behaviour, config=config, clock_error_ppm={"cell": 50.0}) as rig:
        devices = build_devices(config, rig.ports, clock=rig.clock)

        def writer(start):
            opened.append(
                RecordingWriter(
                    path=path,
                    trial=Trial(trial_id="t"),
                    config_toml="",
                    provenance=start.provenance,
                    started_at=start.started_at,
                )
            )
            return opened[0]

        opened = []
        summary = record(devices, writer, seconds=1.0, clock=rig.clock)
        opened[0].close(is_complete=summary.is_complete)
    force = read_recording(path).signal("force_n")
    assert not force.gaps
    assert summary.devices[0].n_discarded_bytes == 0
    # 1 s at 1 kHz; a ramp of 100 N/s in steps of 500 N / 65536, at times good to a millisecond.
    assert len(force.values) == pytest.approx(1000, abs=2)
    slope, _ = np.polyfit(force.time_s, force.values, 1)
    assert slope == pytest.approx(100.0, rel=2e-3)
    assert np.abs(np.diff(force.values) - 0.1).max() < 0.02
