"""A campaign of the blind check's plant, diagnosed from its files to the report."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from sawbench.bench.config import load_config
from sawbench.bench.errors import InputError
from sawbench.blindcheck.campaign import make_campaign
from sawbench.commands.diagnose import DiagnosisRequest, diagnosed
from sawbench.commands.main import main
from sawbench.modeling.machines.known_effects import known_effects
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.pipeline

SAMPLES = Path(__file__).parents[2] / "recordings"


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    make_campaign(901, folder / "tables", effects={"motor_coulomb_friction": 1.5}, length=0.4, rate_hz=2500.0)
    assert main(["import", str(folder / "tables" / "campaign.toml"), "--out", str(folder / "mcap")]) == 0
    config = folder / "tables" / "bench_config.toml"
    assert main(["diagnose", str(folder / "mcap"), "--config", str(config), "--out", str(folder / "gap")]) == 0
    return json.loads((folder / "gap" / "gap_report.json").read_text()), folder / "gap" / "gap_report.html"


def test_report_has_every_key_of_the_contract(report):
    found, _ = report
    keys = {"schema_version", "verdict", "where", "causes", "probabilities", "parameter_shifts", "gap", "signals"}
    assert keys | {"next_trial", "provenance"} <= set(found)
    assert found["schema_version"] == 1
    assert set(found["probabilities"]) == {"no_gap", "parameters", "unknown"}
    assert {"metric", "nominal", "retuned", "with_effect", "noise_floor", "by_channel"} <= set(found["gap"])
    cause_keys = {"effects", "indistinguishable_from", "probability", "parameters", "gap_closed", "gap_closed_ci95"}
    for cause in found["causes"]:
        assert cause_keys <= set(cause)
        assert 0 <= cause["probability"] <= 1
    assert len(found["causes"]) >= 2, "the runner-up is always shown"
    assert len(found["provenance"]["recordings"]) == 18


def test_the_hidden_friction_is_named_first(report):
    found, _ = report
    assert found["verdict"] == "effect"
    assert found["causes"][0]["effects"] == ["motor_coulomb_friction"]
    assert found["causes"][0]["gap_closed"] > 0.5
    assert found["gap"]["with_effect"] < found["gap"]["retuned"] < found["gap"]["nominal"]


def test_the_next_trial_is_one_of_this_campaign(report):
    found, _ = report
    advice = found["next_trial"]
    assert "motor coulomb friction" in advice
    assert "duty 0." in advice, "names an operating point"


def test_places_and_probabilities_agree_with_the_verdict(report):
    found, _ = report
    assert found["where"][0]["equation"] == "mechanical"
    total = sum(found["detail"]["probabilities"].values())
    assert total == pytest.approx(1.0, abs=1e-3)
    assert found["causes"][0]["probability"] == max(found["detail"]["probabilities"].values())


def test_the_improved_model_leaves_no_cause_to_name(report, capsys):
    """The loop closes: what was found goes into the model, and the same campaign shows nothing more."""
    _, page = report
    folder, improved = page.parent.parent, page.parent / "improved_model.toml"
    (known,) = known_effects(load_config(improved).config, path=str(improved))
    assert known.effect.name == "motor_coulomb_friction"
    assert 0.005 < known.value < 0.02
    assert f"--config {improved.name}" in page.read_text()
    recordings = str(folder / "mcap")
    assert main(["diagnose", recordings, "--config", str(improved), "--out", str(folder / "again")]) == 0
    again = json.loads((folder / "again" / "gap_report.json").read_text())
    assert again["verdict"] in {"no_gap", "parameters"}
    before, after = (r["gap"]["by_channel"]["motor_current_a"]["nominal"] for r in (report[0], again))
    assert after < 0.1 * before
    capsys.readouterr()
    cutting = next(path for path in sorted((folder / "mcap").glob("*.mcap")) if not is_idle(path))
    assert main(["runtime", str(cutting), "--config", str(improved), "--json"]) == 0
    (predicted,) = json.loads(capsys.readouterr().out)
    assert predicted["contributions_s"]["motor_coulomb_friction.torque_n_m"] > 0.0


def is_idle(path):
    return read_recording(path).trial.is_idle


def test_page_needs_no_network(report):
    text = report[1].read_text()
    assert "motor coulomb friction" in text
    assert 'src="http' not in text and 'href="http' not in text


def test_files_without_displacement_get_a_clear_error(tmp_path, capsys):
    (tmp_path / "t.csv").write_text("time_s,motor_current_a\n" + "\n".join(f"{k / 1000},1.0" for k in range(3000)))
    assert main(["import", str(tmp_path / "t.csv"), "--out", str(tmp_path / "mcap")]) == 0
    assert (
        main(["diagnose", str(tmp_path / "mcap"), "--config", "bench_config.toml", "--out", str(tmp_path / "g")]) == 2
    )
    assert "left out" in capsys.readouterr().err


def test_held_out_strokes_are_predicted_in_the_units_of_the_channels(report):
    found, _ = report
    gap = found["gap"]
    assert {"force_n", "motor_current_a", "crank_speed_rad_s", "battery_voltage_v", "battery_current_a"} <= set(
        gap["by_channel"]
    )
    for name in ("motor_current_a", "crank_speed_rad_s"):
        row = gap["by_channel"][name]
        assert row["with_effect"] < 0.3 * row["retuned"], name
        assert row["with_effect"] < 0.3 * row["nominal"], name
    runtime = gap["runtime_s"]
    assert abs(runtime["with_effect"] - runtime["measured"]) < 0.3 * abs(runtime["nominal"] - runtime["measured"])
    low, high = found["causes"][0]["gap_closed_ci95"]
    assert low <= found["causes"][0]["gap_closed"] <= high


def test_report_is_small_and_the_page_shows_strokes_and_places(report):
    found, page = report
    assert page.with_suffix(".json").stat().st_size < 300_000
    assert 1 <= len(found["detail"]["strokes"]) <= 3
    text = page.read_text()
    assert text.count("<svg role") == 4


def test_what_stands_out_is_said_for_every_partition(report):
    found, page = report
    standing_out = found["detail"]["standing_out"]
    partitions = standing_out["partitions"]
    assert set(partitions) == {"crank_angle", "harmonic", "time", "start_up", "operating_point"}
    assert partitions["time"]["places"] == ["start-up", "0 to 25 %", "25 to 50 %", "50 to 75 %", "75 to 100 %"]
    q_values = [
        q for p in partitions.values() for e in p["equations"].values() for q in e["q_value"] if q is not None
    ]  # fmt: skip
    assert len(q_values) == standing_out["n_cells"]
    assert sum(q < standing_out["false_discovery_rate"] for q in q_values) == standing_out["n_found"]
    assert {entry["equation"] for entry in standing_out["found_in"]} <= {"mechanical"}
    assert f"of {standing_out['n_cells']}" in page.read_text()


def test_each_campaign_is_diagnosed_once_in_a_folder_of_its_own(tmp_path, capsys, monkeypatch):
    from sawbench.commands import diagnose

    asked = []

    def diagnosed(request):
        asked.append(request.out_dir.name)
        if request.paths[0].name == "bad":
            raise InputError("has no trial that can be diagnosed", where=request.paths[0])
        request.out_dir.mkdir(exist_ok=True)
        causes = [{"effects": ["guide_friction"], "probability": 0.9, "gap_closed": 0.8}]
        probabilities = {"no_gap": 0.04, "unknown": 0.06}
        detail = {"contradiction": ""}
        return {"verdict": "effect", "causes": causes, "probabilities": probabilities, "detail": detail}

    monkeypatch.setattr(diagnose, "diagnosed", diagnosed)
    for name in ("one", "two", "bad"):
        (tmp_path / name).mkdir()
        shutil.copy(SAMPLES / "none-01.mcap", tmp_path / name)
    call = ["diagnose", *(str(tmp_path / name) for name in ("one", "two", "bad")), "--each", "--out"]
    assert main([*call, str(tmp_path / "gaps")]) == 2
    shown = capsys.readouterr()
    assert "guide friction" in shown.out and "90 %" in shown.out
    assert "2 of 3 campaigns" in shown.out
    assert "bad: " in shown.err and "has no trial" in shown.err
    shutil.copy(SAMPLES / "oak-01.mcap", tmp_path / "two")
    assert main([*call, str(tmp_path / "gaps"), "--json"]) == 2
    rows = json.loads(capsys.readouterr().out)
    assert [(row["campaign"], row["verdict"]) for row in rows] == [("one", "effect"), ("two", "effect")]
    assert asked == ["one", "two", "bad", "two"]


def test_the_journal_of_an_import_is_no_campaign(tmp_path, capsys):
    for name in ("one", "two"):
        (tmp_path / "imported" / name).mkdir(parents=True)
        (tmp_path / "imported" / name / "a.mcap").write_text("not a recording")
    (tmp_path / "imported" / "batch.jsonl").write_text("{}\n")
    named = map(str, (tmp_path / "imported").glob("*"))
    assert main(["diagnose", *named, "--each", "--out", str(tmp_path / "gaps")]) == 2
    shown = capsys.readouterr()
    assert "0 of 2 campaigns" in shown.out
    assert "batch.jsonl" not in shown.err


def test_jobs_of_one_campaign_are_wrong_usage(tmp_path, capsys):
    assert main(["diagnose", str(SAMPLES), "--out", str(tmp_path / "g"), "--jobs", "2"]) == 2
    assert "--each" in capsys.readouterr().err


def test_rejected_trials_beside_a_campaign_are_said_in_its_report(tmp_path, monkeypatch):
    """A rejected trial used battery and blade as a kept one does."""
    folder = tmp_path / "wood"
    (folder / "rejected").mkdir(parents=True)
    for name in ("1.mcap", "2.mcap", "rejected/2-1.mcap", "rejected/2-2.mcap"):
        (folder / name).touch()
    reports = []
    monkeypatch.setattr("sawbench.analysis.open_trial", lambda *_: None)
    monkeypatch.setattr("sawbench.gap.diagnose_trials", lambda *_, **__: {"warnings": ["another"]})
    monkeypatch.setattr("sawbench.results.GapReport.save", lambda self, *_, **__: reports.append(self.report))
    request = DiagnosisRequest(
        paths=(folder,), out_dir=tmp_path / "gap", config_path=None, until_closed=False, n_planned=0
    )
    diagnosed(request)
    another, said = reports[0]["warnings"]
    assert another == "another" and said.startswith("2 rejected trials are in wood/rejected")
    assert "state of charge" in said
    for file in (folder / "rejected").iterdir():
        file.unlink()
    assert diagnosed(request)["warnings"] == ["another"]
