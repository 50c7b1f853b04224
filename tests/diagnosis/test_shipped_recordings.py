"""The recordings that ship come from a simulated bench without any effect: no cause may be named for them."""

from __future__ import annotations

from pathlib import Path

import pytest
from sawbench.diagnosis.answer.gap_report import diagnose
from sawbench.inputs import config_for
from sawbench.storage.reader import read_recording

pytestmark = [pytest.mark.pipeline, pytest.mark.slow]

FOLDER = Path(__file__).parents[2] / "recordings"


def test_the_samples_of_the_simulated_bench_are_intact():
    recordings = [read_recording(path) for path in sorted(FOLDER.glob("*.mcap"))]
    assert len(recordings) == 10
    report = diagnose(recordings, config_for(None, None), provenance={})
    assert report["verdict"] == "no_gap"
    assert report["probabilities"]["no_gap"] > 0.6
