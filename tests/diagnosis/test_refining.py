"""Forms between those of the catalogue: of strong effects they are found, and no second effect stands in for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.second_core import second_core
from sawbench.diagnosis.inference.columns import Column, catalogue_columns, columns_in
from sawbench.diagnosis.inference.form_numbers import neighbours, ranges
from sawbench.diagnosis.inference.posterior import judge
from sawbench.diagnosis.inference.refining import WeighedAlone, refined
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME, EFFECTS

from tests.rigs.scattered_strokes import problem_of, strokes

pytestmark = pytest.mark.pipeline

# Between two time constants and two dampings of the catalogue; a knee and an onset far from any.
TAU_S, DAMPING = 1.53e-3, 0.66
KNEE_A, ONSET_M_S = 0.45, 0.027
TRAVEL_M = 1.8e-4


def weighed(problem, names):
    columns = catalogue_columns(problem, [EFFECT_BY_NAME[name] for name in names])
    return columns, refined(WeighedAlone(problem, columns)).columns


@pytest.fixture(scope="module")
def lagging():
    """Strokes whose force passes a low-pass of second order between those of the catalogue."""
    natural_hz = 2.0 * DAMPING / TAU_S / (2.0 * np.pi)
    return problem_of(strokes(ring=(natural_hz, DAMPING)))


def test_time_constant_and_damping_between_those_of_the_catalogue_are_found(lagging):
    columns, better = weighed(lagging, ["force_sensor_lag"])
    known = {(c.shape["tau_s"], c.shape["damping"]) for c in columns["force_sensor_lag"]}
    assert min(abs(tau - TAU_S) for tau, _ in known) > 0.07 * TAU_S
    (added,) = better["force_sensor_lag"][len(columns["force_sensor_lag"]) :]
    assert added.shape["tau_s"] == pytest.approx(TAU_S, rel=0.03)
    assert added.shape["damping"] == pytest.approx(DAMPING, rel=0.03)


def test_forms_are_found_beside_the_other_effect():
    """Alone, the knee also stands for what the edge does to the current, and is off by more than a hundredth.

    The noise of one campaign moves the onset by most of a hundredth, so it is the mean of several that is compared.
    """
    knees, onsets = [], []
    for seed in range(21, 29):
        problem = problem_of(
            strokes(
                seed=seed,
                lost_voltage=lambda i, w: 0.9 * np.tanh(i / KNEE_A),
                cut=lambda speed, travelled, force: 240.0 * speed + 40.0 * np.tanh(speed / ONSET_M_S),
            )
        )
        _, better = weighed(problem, ["brush_voltage_drop", "edge_force", "cutting_speed_exponent"])
        found = [column.shape["knee_a"] for column in better["brush_voltage_drop"]]
        knees.append(min(found, key=lambda knee: abs(knee - KNEE_A)))
        found = [column.shape.get("onset_m_s", 0.0) for column in better["edge_force"]]
        onsets.append(min(found, key=lambda onset: abs(onset - ONSET_M_S)))
    assert abs(np.mean(knees) - KNEE_A) < 0.005 * KNEE_A
    assert abs(np.mean(onsets) - ONSET_M_S) < 0.005 * ONSET_M_S
    # Each by itself far closer than the forms of the catalogue are to each other.
    assert max(abs(onset - ONSET_M_S) for onset in onsets) < 0.02 * ONSET_M_S


def test_an_edge_that_ploughs_over_some_travel_is_found_with_its_travel():
    """It ends where the blade stops, which no onset over a speed does."""
    problem = problem_of(
        strokes(cut=lambda speed, travelled, force: 240.0 * speed + 40.0 * (1.0 - np.exp(-travelled / TRAVEL_M)))
    )
    _, better = weighed(problem, ["edge_force", "cutting_speed_exponent", "engagement_delay", "blade_compliance"])
    found = judge(problem, better).best
    assert found.effects == ("edge_force",)
    assert found.members[0].column.shape["onset_m"] == pytest.approx(TRAVEL_M, rel=0.03)


def test_rubbing_that_is_in_part_dry_is_found_with_its_part():
    """The two are 20 N s/m, of which two fifths are dry: that many N at half a metre a second."""
    problem = problem_of(strokes(rub=lambda speed: 12.0 * speed + 8.0 * 0.5 * np.tanh(speed / 0.03)))
    _, better = weighed(problem, ["return_stroke_rubbing", "force_offset_drift", "blade_compliance"])
    found = judge(problem, better).best
    assert found.effects == ("return_stroke_rubbing",)
    assert found.members[0].column.shape["dry"] == pytest.approx(0.4, abs=0.02)


def test_rubbing_that_sets_in_as_the_blade_gains_speed_leaves_no_gap():
    """14 N in full beyond a few tenths of a metre a second, by another law than that of the catalogue."""
    problem = problem_of(strokes(rub=lambda speed: 14.0 * (1.0 - np.exp(-speed / 0.12))))
    _, better = weighed(problem, ["return_stroke_rubbing", "force_offset_drift", "blade_compliance"])
    found = judge(problem, better)
    assert found.best.effects == ("return_stroke_rubbing",)
    gap, left = found.of("no_gap").left_over - problem.quiet, found.best.left_over - problem.quiet
    assert left < SETTINGS.ladder.left_by_the_right * gap


def test_rubbing_that_is_harder_at_the_start_of_the_way_back_is_found_with_its_ratio():
    """A blade that is thicker at its root: 16 N where the way back begins, 8 N where it ends."""
    problem = problem_of(strokes())
    baseline = problem.campaign.baseline

    def rubbing(state):
        speed = np.maximum(-baseline.cutting_sign * baseline.blade_velocity(state), 0.0)
        to_go = 0.5 * baseline.travelled(state) / baseline.radius_m
        return {"cutting": -(8.0 + 8.0 * to_go) * np.tanh(speed / 0.03) * (not state.setting.is_idle)}

    problem = replace(problem, data=problem.data + problem.project(rubbing))
    _, better = weighed(problem, ["return_stroke_rubbing", "force_offset_drift", "blade_compliance"])
    found = judge(problem, better).best
    assert found.effects == ("return_stroke_rubbing",)
    assert found.members[0].column.shape["end_over_start"] == pytest.approx(0.5, rel=0.1)


def test_a_form_refined_to_the_edge_of_its_range_can_be_refined_again(lagging):
    """It is the last of the catalogue but for rounding: no range between the two is divided by."""
    (column,) = columns_in(lagging, EFFECT_BY_NAME["edge_force"], [{"by_stock": 0.0, "onset_m_s": 0.12 * (1 + 2e-16)}])
    low, high = neighbours(column)["onset_m_s"]
    assert high > 1.5 * low


def test_no_late_clock_makes_up_for_what_a_coarse_catalogue_leaves_of_a_lag(lagging):
    columns, better = weighed(lagging, ["force_sensor_lag", "clock_offset", "carriage_resonance"])
    assert judge(lagging, better).best.effects == ("force_sensor_lag",)
    for found in (columns, better):
        judged = judge(lagging, found)
        assert judged.of("force_sensor_lag").probability > 0.9
        assert sum(h.probability for h in judged.hypotheses if "clock_offset" in h.effects) < 0.001


def test_the_second_core_finds_the_same_forms(lagging):
    """What comes back from it is pickled: an effect cannot be, and would be worked out again."""
    names = ["force_sensor_lag", "clock_offset", "carriage_resonance"]
    _, alone = weighed(lagging, names)
    with second_core():
        _, shared = weighed(lagging, names)
    assert {n: [c.shape for c in found] for n, found in shared.items()} == {
        n: [c.shape for c in found] for n, found in alone.items()
    }


def test_what_hardly_shows_keeps_the_forms_of_the_catalogue(lagging):
    rng = np.random.default_rng(3)
    quiet = replace(lagging, data=rng.standard_normal(len(lagging.data)))
    columns, better = weighed(quiet, ["force_sensor_lag", "clock_offset", "brush_voltage_drop"])
    assert {name: len(found) for name, found in better.items()} == {n: len(found) for n, found in columns.items()}


def test_a_choice_is_not_taken_for_a_number(lagging):
    """A device, a law, a choice of motion: only what the effect calls continuous is moved."""
    _, better = weighed(lagging, ["clock_offset", "blade_compliance"])
    for name, found in better.items():
        effect = EFFECT_BY_NAME[name]
        fixed = [key for key in effect.shapes[0] if key not in effect.continuous]
        known = {tuple(shape[key] for key in fixed) for shape in effect.shapes}
        assert {tuple(column.shape[key] for key in fixed) for column in found} <= known


def test_numbers_that_are_climbed_are_above_zero():
    """As seen: a number of a form that is below 0 has no logarithm, and the diagnosis ended in an error."""
    below = 0
    for effect in EFFECTS:
        for shape in effect.shapes:
            form = Column(effect=effect, shape=shape, columns=np.ones((1, 1)))
            below += any(shape.get(name, 0.0) < 0.0 for name in effect.continuous)
            for least, most in (*ranges(form).values(), *neighbours(form).values()):
                assert 0.0 < least < most
    assert below, "no form has such a number: the test says nothing"
