"""What the benchmarks of the loop hide and how they count, on made-up answers."""

from __future__ import annotations

import pytest
from sawbench.blindcheck.effects.table import ACTS_IN, CATALOGUE

from benchmarks import closed_loop, plan_worth

pytestmark = pytest.mark.unit


def test_three_effects_act_in_equations_of_their_own():
    for number in range(20):
        hidden = closed_loop.hidden_in("three", number, 901 + number)
        places = [place for name in hidden for place in ACTS_IN[name]]
        assert len(hidden) == 3
        assert len(places) == len(set(places))
        assert all(0.5 <= size <= 2.0 for size in hidden.values())
    assert [*closed_loop.hidden_in("one", 1, 902)] == [list(CATALOGUE)[1]]


def row(named, *, verdict="effects", fresh="no_gap", fresh_miss=0.002, rel_std=0.002):
    return {
        "hidden": {"a": 1.0, "b": 1.0, "c": 1.0}, "named": named, "verdict": verdict, "fresh_verdict": fresh,
        "fresh_miss": fresh_miss, "runtime_rel_std": rel_std,
    }  # fmt: skip


def test_found_false_and_missed_effects_are_counted_apart():
    rows = [row(["a", "b", "c"]), row(["a", "b", "d"], fresh="effect", fresh_miss=-0.03), row(["a"], fresh_miss=0.02)]
    said = closed_loop.score(rows)
    assert said[0] == "all effects 1, all but one 2, exactly these 1, a false one in 1, of 3 cases"
    assert said[1] == (
        "correct claims: fresh campaign closed 1 of 1; runtime within 1 % 1 of 1; 95 % interval holds 1 of 1"
    )
    assert "closed 2 of 3; runtime within 1 % 1 of 3; 95 % interval holds 1 of 3" in said[2]


def test_a_trial_settles_where_the_truth_is_named_for_sure():
    def after(answer, share, of_truth):
        return {"answer": answer, "share": share, "of_truth": of_truth, "minutes": 2.0}

    sure = {"hidden": "a", "of_truth": 0.99}
    none = {"hidden": "a", "of_truth": 0.3, "after": {}}
    told = {
        "hidden": "a", "of_truth": 0.5,
        "after": {"proposed": after("a", 0.96, 0.96), "random": after("a", 0.7, 0.7), "repeat": after("b", 0.99, 0.0)},
    }  # fmt: skip
    said = plan_worth.summary([sure, none, told])
    assert said[0].startswith("3 campaigns, 1 sure at once, 1 for which no trial is proposed, 1 with one more trial")
    assert "settles 1 of 1, names the truth in 1" in said[1]
    assert "settles 0 of 1, names the truth in 1" in said[2]
    assert "settles 0 of 1, names the truth in 0" in said[3]
