"""The smallest magnitude of an effect that a campaign shows."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.diagnosis.answer.detection_limits import detection_limits
from sawbench.diagnosis.inference.columns import Column
from sawbench.diagnosis.inference.evidence import explain
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME

pytestmark = pytest.mark.unit

LEAST = 12.0
WAVE = np.random.default_rng(1).standard_normal(400)
# Of a machine without a gap, whose noise is as stated.
NO_GAP = SimpleNamespace(best=Hypothesis(other="no_gap", log_evidence=0.0), little={}, dispersion=np.ones(len(WAVE)))


def problem_of(data=0.0 * WAVE, nuisance=None, quiet=0.0):
    columns = np.zeros((len(WAVE), 0)) if nuisance is None else nuisance[:, None]
    return LinearProblem(
        campaign=None, parts=(), data=data, known=0.0 * data, nuisance=columns,
        names=("n",) * columns.shape[1], prior_std=10.0 * np.ones(columns.shape[1]),
        quiet=quiet,
    )  # fmt: skip


def columns_of(name, per_form):
    """One column for each form: `per_form` says how large it is, of the form's shape."""
    effect = EFFECT_BY_NAME[name]
    return [
        Column(effect=effect, shape=shape, columns=per_form(shape) * WAVE[:, None])
        for shape in effect.shapes
        if "frequency_hz" not in shape or shape is effect.shapes[0]
    ]


def limit_of(name, per_form, **problem):
    return detection_limits(problem_of(**problem), {name: columns_of(name, per_form)}, NO_GAP, LEAST)[name]


def test_an_effect_of_the_stated_magnitude_has_the_log_odds_of_the_limit():
    limit = limit_of("edge_force", lambda _: 0.4)
    amplitude = limit.change / EFFECT_BY_NAME["edge_force"].strength.typical
    shown = problem_of(0.4 * amplitude * WAVE)
    assert (limit.name, limit.unit, limit.without) == ("force_n", "N", 0.0)
    assert 0.5 * explain(Marginal(shown), columns_of("edge_force", lambda _: 0.4)).gain == pytest.approx(LEAST)


def test_a_nuisance_of_the_same_wave_raises_the_limit():
    assert (
        limit_of("edge_force", lambda _: 3.0, nuisance=WAVE).change > 5.0 * limit_of("edge_force", lambda _: 3.0).change
    )


def test_what_every_machine_has_as_much_of_does_not_show_however_quiet_the_bench_is():
    """Three standard deviations of a twentieth of the typical magnitude."""
    typical = EFFECT_BY_NAME["edge_force"].strength.typical
    assert limit_of("edge_force", lambda _: 1e4).change == pytest.approx(3.0 / 20.0 * typical)


@pytest.mark.parametrize(("per_unit", "share"), [(1.0, 1.0 / 3.0), (2.0, 0.2)])
def test_what_is_of_background_size_shows_from_where_it_leaves_a_gap(per_unit, share):
    """The mean square over the features that an effect adds is that of an intact machine: a gap."""
    quiet = (0.2 * 2.0) ** 2 * float(WAVE @ WAVE) / len(WAVE)
    limit = limit_of("edge_force", lambda _: per_unit, quiet=quiet)
    assert limit.change == pytest.approx(share * EFFECT_BY_NAME["edge_force"].strength.typical)


def test_of_a_delay_the_smallest_that_shows_is_stated():
    """Each form has its own delay: the wave grows with it, 1 to a millisecond."""
    limit = limit_of("clock_offset", lambda shape: 1e3 * abs(shape["tau_s"]))
    norm = np.sqrt(WAVE @ WAVE)
    assert limit.change == pytest.approx(np.sqrt(2.0 * LEAST) / norm / 1e3, rel=0.01)


def test_a_stiffness_shows_where_it_is_low_enough():
    quiet, noisy = (limit_of("blade_compliance", lambda s, f=f: f / s["stiffness_n_per_m"]) for f in (1e5, 5e4))
    assert quiet.without is None
    assert quiet.change == pytest.approx(2.0 * noisy.change)


def test_an_exponent_is_stated_by_its_distance_from_that_of_a_straight_line():
    assert limit_of("cutting_speed_exponent", lambda _: 0.3).without == 1.0


def test_a_frequency_has_no_smallest_one_and_a_hidden_effect_no_magnitude():
    assert limit_of("carriage_resonance", lambda _: 3.0).name == ""
    assert limit_of("edge_force", lambda _: 1e-3).name == ""
    hidden = detection_limits(problem_of(), {"edge_force": []}, NO_GAP, LEAST)["edge_force"]
    assert (hidden.log_odds, hidden.name) == (0.0, "")
