"""The fitted model over the measured stroke."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sawbench.acquisition.calibration import Calibration
from sawbench.analysis import Evaluation, evaluate, fit_trial, load_and_process
from sawbench.commands.main import main
from sawbench.model_cycles import discharges_of, fitted_cycle, measured_force_cycle
from sawbench.trial_report import trial_report

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


@pytest.mark.parametrize(("rel_std", "method", "n"), [(0.001, "force", 0), (0.08, "force", 1), (0.08, "current", 0)])
def test_a_gain_that_is_less_certain_than_the_fit_takes_it_is_noted(trial_and_fit, rel_std, method, n):
    trial, _ = trial_and_fit
    stated = Calibration(scale=250.0, raw_unit="mV/V", rel_std=rel_std).model_dump_json(exclude_none=True)
    recording = replace(
        trial.recording, provenance={**trial.recording.provenance, "calibration values force_n": stated}
    )
    fit, _ = fit_trial(replace(trial, recording=recording), method)
    assert len([note for note in fit.notes if "force_gain_rel_std = 0.08" in note and "8.00%" in note]) == n
    assert n or not any("force_gain_rel_std" in note for note in fit.notes)


def test_replayed_force_gives_the_measured_stroke_and_current(trial_and_fit):
    trial, fit = trial_and_fit
    found = measured_force_cycle(trial, fit)
    for channel, closely in (("force_n", 0.01), ("motor_current_a", 0.005)):
        folded = trial.processed.folded[channel]
        model = np.interp(folded.angle_rad, found["angle_rad"], found[channel], period=2 * np.pi)
        assert np.sqrt(np.mean((model - folded.mean) ** 2)) < closely * folded.mean.max()


def test_discharges_end_at_the_cut_off_and_at_the_predicted_runtime(trial_and_fit):
    trial, _ = trial_and_fit
    found = evaluate(trial)
    curves = discharges_of(trial, found.fit, found.estimates)
    assert set(curves) == {"linear force", "measured force"}
    for run in curves.values():
        assert (run.soc[0], run.soc[-1]) == pytest.approx((1.0, 0.2), abs=0.01)
        assert (np.diff(run.battery_voltage_v) < 0.0).all()
        # Charge drawn: the battery's 1.5 Ah, from full to the cut-off.
        assert np.trapezoid(run.battery_current_a, run.time_s) == pytest.approx(0.8 * 1.5 * 3600.0, rel=0.01)
    assert curves["linear force"].time_s[-1] == pytest.approx(found.runtime.runtime_s, rel=1e-5)


def test_report_collects_every_part_of_the_page(trial_and_fit):
    trial, fit = trial_and_fit
    found = trial_report(trial, Evaluation(fit=fit))
    assert set(found.model) == {"linear force", "measured force"}
    assert set(found.spectra) == {"displacement_mm", "force_n"}
    assert (found.runtime, dict(found.discharges)) == (None, {})


def test_report_of_an_idle_recording_says_why_it_has_no_fit(tmp_path, capsys):
    arguments = ["report", str(OAK.with_name("none-01.mcap")), "--out", str(tmp_path / "pages"), "--json"]
    assert main(arguments) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["trial"], row["trust"]) == ("none-01", "good")
    text = Path(row["page"]).read_text(encoding="utf-8")
    assert "None: idle run" in text
    assert "Model and measurement" not in text
    assert main(arguments) == 2
    assert "already exists" in capsys.readouterr().err
