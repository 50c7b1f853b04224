"""Which trial is advised, by what is still likely."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
from sawbench.diagnosis.answer.next_trial import next_trial
from sawbench.diagnosis.inference.columns import catalogue_columns
from sawbench.diagnosis.inference.evidence import explain
from sawbench.diagnosis.inference.hypothesis import named
from sawbench.diagnosis.inference.marginal import Marginal

from tests.rigs.scattered_strokes import friction, problem_of, strokes

pytestmark = pytest.mark.unit

NAMES = ("motor_coulomb_friction", "windage_drag")


@pytest.fixture(scope="module")
def problem():
    found = problem_of(strokes())
    gap = found.project(lambda state: {"mechanical": -friction(state)["mechanical"]})
    return replace(found, data=found.data + gap)


def advised(problem, probabilities):
    effects = [e for e in problem.campaign.plant.effects if e.name in NAMES]
    columns = catalogue_columns(problem, effects)
    found = [replace(named(name, 100.0), probability=p) for name, p in probabilities.items()]
    found.append(replace(named("unknown", 0.0), probability=1.0 - sum(probabilities.values())))
    posterior = SimpleNamespace(
        best=found[0], claims=tuple(h for h in found if h.effects), dispersion=1.0 + 0.0 * problem.data,
        explanations=tuple(explain(Marginal(problem), columns[name]) for name in probabilities),
    )  # fmt: skip
    plant = SimpleNamespace(next_trial=lambda states, has_gap: None)
    campaign = SimpleNamespace(plant=plant, states=problem.campaign.states)
    # The campaign lacks nothing: the question is what is still confused.
    asked = SimpleNamespace(
        campaign=campaign, settings=problem.settings, parts=problem.parts, data=problem.data,
        nuisance=problem.nuisance, names=problem.names, prior_std=problem.prior_std,
    )  # fmt: skip
    return next_trial(asked, posterior)


def test_a_rival_that_is_out_of_the_question_asks_for_no_trial(problem):
    clear = advised(problem, {NAMES[0]: 0.87, NAMES[1]: 1e-6})
    assert clear.startswith("a repeat of ")
    assert "windage" not in clear


def test_a_likely_rival_does(problem):
    assert "windage drag" in advised(problem, {NAMES[0]: 0.6, NAMES[1]: 0.3})


def test_a_sure_cause_is_confirmed_against_its_nearest_rival(problem):
    assert advised(problem, {NAMES[0]: 0.99, NAMES[1]: 1e-6}).startswith("none is needed to identify the cause")


def test_a_campaign_of_two_duties_is_told_how_many_there_have_to_be(problem):
    states = [state for state in problem.campaign.states if state.setting.duty > 0.4]
    advice = problem.campaign.plant.next_trial(states, has_gap=True)
    assert "another duty (2 of at least 3 so far)" in advice
    assert "duty" not in (problem.campaign.plant.next_trial(problem.campaign.states, has_gap=True) or "")
