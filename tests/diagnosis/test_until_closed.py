"""Causes one by one: three effects in three equations are found, an intact machine gets none, what is needless goes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from sawbench.diagnosis.answer.prediction import Predictions
from sawbench.diagnosis.answer.until_closed import Pass, closing_table, held, until_closed
from sawbench.diagnosis.inference.columns import catalogue_columns
from sawbench.diagnosis.inference.posterior import judge

from tests.rigs.jigsaw_in_time import K_CUT, R_BATTERY
from tests.rigs.scattered_strokes import problem_of, strokes

pytestmark = pytest.mark.pipeline

# The edge force is half of its typical magnitude: less is hardly told from a little of several effects of the cut.
DRAG_N_M, EXTRA_OHM, EDGE_N = 0.006, 0.06, 20.0
TRUTH = {"motor_coulomb_friction": DRAG_N_M, "battery_internal_resistance": EXTRA_OHM, "edge_force": EDGE_N}


def asked(**machine):
    problem = problem_of(strokes(**machine))
    columns = catalogue_columns(problem, problem.campaign.plant.effects)
    return held(problem, columns, judge(problem, columns))


@pytest.fixture(scope="module")
def first():
    """Dry friction of the motor, a resistive battery and a blunt edge, integrated in time."""
    return asked(
        drag=lambda w, load: DRAG_N_M,
        battery_resistance=R_BATTERY + EXTRA_OHM,
        cut=lambda v, x, m: K_CUT * v + EDGE_N * np.tanh(v / 0.01),
    )


@pytest.fixture(scope="module")
def closing(first):
    return until_closed(first)


def test_all_three_effects_are_named_where_one_weighing_names_two_at_most(first, closing):
    assert len(first.posterior.best.effects) < 3
    assert set(closing.answer.posterior.best.effects) == set(TRUTH)
    assert {rung.effect for rung in closing.rungs} == set(TRUTH)
    assert closing.n_passes > 1


def test_magnitudes_are_those_that_were_put_in(closing):
    for rung in closing_table(closing)["rungs"]:
        (stated,) = rung["parameters"].values()
        assert abs(stated["value"] - TRUTH[rung["effect"]]) < 2.0 * stated["std"]
        assert stated["value"] == pytest.approx(TRUTH[rung["effect"]], rel=0.1)


def test_the_ladder_goes_down_to_the_noise_cause_by_cause(closing):
    table = closing_table(closing)
    steps = [table["nominal"], table["retuned"], *(rung["with_effect"] for rung in table["rungs"])]
    assert all(later < earlier for earlier, later in pairwise(steps))
    assert steps[-1] == pytest.approx(table["noise_floor"], rel=0.15)
    assert table["rungs"][-1]["gap_closed"] > 0.98
    assert table["stopped"] in {"no_gap", "parameters", "repeatability"}


def test_two_effects_choose_their_forms_in_every_withheld_fit_as_one_does():
    """Fewer effects, which choose freely, are what they are compared with: one form that is off must not decide."""
    found = asked(
        lost_voltage=lambda i, w: 0.9 * np.tanh(i),
        cut=lambda v, x, m: K_CUT * v + EDGE_N * np.tanh(v / 0.01),
    )
    best = found.posterior.of("brush_voltage_drop + edge_force")

    def left(members):
        predictions = Predictions(found.problem, found.columns, found.posterior)
        return predictions.of(replace(best, members=members), by_trial=False).ladder.whitened.with_effect

    for k, member in enumerate(best.members):
        others = [c for c in found.columns[member.effect.name] if c.columns.shape == member.column.columns.shape]
        off = max(others, key=lambda c: np.linalg.norm(c.columns - member.column.columns))
        members = (*best.members[:k], replace(member, column=off), *best.members[k + 1 :])
        assert left(members) == pytest.approx(left(best.members), rel=0.02)


def test_what_is_followed_on_trial_takes_another_form_and_its_probability_from_all_together(first):
    """ "Unknown" is likelier than what was found, which stands in its worst form: what was missing had decided that."""
    best, unknown = first.posterior.best, first.posterior.of("unknown")
    wrong = [replace(m, column=first.columns[m.effect.name][-1]) for m in best.members]
    rest = [replace(h, probability=0.0) for h in first.posterior.hypotheses if h not in (best, unknown)]
    believed = (replace(unknown, probability=0.6), replace(best, members=tuple(wrong), probability=0.4), *rest)
    posterior = replace(first.posterior, hypotheses=believed)
    predictions = Predictions(first.problem, first.columns, posterior)
    closing = until_closed(
        Pass(problem=first.problem, columns=first.columns, posterior=posterior, predictions=predictions)
    )
    answer = closing.answer.posterior
    assert set(answer.best.effects) == set(TRUTH)
    assert 0.0 < answer.of("unknown").probability < 0.5
    assert all(rung.probability <= 1.0 - answer.of("unknown").probability + 1e-9 for rung in closing.rungs)
    shapes = {m.effect.name: m.column.shape for m in answer.best.members}
    # A resistance that does not grow with the discharge, and an edge that bites at once.
    assert shapes["battery_internal_resistance"] == {}
    assert shapes["edge_force"]["onset_m_s"] == pytest.approx(0.01, rel=0.1)


def test_probabilities_of_all_answers_sum_to_one_and_the_likeliest_holds_all_causes(closing):
    posterior = closing.answer.posterior
    assert sum(h.probability for h in posterior.hypotheses) == pytest.approx(1.0)
    assert posterior.verdict == "effects"
    assert posterior.best.probability == max(h.probability for h in posterior.hypotheses)


def test_a_machine_without_a_gap_gets_no_cause_and_no_second_pass():
    found = until_closed(asked())
    assert (found.rungs, found.n_passes, found.stopped) == ((), 1, "no_gap")
    assert closing_table(found)["rungs"] == []


def certain_of(asked_for, name):
    sure = [replace(h, probability=float(h.name == name)) for h in asked_for.posterior.hypotheses]
    posterior = replace(asked_for.posterior, hypotheses=tuple(sorted(sure, key=lambda h: -h.probability)))
    return held(asked_for.problem, asked_for.columns, posterior)


def test_a_wrong_cause_that_a_later_one_makes_needless_is_dropped():
    """Air resistance is believed for sure where dry friction acts; the friction takes its place."""
    wrong = certain_of(asked(drag=lambda w, load: 0.012), "windage_drag")
    assert wrong.posterior.best.effects == ("windage_drag",), "else there is nothing to drop"
    found = until_closed(wrong)
    assert found.answer.posterior.best.effects == ("motor_coulomb_friction",)
    assert found.dropped == ("windage_drag",)
