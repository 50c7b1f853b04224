"""A number that belongs to the form of an effect is stated as that of the whole form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.inference.columns import columns_in
from sawbench.diagnosis.inference.evidence import explain
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.size import as_a_whole, number_of_form
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME

from tests.rigs.scattered_strokes import problem_of, strokes

pytestmark = pytest.mark.pipeline

LAG = {"tau_s": 1e-3, "damping": 0.0}
SPRING = {"stiffness_n_per_m": 1e5, "unloads": 0.0}
EXPONENT = {"exponent": 0.5}


@pytest.fixture(scope="module")
def problem():
    return problem_of(strokes())


def found_in(problem, name, shape, *, amplitude=1.0, of_form=None):
    """The effect in a form of the data, as the nearest forms of the catalogue explain it."""
    effect = EFFECT_BY_NAME[name]
    whole = columns_in(problem, effect, [shape])[0].columns[:, 0]
    shown = replace(problem, data=problem.data + amplitude * whole)
    like_it = [s for s in effect.shapes if set(s) == set(shape)] if of_form is None else [of_form]
    found = explain(Marginal(shown), columns_in(shown, effect, like_it))
    return found, as_a_whole(shown, found, beside=(), dispersion=1.0)


@pytest.mark.parametrize(
    ("name", "shape", "number"),
    [
        ("force_sensor_lag", LAG | {"tau_s": 1.13e-3}, 1.13e-3),
        ("blade_compliance", SPRING | {"stiffness_n_per_m": 8.3e4}, 8.3e4),
        ("cutting_speed_exponent", EXPONENT | {"exponent": 0.43}, 0.43),
    ],
)
def test_between_two_forms_of_the_catalogue_the_number_is_that_of_the_whole_form(problem, name, shape, number):
    rough, found = found_in(problem, name, shape)
    assert rough.column.shape != shape
    assert found.strength == pytest.approx(number, rel=0.02)
    assert abs(found.strength - number) < 1.96 * found.strength_std


def test_where_shape_and_amplitude_disagree_the_number_lies_between_and_is_uncertain_by_that(problem):
    rough, found = found_in(problem, "force_sensor_lag", LAG, amplitude=1.3, of_form=LAG)
    assert rough.strength == pytest.approx(1.3e-3, rel=0.05)
    assert 1e-3 <= found.strength <= rough.strength
    assert found.strength_std >= 0.5 * (rough.strength - 1e-3)


def test_the_whole_form_is_the_whole_effect(problem):
    _, found = found_in(problem, "blade_compliance", SPRING | {"stiffness_n_per_m": 8.3e4})
    assert found.amplitude == 1.0
    assert np.array_equal(found.contribution, found.column.columns[:, 0])


@pytest.mark.parametrize("name", ["engagement_delay", "edge_force", "carriage_resonance"])
def test_a_number_that_amplitude_says_all_or_nothing_of_stays_as_it_was(problem, name):
    effect = EFFECT_BY_NAME[name]
    found = explain(Marginal(problem), columns_in(problem, effect, effect.shapes[:1]))
    assert number_of_form(found.column) is None
    assert as_a_whole(problem, found, beside=(), dispersion=1.0) is found
