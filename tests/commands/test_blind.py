"""`sawbench blind` from the command line: make, answer, score, and what it refuses."""

from __future__ import annotations

import json
import math
import re
from collections import Counter

import pytest
import sawbench.commands.blind
from sawbench.bench.config import load_config
from sawbench.bench.source_identity import software_identity, source_fingerprint
from sawbench.blindcheck.campaign import make_campaign
from sawbench.blindcheck.drawing import draw_campaign
from sawbench.blindcheck.effects.table import CATALOGUE, OUTSIDE
from sawbench.blindcheck.sealing import draw_cases
from sawbench.commands.blind_oracle import closable_share, make_twin, oracle_gaps
from sawbench.commands.main import main
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME

pytestmark = pytest.mark.pipeline

NOT_LOOKED_FOR = "called unknown, effects outside the catalogue that the diagnosis does not look for either"


@pytest.fixture
def answered(sealed, program, monkeypatch):
    monkeypatch.setattr(sawbench.commands.blind, "diagnose_program", lambda **_: program())
    assert main(["blind", "answer", str(sealed[0]), "--workers", "2"]) == 0
    return str(sealed[0]), str(sealed[1])


@pytest.mark.parametrize("name", ["make", "answer", "score"])
def test_help_has_an_example(name, capsys):
    assert main(["blind", name, "--help"]) == 0
    assert f"Example: sawbench blind {name}" in " ".join(capsys.readouterr().out.split())


