"""Effects as a sensor shows them that is late or rings itself: found beside it, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.inference.columns import catalogue_columns, forms_beside
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.evidence import explain
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import judge
from sawbench.diagnosis.inference.refining import WeighedAlone, refined

from tests.rigs.jigsaw_in_time import K_CUT, RADIUS
from tests.rigs.scattered_strokes import problem_of, strokes

pytestmark = pytest.mark.pipeline

DELAY_S, LAW = 2.3e-3, 0.7
LATE, EXPONENT = "clock_offset", "cutting_speed_exponent"


def late(state):
    """The same strokes with a force that comes late: each unit is periodic in time."""
    n_points = state.angle_rad.shape[1]
    step_s = 2.0 * np.pi / n_points / state.speed_rad_s
    end_s = np.cumsum(step_s, axis=1)
    force = [
        np.interp(end - 0.5 * step - DELAY_S, end - 0.5 * step, wave, period=end[-1])
        for end, step, wave in zip(end_s, step_s, state.force_n, strict=True)
    ]
    return replace(state, force_n=np.array(force))


@pytest.fixture(scope="module")
def problem():
    """Wood whose force grows less than the speed does, read late."""
    return problem_of([late(state) for state in strokes(cut=lambda speed, travelled, force: 170.0 * speed**LAW)])


@pytest.fixture(scope="module")
def columns(problem):
    return effect_columns(problem)


def test_a_law_of_cutting_is_found_beside_a_late_force(problem, columns):
    best = judge(problem, columns).best
    assert best.effects == (LATE, EXPONENT)
    _, exponent = best.members
    assert exponent.strength == pytest.approx(LAW, abs=0.1)
    distortion = exponent.column.distortion
    assert distortion.effect.name == LATE
    assert distortion.shape["tau_s"] == pytest.approx(DELAY_S, rel=0.05)


def test_the_sum_of_two_signatures_leaves_more(problem, columns):
    alone = Marginal(problem)

    def by_both(entries):
        """Least that a late force and a law of cutting leave together, each in any form, and most log evidence."""
        found = []
        for form in forms_beside(entries[LATE]):
            beside = alone.beside(form.of_any_size)
            law = explain(beside, forms_beside(entries[EXPONENT], (LATE,)))
            found.append((beside.beside(law.column.of_any_size).misfit, beside.log_evidence + law.log_evidence))
        left, log_evidence = zip(*found, strict=True)
        return min(left), max(log_evidence)

    plain = refined(WeighedAlone(problem, catalogue_columns(problem, problem.campaign.plant.effects))).columns
    (left, log_evidence), (left_by_sum, of_sum) = by_both(columns), by_both(plain)
    assert left < 0.5 * left_by_sum
    assert log_evidence > of_sum + 10.0


def test_a_distorted_form_is_there_beside_the_effect_that_distorts_alone(columns):
    distorted = [c for entries in columns.values() for c in entries if c.distortion is not None]
    assert distorted
    for column in distorted:
        entries = columns[column.effect.name]
        assert any(column is one for one in forms_beside(entries, (column.distortion.effect.name,)))
        assert not any(column is one for one in forms_beside(entries))


def test_strokes_that_two_effects_explain_get_no_distorted_form():
    plain = problem_of([late(state) for state in strokes()])
    assert not any(c.distortion for entries in effect_columns(plain).values() for c in entries)


def test_late_teeth_behind_a_load_cell_that_lags_are_found_together():
    """As it is, a later engagement with a long ramp stands for both."""
    fraction, tau_s, damping = 0.32, 0.7e-3, 0.66

    def cut(speed, travelled, force):
        return K_CUT * speed * np.clip((travelled / (2.0 * RADIUS) - fraction) / 0.03 + 0.5, 0.0, 1.0)

    natural_hz = 2.0 * damping / tau_s / (2.0 * np.pi)
    problem = problem_of(strokes(cut=cut, ring=(natural_hz, damping)))
    columns = effect_columns(problem)
    found = judge(problem, columns)
    as_they_are = judge(problem, {name: forms_beside(entries) for name, entries in columns.items()})
    assert found.dispersion.max() < 0.1 * as_they_are.dispersion.max()
    assert found.best.effects == ("engagement_delay", "force_sensor_lag")
    late, lag = found.best.members
    assert late.column.distortion.effect.name == "force_sensor_lag"
    assert late.strength == pytest.approx(fraction, abs=0.002)
    assert lag.column.shape["tau_s"] == pytest.approx(tau_s, rel=0.05)
    assert lag.column.shape["damping"] == pytest.approx(damping, rel=0.05)


@pytest.mark.parametrize("law", [0.64, 0.5])
def test_a_law_of_cutting_is_found_behind_a_carriage_that_rings(law):
    """As the carriage shows them, teeth or a force without speed, each with what its form may miss, explain as much."""
    ringing = strokes(cut=lambda speed, travelled, force: 170.0 * speed**law, ring=(130.0, 0.036))
    problem = problem_of(ringing)
    best = judge(problem, effect_columns(problem)).best
    assert best.effects == ("carriage_resonance", EXPONENT)
    carriage, exponent = best.members
    assert exponent.column.distortion.effect.name == "carriage_resonance"
    assert carriage.strength == pytest.approx(130.0, rel=0.01)
    assert exponent.strength == pytest.approx(law, abs=0.1)
