"""Instruments of five kinds on one bench, recorded together in scripted time: nothing missing, one common clock."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.devices import build_devices
from sawbench.acquisition.recorder import record
from sawbench.bench.config import parse_config
from sawbench.bench.recording import Trial
from sawbench.storage.reader import read_recording
from sawbench.storage.writer import RecordingWriter

from benchmarks.scripted_bench import ScriptedBench

pytestmark = pytest.mark.pipeline

STROKES_HZ, SECONDS = 15.0, 2.0
MEAN = {
    "force_n": 100.0, "displacement_mm": 10.0, "switch_mm": 10.0, "motor_current_a": 8.0, "battery_voltage_v": 17.5,
    "battery_current_a": 4.0,
}  # fmt: skip
CONFIG = """
[channels]
stroke_rate_hz = { unit = "Hz", range = [0, 100] }

[devices.load_cell]
driver = "mantracourt_can"
port = "x"
stream_id = 0x181
rate_hz = 1000
channels.force_n = { input = 1, raw_range = [-600, 600] }

[devices.stroke_sensor]
driver = "micro_epsilon_ethernet"
port = "x"
rate_hz = 3906.25
channels.displacement_mm = { input = 2, raw_range = [0, 16777215], calibration = { scale = 1.7881394e-06 } }

[devices.motor]
driver = "binary_frames"
port = "x"
sync = "AA 55"
fields = "<Hxhh"
checksum = "crc16_modbus"
rate_hz = 1000
counter_field = 1
start = "01"
stop = "02"
channels.motor_current_a = { input = 2, raw_range = [-32000, 32000], calibration = { scale = 0.002 } }
channels.battery_current_a = { input = 3, raw_range = [-32000, 32000], calibration = { scale = 0.002 } }

[devices.battery]
driver = "text_lines"
port = "x"
time_column = 1
time_bits = 32
separator = ","
channels.battery_voltage_v = { input = 2, raw_range = [0, 60] }

[devices.switch]
driver = "edge_times"
port = "x"
channels.stroke_rate_hz = { input = 1 }
"""


class Swinging:
    """Every channel swings about its mean with the strokes, all in phase, from the first moment on."""

    def read(self, channel, time_s):
        return MEAN[channel] * (1.0 + 0.2 * np.sin(2.0 * np.pi * STROKES_HZ * time_s))

    def trigger(self, time_s):
        return time_s


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("together") / "t.mcap"
    config = parse_config(CONFIG).config
    errors = {name: 30.0 * (-1) ** k for k, name in enumerate(config.devices)}

    def open_writer(start):
        trial = Trial(trial_id="t", source="simulated bench")
        return RecordingWriter(
            path=path, trial=trial, config_toml="", provenance=start.provenance, started_at=start.started_at
        )

    with ScriptedBench(Swinging(), config, clock_error_ppm=errors, seed=4) as bench:
        devices = build_devices(config, bench.endpoints, clock=bench.clock)
        summary = record(devices, open_writer, seconds=SECONDS, clock=bench.clock, between_rounds=bench.step)
    assert summary.is_complete and not summary.losses
    assert not any(channel.n_missing for channel in summary.channels)
    return read_recording(path)


def wave(signal):
    """Mean, amplitude and delay of a channel, s."""
    turned = 2.0 * np.pi * STROKES_HZ * signal.time_s
    waves = np.stack([np.sin(turned), np.cos(turned), np.ones_like(turned)], axis=1)
    sine, cosine, mean = np.linalg.lstsq(waves, signal.values)[0]
    return mean, float(np.hypot(sine, cosine)), -np.arctan2(cosine, sine) / (2.0 * np.pi * STROKES_HZ)


def test_every_instrument_measures_what_the_plant_does_at_the_time_at_which_it_does_it(recording):
    names = [name for name in recording.signals if name in MEAN]
    assert len(names) == 5
    waves = {name: wave(recording.signals[name]) for name in names}
    for name, (mean, amplitude, _) in waves.items():
        assert mean == pytest.approx(MEAN[name], rel=1e-3)
        assert amplitude == pytest.approx(0.2 * MEAN[name], rel=5e-3)
    delays_s = [delay_s for _, _, delay_s in waves.values()]
    assert np.ptp(delays_s) < 5e-4


def test_the_edges_fall_where_the_blade_passes_the_switch(recording):
    edges = recording.signals["stroke_rate_hz"]
    assert edges.values.tolist() == pytest.approx([STROKES_HZ] * len(edges.values), rel=1e-3)
    assert len(edges.values) == pytest.approx(STROKES_HZ * SECONDS, abs=1)
    # The switch closes as the displacement rises through its mean.
    at_edges = np.interp(
        edges.time_s, recording.signals["displacement_mm"].time_s, recording.signals["displacement_mm"].values
    )
    assert at_edges.tolist() == pytest.approx([MEAN["displacement_mm"]] * len(at_edges), abs=0.15)
