"""The simulated bench in scripted time: what goes in comes out, at the times at which it was."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.devices import build_devices
from sawbench.acquisition.recorder import record
from sawbench.bench.errors import RecordingError
from sawbench.bench.recording import Trial
from sawbench.inputs import config_for, default_config_path
from sawbench.storage.reader import read_recording
from sawbench.storage.writer import RecordingWriter

from benchmarks.scripted_bench import ScriptedBench

pytestmark = pytest.mark.pipeline

STROKES_HZ, SECONDS = 15.0, 1.0
MEAN = {
    "force_n": 20.0, "displacement_mm": 10.0, "motor_current_a": 8.0, "battery_voltage_v": 17.5,
    "battery_current_a": 4.0,
}  # fmt: skip


class Swinging:
    """Every channel swings about its mean with the strokes, all in phase, from the first moment on."""

    def read(self, channel, time_s):
        return MEAN[channel] * (1.0 + 0.2 * np.sin(2.0 * np.pi * STROKES_HZ * time_s))

    def trigger(self, time_s):
        return time_s


def recorded(path, *, latency_s=None, extra=None):
    loaded = config_for(None, default_config_path())
    errors = {name: 30.0 * (-1) ** k for k, name in enumerate(loaded.config.devices)}

    class Stating(RecordingWriter):
        def close(self, provenance=None, is_complete=True):
            return super().close({**(provenance or {}), **(extra or {})}, is_complete)

    def open_writer(start):
        trial = Trial(trial_id="t", source="simulated bench")
        return Stating(path=path, trial=trial, config_toml="", provenance=start.provenance, started_at=start.started_at)

    with ScriptedBench(Swinging(), loaded.config, latency_s=latency_s, clock_error_ppm=errors, seed=4) as bench:
        devices = build_devices(loaded.config, bench.endpoints, clock=bench.clock)
        summary = record(devices, open_writer, seconds=SECONDS, clock=bench.clock, between_rounds=bench.step)
    assert summary.is_complete and not summary.losses
    return read_recording(path)


def late_s(signal):
    """Delay of a channel by the phase of its swing, up to one common to all."""
    turned = 2.0 * np.pi * STROKES_HZ * signal.time_s
    waves = np.stack([np.sin(turned), np.cos(turned), np.ones_like(turned)], axis=1)
    sine, cosine, _ = np.linalg.lstsq(waves, signal.values)[0]
    return -np.arctan2(cosine, sine) / (2.0 * np.pi * STROKES_HZ)


def test_no_channel_is_late_beyond_what_the_recording_states_and_the_latency_of_its_link(tmp_path):
    equal = recorded(tmp_path / "equal.mcap")
    late = recorded(tmp_path / "late.mcap", latency_s={"power": 8e-4})
    force_s = late_s(equal.signals["force_n"])
    for name in MEAN:
        signal = equal.signals[name]
        assert signal.alignment is not None
        assert abs(late_s(signal) - force_s) < 2.0 * signal.alignment.std_s + 1e-4
        expected_s = 8e-4 if signal.device == "power" else 0.0
        added_s = (late_s(late.signals[name]) - late_s(late.signals["force_n"])) - (late_s(signal) - force_s)
        assert added_s == pytest.approx(expected_s, abs=1e-4)
        assert added_s <= signal.alignment.latency_s


def test_the_same_seed_records_the_same(tmp_path):
    first, second = (recorded(tmp_path / f"{k}.mcap") for k in range(2))
    for name in MEAN:
        assert np.array_equal(first.signals[name].time_s, second.signals[name].time_s)
        assert np.array_equal(first.signals[name].values, second.signals[name].values)


def test_an_alignment_that_is_none_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="alignment values force_n"):
        recorded(tmp_path / "t.mcap", extra={"alignment values force_n": '{"std_s": -1, "latency_s": 0}'})
