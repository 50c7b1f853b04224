"""The small standing set: a few campaigns through the real diagnosis, scored as a set is.

The large one is made, answered and scored by the three commands of docs/blind_check.md. Seeds below 1000: no claim.
"""

from __future__ import annotations

import pytest
from sawbench.bench.config import load_config
from sawbench.blindcheck.campaign import make_campaign
from sawbench.blindcheck.claims import acts_in, is_coherent, place_of
from sawbench.blindcheck.scored_case import Case
from sawbench.blindcheck.scoring import score
from sawbench.diagnosis.answer.gap_report import diagnose
from sawbench.storage.importers.dispatch import import_path
from sawbench.storage.reader import read_recording

pytestmark = pytest.mark.pipeline

# Kind, hidden effects and seed; sizes in multiples of the typical one. The saw of the second has a slider crank.
SLIDER_CRANK = 903
# Of 18: every operating point twice.
N_TRIALS = 12
CASES = (
    ("none", {}, 951),
    ("effect", {"guide_friction": 1.5}, SLIDER_CRANK),
    ("effect", {"edge_force": 1.0}, 953),
    ("effect", {"converter_loss": 0.8}, 954),
    ("effect", {"grain_variation": 1.5}, 956),
    ("parameters", {}, 957),
)


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    found = []
    for kind, effects, seed in CASES:
        folder = tmp_path_factory.mktemp(f"case{seed}")
        make_campaign(
            seed, folder / "in", effects=effects, parameters="beyond" if kind == "parameters" else "within",
            length=0.4, rate_hz=2500.0, mechanism="slider_crank" if seed == SLIDER_CRANK else "scotch_yoke",
        )  # fmt: skip
        imported = import_path(folder / "in" / "campaign.toml", folder / "out")
        recordings = [read_recording(path) for path in imported.paths[:N_TRIALS]]
        found.append(diagnose(recordings, load_config(folder / "in" / "bench_config.toml"), provenance={}))
    return found


def as_case(number, kind, effects, report):
    answered = {tuple(c["effects"]): c["probability"] for c in report["causes"]} | report["probabilities"]
    is_claim = report["verdict"] in {"effect", "effects"}
    return Case(
        name=f"case-{number}",
        kind=kind,
        effects=effects,
        probabilities=answered,
        verdict=tuple(report["causes"][0]["effects"]) if is_claim else report["verdict"],
    )


def test_hidden_effects_are_named_and_nothing_else_is_claimed(reports):
    scored = score(
        [as_case(k, kind, effects, r) for k, ((kind, effects, _), r) in enumerate(zip(CASES, reports, strict=True))]
    )
    assert scored.row("exact").share == 1.0
    assert scored.row("false_alarms").share == 0.0


def test_the_hidden_friction_of_a_slider_crank_is_named_as_surely_as_that_of_a_yoke(reports):
    report = reports[[seed for *_, seed in CASES].index(SLIDER_CRANK)]
    first = report["causes"][0]
    assert report["verdict"] == "effect"
    assert first["effects"] == ["guide_friction"]
    assert first["probability"] > 0.8
    assert first["gap_closed"] > 0.7


def test_answers_dealt_to_other_campaigns_are_wrong(reports):
    effects = [
        (kind, hidden, report) for (kind, hidden, _), report in zip(CASES, reports, strict=True) if kind == "effect"
    ]
    dealt = [
        as_case(k, kind, hidden, effects[(k + 1) % len(effects)][2]) for k, (kind, hidden, _) in enumerate(effects)
    ]
    assert score(dealt).row("exact").share == 0.0


def test_the_gap_closes_where_the_effect_is_named(reports):
    for (kind, hidden, _), report in zip(CASES, reports, strict=True):
        if kind == "effect" and "grain_variation" not in hidden:
            assert report["causes"][0]["gap_closed"] > 0.5, hidden
            assert report["gap"]["with_effect"] < report["gap"]["retuned"]


def test_what_is_claimed_agrees_with_itself_and_lies_where_the_effect_acts(reports):
    for (_, hidden, _), report in zip(CASES, reports, strict=True):
        if report["verdict"] in {"effect", "effects"}:
            assert is_coherent(report["causes"][0]), hidden
        if report["where"]:
            assert sum(spot["share"] for spot in report["where"]) == pytest.approx(1.0)
        if hidden:
            assert acts_in(place_of(report), hidden), hidden
