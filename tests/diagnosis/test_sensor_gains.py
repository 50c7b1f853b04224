"""What `[sensors]` states is taken back before recordings are screened, once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.config import parse_config
from sawbench.diagnosis.plants.choice import reduce_recordings
from sawbench.inputs import config_for
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.pipeline

FOLDER = Path(__file__).parents[2] / "recordings"


def test_a_current_that_is_stated_to_read_high_is_neither_left_out_nor_taken_back_twice():
    recordings = [read_recording(FOLDER / f"oak-0{k}.mcap") for k in (1, 2)]
    loaded = config_for(recordings[0], None)
    stated = parse_config(f"{loaded.text}\n[sensors]\nbattery_current_a = {{ gain = 1.7 }}\n", where="bench.toml")
    high = []
    for one in recordings:
        signal = one.signals["battery_current_a"]
        signals = {**one.signals, "battery_current_a": replace(signal, values=1.7 * signal.values)}
        high.append(replace(one, signals=signals))
    plain, found = reduce_recordings(recordings, loaded), reduce_recordings(high, stated)
    assert found.warnings == plain.warnings
    for one, other in zip(found.states, plain.states, strict=True):
        np.testing.assert_allclose(one.battery_current_a, other.battery_current_a, rtol=1e-9)
