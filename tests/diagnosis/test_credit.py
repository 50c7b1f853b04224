"""An effect owes its evidence to the equations in which it acts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.inference.credit import with_credit
from sawbench.diagnosis.inference.evidence import catalogue_columns, explain
from sawbench.diagnosis.inference.linear_problem import Marginal

from tests.rigs.scattered_strokes import friction, problem_of, strokes

pytestmark = pytest.mark.unit


@pytest.fixture(scope="module")
def problem():
    return problem_of(strokes())


def dragging(state):
    return {"mechanical": -friction(state)["mechanical"]}


def cut(state):
    return {"cutting": (0.0 if state.setting.is_idle else 3.0) * np.sin(3 * state.angle_rad)}


def explained(problem, name, extra):
    marginal = Marginal(problem, extra=extra)
    plant = problem.campaign.plant
    return marginal, explain(marginal, catalogue_columns(problem, [e for e in plant.effects if e.name == name])[name])


def test_a_real_effect_keeps_its_evidence(problem):
    found = replace(problem, data=problem.data + problem.project(dragging))
    marginal, drag = explained(found, "motor_coulomb_friction", np.zeros((len(problem.data), 0)))
    assert drag.log_evidence > 20.0
    assert with_credit(found, marginal, drag).log_evidence == drag.log_evidence


def test_what_nuisances_make_of_an_effect_elsewhere_is_not_credited(problem):
    """A nuisance cancels the drag and leaves a cutting force: with it, the drag would explain a gap of the force."""
    drag, force = problem.project(dragging), problem.project(cut)
    # The drag shows far better than the force: without the effect, the nuisance cannot be used.
    force *= 0.1 * np.linalg.norm(drag) / np.linalg.norm(force)
    cancelled = (3.0 * (force - drag))[:, None]
    found = replace(problem, data=problem.data + force)
    marginal, claimed = explained(found, "motor_coulomb_friction", cancelled)
    assert claimed.log_evidence > 20.0
    assert with_credit(found, marginal, claimed).log_evidence < 1.0


def test_an_effect_without_evidence_is_left_alone(problem):
    marginal, drag = explained(problem, "motor_coulomb_friction", np.zeros((len(problem.data), 0)))
    assert drag.log_evidence <= 0.0
    assert with_credit(problem, marginal, drag) is drag


def test_sums_by_equation_hold_every_feature_once(problem):
    values = np.random.default_rng(3).standard_normal(len(problem.data))
    sums = problem.sums_by_equation(values)
    assert set(sums) == {equation for part in problem.parts for equation in part.layout.equations}
    assert sum(sums.values()) == pytest.approx(values.sum())
    drag = problem.sums_by_equation(problem.project(dragging) ** 2)
    assert drag["mechanical"] > 0.0
    assert sum(drag.values()) == pytest.approx(drag["mechanical"])
