"""The development campaigns, and how the answers to them are counted."""

from __future__ import annotations

import json

import pytest
from sawbench.blindcheck.effects.table import CATALOGUE

from benchmarks import development_campaigns

pytestmark = pytest.mark.unit


def record(seed, kind, effects, log_evidence, *, forms="own"):
    return {
        "seed": seed, "kind": kind, "effects": effects, "parameters": "within", "forms": forms,
        "log_evidence": {"no_gap": 0.0, "parameters": 1.0, "unknown": -5.0, **log_evidence},
        "left_over": {"no_gap": 3.0, "parameters": 2.9, **dict.fromkeys(log_evidence, 0.2)},
        "shared": {}, "quiet": 0.15,
    }  # fmt: skip


def test_every_development_seed_is_drawn_once_and_stays_below_those_of_claims():
    rows = [
        *development_campaigns.plan(272),
        *development_campaigns.more_pairs(200),
        *development_campaigns.more_intact(300),
    ]
    seeds = [row["seed"] for row in rows]
    assert len(set(seeds)) == len(seeds) == 772
    assert max(seeds) <= development_campaigns.LAST_SEED
    assert {e for row in rows[:68] if row["kind"] == "effect" for e in row["effects"]} == set(CATALOGUE)
    for row in development_campaigns.more_pairs(60):
        assert len(row["effects"]) == 2
        assert all(0.5 <= size <= 2.0 for size in row["effects"].values())


def test_more_campaigns_leave_those_before_as_they_were():
    assert development_campaigns.more_pairs(5) == development_campaigns.more_pairs(9)[:5]
    assert development_campaigns.plan(10) == development_campaigns.plan(80)[:10]


@pytest.mark.parametrize(("option", "number"), [("--cases", "500"), ("--pairs", "201"), ("--intact", "301")])
def test_seeds_of_claims_are_refused(monkeypatch, tmp_path, capsys, option, number):
    monkeypatch.setattr("sys.argv", ["development_campaigns", "collect", str(tmp_path), option, number])
    with pytest.raises(SystemExit):
        development_campaigns.main()
    assert "seeds above 999 are for claims" in capsys.readouterr().err


def test_kinds_of_benches_are_counted_where_others_remain():
    noises = ("0.3 to 0.7", "1.5 to 4", "1.5 to 4")
    rows = [
        record(seed, "none", {}, {"guide_friction": -3.0})
        | {"shifts": {"noise": noise, "hum": hum, "machine": "another jigsaw"}}
        for seed, noise, hum in zip((1, 2, 3), noises, ("with", "without", "with"), strict=True)
    ]
    found = development_campaigns.by_shift(rows)
    assert {name: [row["seed"] for row in own] for name, own in found.items()} == {
        "hum: with": [1, 3], "noise: 0.3 to 0.7": [1], "noise: 1.5 to 4": [2, 3],
    }  # fmt: skip


def test_each_kind_of_bench_has_a_line_with_its_answers():
    rows = [
        record(1, "effect", {"edge_force": 1.0}, {"edge_force": 200.0}) | {"shifts": {"hum": "with"}},
        record(2, "none", {}, {"guide_friction": 200.0}) | {"shifts": {"hum": "with"}},
        record(3, "none", {}, {"guide_friction": -3.0, "parameters": -1.0})
        | {"shifts": {"hum": "without"}, "left_over": {"no_gap": 0.1, "parameters": 0.1}},
    ]
    lines = development_campaigns.shift_table(rows).splitlines()
    assert [line.split()[:-1] for line in lines[1:]] == [
        ["all", "of", "them", "3", "2", "2", "1", "1", "of", "2"], ["hum:", "with", "2", "1", "2", "1", "1", "of", "1"],
    ]  # fmt: skip


def test_answers_with_other_forms_stand_beside_each_other(monkeypatch, tmp_path, capsys):
    for forms, evidence in (("own", 200.0), ("plain", -2.0)):
        folder = tmp_path / forms
        folder.mkdir()
        row = record(1, "effect", {"edge_force": 1.5}, {"edge_force": evidence}, forms=forms)
        (folder / "case-0001.json").write_text(json.dumps(row), encoding="utf-8")
    arguments = ["development_campaigns", "compare", str(tmp_path / "own"), str(tmp_path / "plain")]
    monkeypatch.setattr("sys.argv", arguments)
    development_campaigns.main()
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
        development_campaigns.records(tmp_path)
