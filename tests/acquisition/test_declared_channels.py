"""Channels beyond those of `bench.units`: declared, recorded, kept, shown, exported."""

from __future__ import annotations

import os

import numpy as np
import pytest
from sawbench.acquisition.devices import build_devices
from sawbench.acquisition.recorder import record
from sawbench.bench.config import parse_config
from sawbench.bench.errors import ConfigError
from sawbench.bench.recording import Trial
from sawbench.storage.describe import describe_recording
from sawbench.storage.reader import read_recording
from sawbench.storage.writer import RecordingWriter

from tests.rigs.resting import resting_bench

CONFIG = """
[channels.motor_temperature_c]
unit = "degC"
range = [-40, 200]
label = "motor temperature"

[devices.cell]
driver = "gsv8"
port = "/nowhere"
rate_hz = 1000

[devices.cell.channels.force_n]
input = 1

[devices.cell.channels.motor_temperature_c]
input = 2
calibration = { scale = 20.0, raw_unit = "V", source = "data sheet" }
"""


@pytest.mark.pipeline
@pytest.mark.skipif(os.name != "posix", reason="this system has no pty")
def test_a_declared_channel_is_recorded_with_its_unit_and_described(tmp_path):
    config = parse_config(CONFIG).config
    opened = []

    def writer(start):
        settings = {"trial": Trial(trial_id="t"), "config_toml": CONFIG, "provenance": start.provenance}
        opened.append(RecordingWriter(path=tmp_path / "t.mcap", started_at=start.started_at, **settings))
        return opened[0]

    with resting_bench({"motor_temperature_c": lambda t, _noise: 30.0 + t}, config=config) as rig:
        record(build_devices(config, rig.ports, clock=rig.clock), writer, seconds=0.5, clock=rig.clock)
    opened[0].close()
    temperature = read_recording(tmp_path / "t.mcap").signal("motor_temperature_c")
    # The simulated bench answers for a declared channel itself: a slow swing about the middle of the range.
    assert temperature.unit == "degC"
    assert len(temperature.values) == pytest.approx(500, abs=2)
    assert temperature.values.mean() == pytest.approx(80.0, abs=24.0)
    assert np.allclose(temperature.values, 20.0 * temperature.raw)
    info = describe_recording(tmp_path / "t.mcap")
    assert ("motor_temperature_c", "degC") in {(c.channel, c.unit) for c in info.channels}
    assert "/preview/motor_temperature_c" in {t.topic for t in info.topics}
    assert "source: data sheet" in info.provenance["calibration motor_temperature_c"]


@pytest.mark.unit
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[channels.motor_temperature_c]", "[channels.force_n]", "built-in channel"),
        ("[channels.motor_temperature_c]", '[channels."Motor T"]', "pattern"),
        ("range = [-40, 200]", "range = [200, -40]", "range must rise"),
        (
            "[channels.motor_temperature_c]",
            "[channels.motor_temp_c]",
            r"additional channel as \[channels.motor_temp",
        ),
    ],
)
def test_a_wrong_declaration_is_one_clear_message(old, new, message):
    with pytest.raises(ConfigError, match=message):
        build_devices(parse_config(CONFIG.replace(old, new)).config)
