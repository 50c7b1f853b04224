"""A slider-crank saw from its simulated bench to the runtime; tests/blindcheck/test_standing_set.py diagnoses one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from sawbench.blindcheck.plant import brute_force_runtime
from sawbench.blindcheck.settings import PlantSettings
from sawbench.commands.main import main
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.pipeline

SHIPPED = (Path(__file__).parents[2] / "bench_config.toml").read_text(encoding="utf-8")
CRANK = SHIPPED.replace("[plant]", '[plant]\nmechanism = "slider_crank"\nrod_length_m = 0.025', 1)


def told(capsys, *arguments):
    """Exit code and JSON of a command."""
    code = main([*map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_recorded_processed_fitted_and_its_runtime_predicted(tmp_path, capsys):
    config = tmp_path / "bench_config.toml"
    config.write_text(CRANK, encoding="utf-8")
    out = tmp_path / "demo"
    code, found = told(capsys, "demo", "--out", out, "--seconds", 8, "--no-view", "--config", config)
    truth = PlantSettings(**json.loads((out / "simulated_truth.json").read_text()))
    assert code == 0 and truth.rod_length_m == 0.025
    assert 'mechanism = "slider_crank"' in read_recording(found["files"]["recording"]).config_toml
    fit = found["fit"]
    assert fit["status"] == "ok"
    assert abs(fit["k_fc_n_s_per_m"] - truth.k_fc_n_s_per_m) < 3.0 * fit["std_n_s_per_m"]
    assert fit["std_n_s_per_m"] < 0.04 * truth.k_fc_n_s_per_m
    assert found["runtime"]["runtime_s"] == pytest.approx(brute_force_runtime(truth, 0.2), rel=0.02)
    # The same recording taken for a yoke is not fitted without a word: the fit converges and says that the model
    # does not describe the stroke.
    yoke = tmp_path / "yoke.toml"
    yoke.write_text(SHIPPED, encoding="utf-8")
    _, (as_yoke,) = told(capsys, "fit", found["files"]["recording"], "--config", yoke)
    assert as_yoke["rmse_a"] > 3.0 * fit["rmse_a"]
    assert any("differs from the model by more than noise explains" in note for note in as_yoke["notes"])
    assert as_yoke["status"] in {"ok", "contradicted"}
