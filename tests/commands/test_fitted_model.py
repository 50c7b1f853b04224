"""The fitted model over the measured stroke, and the paper's search from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sawbench.analysis import fit_trial, fitted_cycle, load_and_process
from sawbench.commands.main import main

pytestmark = pytest.mark.pipeline

OAK = Path(__file__).parents[2] / "recordings" / "oak-01.mcap"


@pytest.fixture(scope="module")
def trial_and_fit():
    trial = load_and_process(OAK, None)
    return trial, fit_trial(trial)[0]


@pytest.mark.parametrize(("channel", "of_fit"), [("force_n", "rmse_n"), ("motor_current_a", "rmse_a")])
def test_fitted_stroke_lies_on_the_measured_one_as_closely_as_the_fit_says(trial_and_fit, channel, of_fit):
    trial, fit = trial_and_fit
    found = fitted_cycle(trial, fit)
    folded = trial.processed.folded[channel]
    model = np.interp(folded.angle_rad, found["angle_rad"], found[channel], period=2 * np.pi)
    # The scatter of the mean of the strokes within a bin comes on top of the fit's smooth residual.
    noise = float(np.sqrt(np.mean(folded.std**2 / folded.n_cycles)))
    assert np.sqrt(np.mean((model - folded.mean) ** 2)) < 1.5 * np.hypot(getattr(fit, of_fit), noise)


def test_annealing_works_on_a_recording_and_agrees_within_its_uncertainty(trial_and_fit, capsys):
    assert main(["fit", str(OAK), "--method", "annealing", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)[0]
    assert (found["status"], found["method"]) == ("ok", "annealing")
    difference = abs(found["k_fc_n_s_per_m"] - trial_and_fit[1].k_fc_n_s_per_m)
    assert difference < 3 * np.hypot(found["std_n_s_per_m"], trial_and_fit[1].std_n_s_per_m)