def test_make_writes_a_set_and_a_key_beside_it(tmp_path, capsys):
    arguments = ["blind", "make", "--seed", "21", "--cases", "1", "--length", "0.02", "--workers", "1", "--json"]
    assert main([*arguments, "--out", str(tmp_path / "set")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["key"] == str(tmp_path / "set.key.json")
    assert (tmp_path / "set" / "case-0001" / "campaign.toml").exists()
    assert main([*arguments, "--out", str(tmp_path / "set"), "--key", str(tmp_path / "set" / "k.json")]) == 2


def test_foreign_benches_are_made_answered_and_scored_by_kind(tmp_path, program, monkeypatch, capsys):
    out, page = tmp_path / "set", tmp_path / "page.html"
    made = ["blind", "make", "--seed", "23", "--cases", "3", "--length", "0.02", "--benches", "foreign", "--json"]
    assert main([*made, "--without", "hum", "--without", "rate", "--out", str(out), "--workers", "1"]) == 0
    key = json.loads((tmp_path / "set.key.json").read_text())
    assert key["options"]["without"] == ["hum", "rate"]
    assert set(key["options"]["catalogue"]) == {name for name in EFFECT_BY_NAME if name in {**CATALOGUE, **OUTSIDE}}
    monkeypatch.setattr(sawbench.commands.blind, "diagnose_program", lambda **_: program())
    capsys.readouterr()
    assert main(["blind", "answer", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["n_new"] == 3
    assert main(["blind", "score", str(out), "--key", str(tmp_path / "set.key.json"), "--out", str(page)]) == 0
    assert "kind of bench" in capsys.readouterr().out
    score = json.loads(page.with_suffix(".json").read_text())["score"]
    cases_of = Counter()
    for one in score["by_shift"]:
        cases_of[one["shift"]] += one["n_cases"]
    assert set(cases_of.values()) == {3}
    html = page.read_text()
    assert "Kinds of benches" in html
    assert all(f"{one['shift']}: {one['value']}" in html for one in score["by_shift"])
    assert "agrees with itself" in html


def test_what_cannot_be_left_out_is_wrong_usage(tmp_path, capsys):
    made = ["blind", "make", "--seed", "23", "--cases", "1", "--benches", "foreign", "--out", str(tmp_path / "set")]
    assert main([*made, "--without", "humm"]) == 2
    assert "wandering_zero" in capsys.readouterr().err


def test_a_set_of_slider_cranks_is_one(tmp_path, capsys):
    made = ["blind", "make", "--seed", "24", "--cases", "1", "--length", "0.02", "--mechanism", "slider_crank"]
    assert main([*made, "--out", str(tmp_path / "set"), "--workers", "1"]) == 0
    plant = load_config(tmp_path / "set" / "case-0001" / "bench_config.toml").plant()
    assert plant.mechanism == "slider_crank"


def test_score_writes_page_and_json(answered, tmp_path, capsys):
    page = tmp_path / "page.html"
    capsys.readouterr()
    assert main(["blind", "score", answered[0], "--key", answered[1], "--out", str(page)]) == 0
    text = capsys.readouterr().out
    assert "false alarms" in text
    assert NOT_LOOKED_FOR in text
    assert "not computed" in text
    record = json.loads(page.with_suffix(".json").read_text())
    assert record["set"]["seed"] == 21
    assert record["set"]["is_claim"] is False
    assert record["score"]["n_cases"] == 4
    html = page.read_text()
    assert "this score is not evidence of performance" in html
    assert re.search(r"seed 21\b", html)
    assert NOT_LOOKED_FOR in html
    assert not re.search(r'(src|href)="(?!#)', html)
    assert html.count('<svg role="img"') == html.count("<desc ") == 5
    assert main(["blind", "score", answered[0], "--key", answered[1], "--out", str(page)]) == 2
    assert main(["blind", "score", answered[0], "--key", answered[1], "--out", str(page), "--force"]) == 0


def test_score_json_is_the_record(answered, capsys):
    capsys.readouterr()
    assert main(["blind", "score", answered[0], "--key", answered[1], "--json", "--shuffle", "3"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["shuffle_seed"] == 3
    assert {row["key"] for row in record["score"]["rows"]} >= {
        "exact", "group", "false_alarms", "unknown", "unknown_formless", "pair_both",
    }  # fmt: skip


@pytest.mark.parametrize("what", ["answer", "key", "campaign", "commitments"])
def test_tampering_ends_the_score(what, answered, capsys, tmp_path):
    places = {
        "answer": (tmp_path / "set" / "answers" / "case-0001.json", "edge_force", "blade_wear"),
        "key": (tmp_path / "safe" / "key.json", '"severity', '"x'),
        "campaign": (tmp_path / "set" / "case-0002" / "trial-01.csv", "0", "1"),
        "commitments": (tmp_path / "set" / "commitments.json", "a", "b"),
    }
    path, old, new = places[what]
    if what == "key":
        key = json.loads(path.read_text())
        key["cases"]["case-0001"]["label"]["kind"] = (
            "none" if key["cases"]["case-0001"]["label"]["kind"] != "none" else "pair"
        )
        path.write_text(json.dumps(key))
    else:
        changed = path.read_text().replace(old, new) if old in path.read_text() else path.read_text().replace(new, old)
        path.write_text(changed)
    capsys.readouterr()
    assert main(["blind", "score", answered[0], "--key", answered[1], "--json"]) == 2
    shown = capsys.readouterr()
    assert set(json.loads(shown.out)) == {"error"}
    assert "changed" in shown.err or "seal is broken" in shown.err
    assert "Traceback" not in shown.err


def test_score_without_answers_says_what_to_run(sealed, capsys):
    assert main(["blind", "score", str(sealed[0]), "--key", str(sealed[1])]) == 2
    assert "sawbench blind answer" in capsys.readouterr().err


def test_a_failed_answer_is_told_by_the_exit_code(sealed, program, monkeypatch, capsys):
    monkeypatch.setattr(sawbench.commands.blind, "diagnose_program", lambda **_: program("import sys; sys.exit(2)"))
    assert main(["blind", "answer", str(sealed[0])]) == 1
    assert "4 failed" in capsys.readouterr().out


def test_the_oracle_goes_on_where_it_stopped(tmp_path, monkeypatch):
    cache = tmp_path / "oracle.json"
    labels = {
        "a": {"kind": "effect", "truth": {"effects": {"edge_force": 1.0}}},
        "b": {"kind": "none", "truth": {"effects": {}}},
        "c": {"kind": "pair", "truth": {"effects": {"edge_force": 1.0, "blade_wear": 1.0}}},
    }
    asked = {"gap_closed": 0.75, "closable": 0.8}
    cache.write_text(json.dumps({"source_sha256": "s", "asked": {"a": asked, "c": None}}))
    assert oracle_gaps(tmp_path, labels, cache, source_sha256="s", workers=1) == {"a": asked}


def test_the_oracle_is_asked_about_as_many_cases_as_wanted(tmp_path):
    cache = tmp_path / "oracle.json"
    labels = {name: {"kind": "effect", "truth": {"effects": {"edge_force": 1.0}}} for name in ("a", "c")}
    asked = {"gap_closed": 0.75, "closable": 0.8}
    # Of the two, "c" has the smaller hash; no campaign is there to ask about "a".
    cache.write_text(json.dumps({"source_sha256": "s", "asked": {"c": asked}}))
    assert oracle_gaps(tmp_path, labels, cache, source_sha256="s", n_cases=1, workers=1) == {"c": asked}


def test_the_twin_has_the_background_of_the_campaign(tmp_path):
    hidden = next(iter(draw_campaign(7).background))
    truth = make_campaign(7, tmp_path / "campaign", effects={hidden: 1.0}, length=0.02)
    twin = make_twin(json.loads(json.dumps(truth)), tmp_path / "twin")
    assert hidden not in twin["background"]
    of_effects = {"effects": {}, "reported_parameters": {}}
    assert twin == truth | of_effects | {"sensors": twin["sensors"]}
    assert twin["sensors"]["gain"] == truth["sensors"]["gain"]


def test_nothing_can_be_closed_where_re_tuning_leaves_nothing():
    assert closable_share((1.005, 1.0), (1.0, 1.0)) is None
    # A twin that is left with more than the campaign itself: the effect hid something else.
    assert closable_share((2.0, 1.0), (2.5, 1.0)) == pytest.approx(1.0 - 5.25 / 3.0)
    assert closable_share((2.0, 1.0), (0.9, 1.0)) == 1.0


def test_the_identity_of_the_software_is_that_of_its_sources():
    identity = software_identity()
    assert re.fullmatch(r"[0-9a-f]{64}", identity["source_sha256"])
    assert identity["source_sha256"] == source_fingerprint()
    assert identity["commit"] is None or re.fullmatch(r"[0-9a-f]{40}", identity["commit"])


@pytest.mark.slow
def test_the_real_diagnosis_answers_a_set(tmp_path, capsys):
    out, page = tmp_path / "set", tmp_path / "score.html"
    # A force that does not follow the speed, well above its typical size: no constant of the tool can take it up. The
    # effect of the other case is in no catalogue, so the oracle is not asked about it.
    specs = draw_cases(214, 2)
    assert [(spec.kind, *spec.effects) for spec in specs] == [
        ("effect", "edge_force"),
        ("outside", "loose_pin_impacts"),
    ]
    assert specs[0].effects["edge_force"] > 1.5
    assert main(["blind", "make", "--seed", "214", "--cases", "2", "--length", "0.3", "--out", str(out)]) == 0
    assert main(["blind", "answer", str(out)]) == 0
    key = str(tmp_path / "set.key.json")
    capsys.readouterr()
    assert main(["blind", "score", str(out), "--key", key, "--oracle", "--out", str(page), "--json"]) == 0
    score = json.loads(capsys.readouterr().out)["score"]
    assert (score["n_cases"], score["n_failed"]) == (2, 0)
    assert all(time_s > 0 for time_s in score["times_s"])
    assert sum(sum(row) for row in score["confusion"]["counts"]) == 2
    assert set(score["confusion"]["rows"]) >= set(CATALOGUE)
    assert page.exists()
    asked = json.loads((tmp_path / "set.key.oracle.json").read_text())["asked"]
    assert set(asked) == {"case-0001"}
    found = asked["case-0001"]
    assert all(math.isfinite(found[name]) and found[name] > 0.5 for name in ("closable", "gap_closed"))
