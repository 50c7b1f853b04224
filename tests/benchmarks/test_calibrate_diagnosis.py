"""The development campaigns that the weights are fitted on, and what leaving some of them out says."""

from __future__ import annotations

import json

import pytest
from sawbench.blindcheck.effects.table import CATALOGUE
from sawbench.diagnosis.inference.settings import SETTINGS

from benchmarks import calibrate_diagnosis

WEIGHTS = SETTINGS.weights
pytestmark = pytest.mark.unit


def record(seed, kind, effects, log_evidence, *, forms="own"):
    return {
        "seed": seed, "kind": kind, "effects": effects, "parameters": "within", "forms": forms,
        "log_evidence": {"no_gap": 0.0, "parameters": 1.0, "unknown": -5.0, **log_evidence},
        "left_over": {"no_gap": 3.0, "parameters": 2.9, **dict.fromkeys(log_evidence, 0.2)},
        "shared": {}, "quiet": 0.15,
    }  # fmt: skip


def test_every_development_seed_is_drawn_once_and_stays_below_those_of_claims():
    rows = [*calibrate_diagnosis.plan(272), *calibrate_diagnosis.more_pairs(200), *calibrate_diagnosis.more_intact(300)]
    seeds = [row["seed"] for row in rows]
    assert len(set(seeds)) == len(seeds) == 772
    assert max(seeds) <= calibrate_diagnosis.LAST_SEED
    assert {e for row in rows[:68] if row["kind"] == "effect" for e in row["effects"]} == set(CATALOGUE)
    for row in calibrate_diagnosis.more_pairs(60):
        assert len(row["effects"]) == 2
        assert all(0.5 <= size <= 2.0 for size in row["effects"].values())


def test_more_campaigns_leave_those_before_as_they_were():
    assert calibrate_diagnosis.more_pairs(5) == calibrate_diagnosis.more_pairs(9)[:5]
    assert calibrate_diagnosis.plan(10) == calibrate_diagnosis.plan(80)[:10]


@pytest.mark.parametrize(("option", "number"), [("--cases", "500"), ("--pairs", "201"), ("--intact", "301")])
def test_seeds_of_claims_are_refused(monkeypatch, tmp_path, capsys, option, number):
    monkeypatch.setattr("sys.argv", ["calibrate_diagnosis", "collect", str(tmp_path), option, number])
    with pytest.raises(SystemExit):
        calibrate_diagnosis.main()
    assert "seeds above 999 are for claims" in capsys.readouterr().err


def test_constants_come_back_from_their_numbers():
    back = calibrate_diagnosis.weights_of(calibrate_diagnosis.numbers_of(WEIGHTS))
    for name in ("temperature", "pair_gain", "pair_least", "open_share", "prior_no_gap", "prior_unknown"):
        assert getattr(back, name) == pytest.approx(getattr(WEIGHTS, name))


def test_leaving_an_effect_out_answers_its_campaigns_with_constants_that_have_not_seen_them(monkeypatch):
    rows = [
        record(1, "effect", {"edge_force": 1.0}, {"edge_force": 200.0}),
        record(2, "effect", {"guide_friction": 1.0}, {"guide_friction": 200.0}),
        record(3, "none", {}, {"guide_friction": -3.0}),
    ]
    fitted_on = []

    def fit(kept, temperature=None, near=None):
        fitted_on.append([row["seed"] for row in kept])
        return WEIGHTS

    monkeypatch.setattr(calibrate_diagnosis, "fit", fit)
    lines = calibrate_diagnosis.leave_out(rows, calibrate_diagnosis.by_effect(rows)).splitlines()
    assert fitted_on[0] == [1, 2, 3]
    assert sorted(fitted_on[1:]) == [[1, 3], [2, 3]]
    assert [line.split()[0] for line in lines[1:]] == ["guide_friction", "edge_force", "all"]
    assert lines[-1].split()[3:6] == ["2", "2", "2"]


def test_kinds_of_benches_are_left_out_where_others_remain():
    noises = ("0.3 to 0.7", "1.5 to 4", "1.5 to 4")
    rows = [
        record(seed, "none", {}, {"guide_friction": -3.0})
        | {"shifts": {"noise": noise, "hum": hum, "machine": "another jigsaw"}}
        for seed, noise, hum in zip((1, 2, 3), noises, ("with", "without", "with"), strict=True)
    ]
    found = calibrate_diagnosis.by_shift(rows)
    assert {name: [row["seed"] for row in own] for name, own in found.items()} == {
        "hum: with": [1, 3], "noise: 0.3 to 0.7": [1], "noise: 1.5 to 4": [2, 3],
    }  # fmt: skip


def test_answers_with_other_forms_stand_beside_each_other(monkeypatch, tmp_path, capsys):
    for forms, evidence in (("own", 200.0), ("plain", -2.0)):
        folder = tmp_path / forms
        folder.mkdir()
        row = record(1, "effect", {"edge_force": 1.5}, {"edge_force": evidence}, forms=forms)
        (folder / "case-0001.json").write_text(json.dumps(row), encoding="utf-8")
    arguments = ["calibrate_diagnosis", "compare", str(tmp_path / "own"), str(tmp_path / "plain")]
    monkeypatch.setattr("sys.argv", arguments)
    calibrate_diagnosis.main()
    lines = capsys.readouterr().out.splitlines()
    assert "own forms" in lines[0]
    assert "plain forms" in lines[0]
    hidden, own, plain = (cell.strip() for cell in lines[1].split("|"))
    assert hidden == "edge_force 1.50"
    assert own.startswith("right")
    assert not plain.startswith("right")
    assert lines[2] == "1 campaigns: 1 right with own forms, 0 with plain forms"


def test_an_empty_folder_is_named(tmp_path):
    with pytest.raises(SystemExit, match="run collect first"):
        calibrate_diagnosis.records(tmp_path)
