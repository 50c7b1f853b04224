"""The joint fit ends also where the priors object but the strokes fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sawbench.analysis import load_and_process
from sawbench.modeling import joint_fit
from sawbench.processing.measured_cycles import measured_cycles

pytestmark = pytest.mark.unit

SAMPLE = Path(__file__).parents[2] / "recordings" / "oak-01.mcap"


def test_fit_ends_where_no_channel_shows_the_misfit(monkeypatch):
    calls = []

    def no_channel(problem, estimate, covariance, misfit):
        assert len(calls) < 3, "the fit goes round in circles"
        calls.append(1)
        return np.zeros_like(misfit)

    monkeypatch.setattr(joint_fit, "_misfit", no_channel)
    trial = load_and_process(SAMPLE, None)
    joint = joint_fit.fit_jointly(
        [measured_cycles(trial.processed)],
        plant=trial.loaded.plant(),
        battery=trial.loaded.config.battery,
        converter=trial.loaded.config.converter,
        cutting_half="pi_to_2pi",
        method="current_and_force",
    )
    assert len(calls) == 1
    assert joint.is_converged
