"""A little of an effect that has one of some forms: one standard deviation of a form is ordinary, whichever it is."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.diagnosis.inference.columns import Column
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.one_form import lacking_of_forms_that_show
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.effect import BACKGROUND_SHARE

N, SHARE = 400, 0.05


def alone(data):
    """Inner products with nothing integrated out."""
    return Marginal(SimpleNamespace(nuisance=np.zeros((N, 0)), data=data, settings=SETTINGS))


def forms(*waves, is_at_one_place=True):
    effect = SimpleNamespace(is_at_one_place=is_at_one_place, background_share=BACKGROUND_SHARE)
    return [Column(effect=effect, shape={}, columns=wave) for wave in waves]


def any_form(entries):
    """The mean covariance of a little of any form, as columns."""
    return SHARE / np.sqrt(len(entries)) * np.hstack([entry.columns for entry in entries])


def cost(wave, little):
    """Square of a wave over the covariance of the background and of noise of variance 1."""
    return float(wave @ np.linalg.solve(np.eye(N) + little @ little.T, wave))


def found(entries, *beside):
    little = any_form(entries)
    lacking = lacking_of_forms_that_show({"resonance": little}, {"resonance": entries}, np.ones(N), beside)
    return np.hstack([little, *lacking.values()])


@pytest.fixture
def unlike():
    """Forty forms that have nothing in common, each far above the noise."""
    return forms(*(2000.0 * np.eye(N)[:, [k]] for k in range(40)))


def test_one_standard_deviation_of_the_form_that_shows_costs_no_more_than_one(unlike):
    seen = SHARE * unlike[7].columns[:, 0]
    assert cost(seen, any_form(unlike)) == pytest.approx(40.0, rel=0.05)
    little = found(unlike, [alone(seen)])
    assert cost(seen, little) == pytest.approx(1.0, rel=0.05)
    other = SHARE * unlike[8].columns[:, 0]
    assert cost(other, little) == pytest.approx(40.0, rel=0.05), "one form, not all of them"


def test_forms_are_looked_for_beside_each_that_is_given(unlike):
    first, second = (SHARE * unlike[k].columns[:, 0] for k in (3, 21))
    little = found(unlike, [alone(first)], [alone(second)])
    assert max(cost(first, little), cost(second, little)) < 1.1


def test_forms_are_looked_for_beside_what_another_explains(unlike):
    first, second = (SHARE * unlike[k].columns[:, 0] for k in (3, 21))
    nominal = alone(1.2 * first + second)
    assert cost(second, found(unlike, [nominal])) == pytest.approx(40.0, rel=0.05)
    little = found(unlike, [nominal, nominal.beside(1e3 * unlike[3].columns)])
    assert max(cost(first, little), cost(second, little)) < 1.1


def test_a_form_as_large_as_a_cause_is_no_background(unlike):
    """As seen: a carriage that rings in full beside a law of cutting was an unknown cause."""
    seen = 20.0 * SHARE * unlike[7].columns[:, 0]
    assert np.array_equal(found(unlike, [alone(seen)]), any_form(unlike))


def test_forms_that_are_alike_add_nothing():
    wave = np.random.default_rng(4).standard_normal((N, 1))
    alike = forms(*(size * 1e3 * wave for size in (0.99, 1.0, 1.01)))
    little = found(alike, [alone(SHARE * alike[1].columns[:, 0])])
    assert np.linalg.norm(little) ** 2 == pytest.approx(np.linalg.norm(any_form(alike)) ** 2, rel=0.02)


def test_an_effect_whose_forms_are_no_places_keeps_the_background_of_any_form():
    rng = np.random.default_rng(5)
    entries = forms(*(1e3 * rng.standard_normal((N, 1)) for _ in range(5)), is_at_one_place=False)
    seen = SHARE * entries[0].columns[:, 0]
    assert np.array_equal(found(entries, [alone(seen)]), any_form(entries))
