"""A further effect beside known ones pays for what their forms miss where both act."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.diagnosis.inference.beside_known import BesideKnown
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.linear_problem import FORM_OF_KNOWN

from tests.rigs.two_equations import N_BLOCKS, N_CUTTING, N_ELECTRICAL, noise, problem_of

pytestmark = pytest.mark.unit

# Of the known effect, in standard deviations of each feature of the cutting equation.
STRENGTH = 3.0


def in_equations(cutting, electrical):
    rows = [np.full((N_BLOCKS, N_CUTTING), cutting), np.full((N_BLOCKS, N_ELECTRICAL), electrical)]
    return np.hstack(rows).ravel()


@pytest.fixture
def beside():
    problem = problem_of(noise(1, N_CUTTING, 1.0), noise(2, N_ELECTRICAL, 1.0))
    known = in_equations(STRENGTH, 0.0)
    # The known effect's own nuisances take up what its form misses: they must not take up the effect itself.
    problem = replace(
        problem, known=known, nuisance=known[:, None], names=(f"{FORM_OF_KNOWN}edge_force 0",), prior_std=np.ones(1)
    )
    return BesideKnown(problem, np.ones(len(known)), np.zeros((len(known), 0)))


def further(cutting, electrical, log_evidence, *, of_strokes=0.0):
    member = SimpleNamespace(contribution=in_equations(cutting, electrical))
    return Hypothesis(effects=("x",), members=(member,), log_evidence=log_evidence, of_strokes=of_strokes)


def test_a_further_effect_pays_where_the_known_one_acts(beside):
    # The log evidence of the known effect is half its energy, and its standard deviation the root of that.
    price = np.sqrt(0.5 * STRENGTH**2 * N_BLOCKS * N_CUTTING)
    assert 200.0 - beside.paid(further(1.0, 0.0, 200.0)).log_evidence == pytest.approx(price, rel=0.05)
    assert beside.paid(further(0.0, 1.0, 200.0)).log_evidence == pytest.approx(200.0)


def test_no_more_is_paid_than_there_is(beside):
    assert beside.paid(further(1.0, 0.0, 5.0)).log_evidence == 0.0
    assert beside.paid(further(1.0, 0.0, -5.0)).log_evidence == -5.0
    assert beside.paid(Hypothesis(other="unknown", log_evidence=5.0)).log_evidence == 0.0
    assert beside.paid(Hypothesis(other="no_gap", log_evidence=0.0)).log_evidence == 0.0


def test_what_single_strokes_add_pays_nothing(beside):
    assert beside.paid(further(1.0, 0.0, 30.0, of_strokes=30.0)).log_evidence == 30.0
    assert beside.paid(further(1.0, 0.0, 30.0, of_strokes=25.0)).log_evidence == 25.0


def test_the_gap_is_that_of_the_model_without_its_effects(beside):
    share = N_CUTTING / (N_CUTTING + N_ELECTRICAL)
    assert beside.gap == pytest.approx(1.0 + share * STRENGTH**2, rel=0.1)
