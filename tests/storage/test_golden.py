"""A recording of format version 1, committed: later versions must go on reading it.

`format_1.mcap` holds 40 force samples at 1 kHz, k / 2 newtons from k counts, with the samples 20 to 24 lost,
three stroke times that are not equally spaced, and a note.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.recording import Event, Gap, Trial
from sawbench.storage.describe import describe_recording
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.contract

GOLDEN = Path(__file__).parent / "format_1.mcap"
TRIAL = Trial(
    trial_id="golden",
    material="white oak",
    duty=0.4375,
    thickness_mm=20.0,
    feed_mm_s=4.0,
    blade="B1",
    battery="P1",
    operator="Ä. Öz",
    started_at=datetime(2026, 3, 2, 9, 0, 0, 250_000, tzinfo=UTC),
    notes="first cut",
    repetition=3,
    source="bench",
)


def test_format_1_is_read():
    recording = read_recording(GOLDEN)
    assert recording.is_complete
    assert recording.trial == TRIAL
    assert recording.config_toml == "[cutting]\n"
    assert recording.provenance["clock"] == "aligned to 20 us"
    assert recording.events == (Event(kind="note", time_s=0.01, text="knot", end_s=0.012),)
    force = recording.signal("force_n")
    k = np.delete(np.arange(45), np.s_[20:25])
    assert np.array_equal(force.time_s, k / 1000)
    assert np.array_equal(force.values, k / 2)
    assert np.array_equal(force.raw, k)
    assert force.gaps == (Gap(start_s=0.019, end_s=0.025, n_missing=5, reason="samples were lost"),)
    assert (force.unit, force.device) == ("N", "load cell")
    strokes = recording.signal("stroke")
    assert strokes.time_s.tolist() == [0.0125, 0.0845, 0.1561]
    assert strokes.raw is None
    assert describe_recording(GOLDEN).problems == ()
