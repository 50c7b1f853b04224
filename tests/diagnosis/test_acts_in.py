"""In which equations an effect acts."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.diagnosis.inference.acts_in import acts_in
from sawbench.diagnosis.inference.columns import catalogue_columns
from sawbench.diagnosis.inference.evidence import explain
from sawbench.diagnosis.inference.marginal import Marginal

from tests.rigs.scattered_strokes import friction, problem_of, strokes

pytestmark = pytest.mark.unit


@pytest.fixture(scope="module")
def problem():
    return problem_of(strokes())


def dragging(state):
    return {"mechanical": -friction(state)["mechanical"]}


def test_an_effect_acts_where_its_contribution_is(problem):
    plant = problem.campaign.plant
    drag = [e for e in plant.effects if e.name == "motor_coulomb_friction"]
    found = explain(Marginal(problem), catalogue_columns(problem, drag)["motor_coulomb_friction"])
    assert acts_in(problem, found) == ["mechanical"]


def test_sums_by_equation_hold_every_feature_once(problem):
    values = np.random.default_rng(3).standard_normal(len(problem.data))
    sums = problem.sums_by_equation(values)
    assert set(sums) == {equation for part in problem.parts for equation in part.layout.equations}
    assert sum(sums.values()) == pytest.approx(values.sum())
    drag = problem.sums_by_equation(problem.project(dragging) ** 2)
    assert drag["mechanical"] > 0.0
    assert sum(drag.values()) == pytest.approx(drag["mechanical"])
