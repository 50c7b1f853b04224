"""Proposed trials in words, on the page, and as a table that a series reads."""

from __future__ import annotations

import copy

import pytest
from sawbench.acquisition.series.plan import load_plan
from sawbench.bench.errors import InputError
from sawbench.reporting.trial_plan import plan_rows, plan_sentences
from sawbench.results import GapReport

from tests.reporting.test_gap_page import REPORT

pytestmark = pytest.mark.unit

CUT = {
    "id": "next-19", "material": "oak, wet", "duty": 0.55, "feed_mm_s": 4.0, "thickness_mm": 20.0, "seconds": 10.0,
    "rest_s": 0.0, "blade": "B3", "battery": "P1", "is_new": True, "minutes": 1.25,
    "between": ["guide_friction", "windage_drag"], "log_odds": 2.24, "expected_probability": 0.912,
}  # fmt: skip
AIR = CUT | {
    "id": "next-20", "material": "none", "feed_mm_s": None, "thickness_mm": None, "rest_s": 900.0, "blade": None,
    "is_new": False, "minutes": 16.25, "between": ["edge_force + guide_friction", "no_gap"],
    "expected_probability": 0.99971,
}  # fmt: skip
PLAN = {
    "trials": [CUT, AIR], "reason": "", "considered": [], "expected_probability": 0.713, "least_log_odds": 1.0,
    "n_candidates": 72,
    "inseparable": [{"causes": ["guide_friction", "motor_coulomb_friction"], "log_odds": 0.31}],
}  # fmt: skip
NOTHING = PLAN | {"trials": [], "reason": "no single trial adds log odds of 1 between what is still possible"}


def test_rows_say_what_to_set_and_what_it_tells():
    first, second = plan_rows(PLAN)
    assert [first[key] for key in ("material", "duty", "feed", "thickness", "length", "rest")] == [
        "oak, wet", "0.55", "4", "20", "10", "",
    ]  # fmt: skip
    assert (first["between"], first["log_odds"], first["probability"]) == (
        "guide friction or windage drag", "2.2", "91.2 %",
    )  # fmt: skip
    assert (second["material"], second["feed"], second["rest"]) == ("in air", "", "900")
    assert (second["between"], second["probability"]) == ("edge force and guide friction or no gap", "over 99.9 %")


def test_words_say_what_the_plan_is_worth_and_what_it_cannot_do():
    worth, new, inseparable = plan_sentences(PLAN)
    assert "these 2 trials (18 minutes)" in worth
    assert "from 71.3 % to over 99.9 %" in worth
    assert "not yet run" in new
    assert inseparable.startswith("No trial of this bench tells guide friction from motor coulomb friction")
    assert "log odds of 0.3. Measure instead" in inseparable
    assert plan_sentences(NOTHING)[0] == (
        "No trial is proposed: no single trial adds log odds of 1 between what is still possible."
    )


def test_a_next_trial_beside_an_empty_plan_is_explained():
    _, why, *_ = plan_sentences(NOTHING, "a repeat of oak, 20 mm: it reduces the uncertainty of the magnitude most")
    assert "the next trial named above may" in why
    assert "next trial" not in " ".join(plan_sentences(NOTHING, "none: the model explains the measurements"))
    # A plan of other trials does not contradict it: both are on the page.
    assert why in plan_sentences(PLAN, "an idle run")


def saved(folder, plan, **options):
    report = copy.deepcopy(REPORT) | ({} if plan is None else {"plan": plan})
    return GapReport(report=report).save(folder, **options)[1].read_text(encoding="utf-8")


def test_the_saved_table_is_a_plan_of_a_series(tmp_path):
    text = saved(tmp_path, PLAN)
    assert text.index("Trials to run next") < text.index("<h2>Causes</h2>")
    loaded = load_plan(tmp_path / "plan.csv")
    cut, air = loaded.plan.trial
    assert (cut.id, cut.setting) == ("next-19", ("oak, wet", 0.55, 4.0, 20.0))
    assert (cut.seconds, cut.rest_s, cut.blade, cut.battery) == (10.0, 0.0, "B3", "P1")
    assert air.is_idle
    assert air.setting == ("none", 0.55, None, None)
    assert air.rest_s == 900.0
    assert loaded.folder == tmp_path / "plan"


def test_a_plan_of_an_earlier_diagnosis_is_removed_or_kept_as_asked(tmp_path):
    saved(tmp_path, PLAN)
    with pytest.raises(InputError, match="already exists"):
        saved(tmp_path, PLAN)
    empty = saved(tmp_path, NOTHING, overwrite=True)
    assert "No trial is proposed" in empty and "the next trial named above may" in empty
    assert not (tmp_path / "plan.csv").exists()
    assert "Trials to run next" not in saved(tmp_path, None, overwrite=True)
