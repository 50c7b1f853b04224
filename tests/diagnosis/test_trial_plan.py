"""Planned trials: they differ where the causes differ, what nobody can tell apart is said, and the algebra is right."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.bench.config import parse_config
from sawbench.bench.errors import InputError
from sawbench.diagnosis.answer.candidate_trials import candidates
from sawbench.diagnosis.answer.gap_report import diagnose
from sawbench.diagnosis.answer.trial_plan import Products, expected_probability, plan_report, trial_plan
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.columns import columns_in
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.operating_point import OperatingPoint, periodic_stroke
from sawbench.modeling.state import TWO_PI

from tests.rigs.drawn_states import BASELINE, history, setting_of

pytestmark = pytest.mark.unit

N_UNITS, K_CUT = 12, 240.0
FRICTION, DRAG = "motor_coulomb_friction", "windage_drag"


def stroke(number, duty, is_idle, feed_m_s):
    """Twelve units of the nominal stroke at an operating point, with the scatter of sensors."""
    rng = np.random.default_rng(number)
    found = periodic_stroke(BASELINE, OperatingPoint(k_fc_n_s_per_m=0.0 if is_idle else K_CUT, duty=duty)).state
    shape = (N_UNITS, found.angle_rad.shape[1])
    noise = {"current_a": 0.02, "force_n": 0.5, "battery_voltage_v": 0.005, "battery_current_a": 0.02}
    waves = {name: getattr(found, name) + std * rng.standard_normal(shape) for name, std in noise.items()}
    steady = (
        "angle_rad",
        "speed_rad_s",
        "acceleration_rad_s2",
        "current_rate_a_s",
        "force_rate_n_s",
        "motor_voltage_v",
    )
    waves |= {name: np.broadcast_to(getattr(found, name), shape) for name in steady}
    column = np.ones((N_UNITS, 1))
    setting = setting_of(
        is_idle, label=f"t{number}", index=number, duty=duty, feed_m_s=feed_m_s, session_s=120.0 * number,
        stock="air" if is_idle else "oak, 20 mm", operating_point=f"{duty} {is_idle} {feed_m_s}",
    )  # fmt: skip
    return replace(
        found, setting=setting, time_s=10.0 * (np.arange(N_UNITS)[:, None] + 1.0) / N_UNITS, cut_distance_m=column,
        charge_used_as=50.0 * column, n_strokes=np.full(N_UNITS, 10.0),
        **history(N_UNITS, 0.0 if is_idle else K_CUT), **waves,
    )  # fmt: skip


def problem_of(points):
    states = tuple(stroke(number, *point) for number, point in enumerate(points))
    campaign = Campaign(plant=Jigsaw(baseline=BASELINE), states=states, k_guess_n_s_per_m={}, warnings=())
    return build_problem(campaign)


def answer(problem, name, probability, effect=None, shape=None):
    """A hypothesis that an effect acts at its typical size, in its first form unless one is given."""
    effect = effect or EFFECT_BY_NAME[name]
    (column,) = columns_in(problem, effect, [shape or effect.shapes[0]])
    member = Explanation(
        effect=effect, log_evidence=0.0, column=column, amplitude=1.0, amplitude_std=0.1, gain=10.0,
        contribution=column.columns[:, 0],
    )  # fmt: skip
    return Hypothesis(effects=(effect.name,), members=(member,), log_evidence=0.0, probability=probability)


def posterior_of(problem, *hypotheses):
    return SimpleNamespace(hypotheses=hypotheses, dispersion=np.ones(len(problem.data)))


MATERIALS = {f"t{number}": "oak" for number in range(9)}
# One duty for every cut; another duty was used in air only.
ONE_SPEED = ((0.4375, False, 0.004), (0.4375, False, 0.004), (0.4375, False, 0.002), (0.6, True, np.nan))


@pytest.fixture(scope="module")
def problem():
    return problem_of(ONE_SPEED)


@pytest.fixture(scope="module")
def confused(problem):
    """Dry friction and windage, none of them certain."""
    return posterior_of(problem, answer(problem, FRICTION, 0.6), answer(problem, DRAG, 0.4))


def test_candidates_are_what_the_bench_has_used_and_new_combinations_of_it(problem):
    found = candidates(problem, MATERIALS)
    points = {(c.material, c.duty, c.feed_mm_s, c.is_new) for c in found}
    cuts = {("oak", duty, feed, duty == 0.6) for duty in (0.4375, 0.6) for feed in (2.0, 4.0)}
    assert points == cuts | {("none", 0.6, None, False), ("none", 0.4375, None, True)}
    assert {(c.seconds, c.rest_s) for c in found} == {(10.0, 0.0), (30.0, 0.0), (10.0, 900.0)}
    assert {c.thickness_mm for c in found if c.material == "oak"} == {20.0}


def test_a_stroke_at_another_duty_is_that_of_the_model(problem):
    found = next(c for c in candidates(problem, MATERIALS) if c.duty == 0.6 and c.material == "oak")
    expected = periodic_stroke(BASELINE, OperatingPoint(k_fc_n_s_per_m=K_CUT, duty=0.6, charge_used_as=50.0)).state
    state = found.parts[0].state
    assert float(state.speed_rad_s.mean()) == pytest.approx(float(expected.speed_rad_s.mean()), rel=1e-3)
    assert np.abs(state.current_a[0] - expected.current_a[0]).max() < 0.05


def test_what_wears_and_empties_goes_on_and_what_is_warm_cools_in_a_rest(problem):
    usual, longer, rested = candidates(problem, MATERIALS)[:3]
    states = {name: c.parts[0].state for name, c in (("usual", usual), ("longer", longer), ("rested", rested))}
    turns_s = float(states["usual"].speed_rad_s.mean()) / TWO_PI
    assert states["longer"].cut_distance_m[-1, 0] == pytest.approx(1.0 + 0.02 * turns_s * 30.0 * 7 / 8, rel=0.01)
    assert np.all(np.diff(states["longer"].charge_used_as[:, 0]) > 0.0)
    for memory, track in states["usual"].slow.items():
        # The memories of the rig begin warm; after a rest nearly all has gone, for those that forget within it.
        if memory.drive == "motor_current_squared_a2" and memory.time_constant_s < 300.0:
            assert states["rested"].slow[memory][0, 0] < track[0, 0]


def test_causes_that_differ_with_speed_are_told_apart_by_another_speed(problem, confused):
    """Dry friction does not grow with speed, windage does; a cut at the same duty cannot tell."""
    plan = trial_plan(problem, confused, 2, MATERIALS)
    assert len(plan.chosen) == 2
    first = plan.chosen[0]
    assert set(first.between) == {FRICTION, DRAG}
    assert (first.trial.material, first.trial.duty) != ("oak", 0.4375)
    assert plan.inseparable == ()
    steps = [plan.expected_probability, *(one.expected_probability for one in plan.chosen)]
    assert steps[0] == pytest.approx(0.6**2 + 0.4**2)
    assert steps[0] < steps[1] < steps[2] <= 1.0


def test_every_trial_of_a_plan_is_worth_it(problem, confused):
    settings = problem.settings
    demanding = replace(problem, settings=replace(settings, report=replace(settings.report, worth=3.0)))
    plan = trial_plan(demanding, confused, 12, MATERIALS)
    assert 0 < len(plan.chosen) < 12
    assert min(one.log_odds for one in plan.chosen) >= 3.0


def test_a_form_between_those_of_the_catalogue_is_planned_with(problem):
    between = {"power": 1.83}
    assert between not in EFFECT_BY_NAME[DRAG].shapes
    refined = posterior_of(problem, answer(problem, FRICTION, 0.6), answer(problem, DRAG, 0.4, shape=between))
    plan = trial_plan(problem, refined, 1, MATERIALS)
    assert set(plan.chosen[0].between) == {FRICTION, DRAG}
    assert (plan.chosen[0].trial.material, plan.chosen[0].trial.duty) != ("oak", 0.4375)


def test_one_term_under_two_names_is_told_apart_by_no_trial(problem):
    twin = replace(EFFECT_BY_NAME[FRICTION], name="twin_friction")
    both = posterior_of(problem, answer(problem, FRICTION, 0.5), answer(problem, "", 0.5, effect=twin))
    trials = [SimpleNamespace(trial_id=name, material="oak", blade="B1", battery="P1") for name in MATERIALS]
    report = plan_report(problem, both, 3, trials)
    assert report["trials"] == []
    (pair,) = report["inseparable"]
    assert set(pair["causes"]) == {FRICTION, "twin_friction"}
    assert pair["log_odds"] == pytest.approx(0.0, abs=0.2)
    assert "no single trial adds log odds of 1" in report["reason"]


def test_planned_trials_have_names_of_their_own_and_the_last_blade_and_battery(problem, confused):
    trials = [SimpleNamespace(trial_id=f"t{n}", material="oak", blade=f"B{n}", battery="P2") for n in range(4)]
    rows = plan_report(problem, confused, 2, trials)["trials"]
    assert [(row["id"], row["blade"], row["battery"]) for row in rows] == [
        ("next-05", "B3", "P2"),
        ("next-06", "B3", "P2"),
    ]
    assert all(row["minutes"] == pytest.approx((row["seconds"] + row["rest_s"] + 60.0) / 60.0) for row in rows)


def test_expected_log_odds_are_those_of_the_full_covariance():
    """Right: one column; wrong: two forms of two columns, and what they miss; nuisances in a full covariance matrix."""
    rng = np.random.default_rng(3)
    nuisance, truth, missed, one, other = (rng.standard_normal((40, q)) for q in (5, 1, 3, 2, 2))
    stacked = np.hstack([nuisance, truth, missed, one, other])
    nothing, forms = np.zeros(0, dtype=int), [np.array([4, 5]), np.array([6, 7])]
    products = Products(
        gram=stacked.T @ stacked, n_nuisances=5, truths=[0, None], missed=[nothing, np.array([1, 2, 3])],
        alternatives=[[np.array([0])], forms],
    )  # fmt: skip
    common = np.eye(40) + nuisance @ nuisance.T + missed @ missed.T
    covariances = [common + wrong @ wrong.T for wrong in (one, other)]
    expected = min(0.5 * float(truth[:, 0] @ np.linalg.solve(c, truth[:, 0])) for c in covariances)
    found = products.log_odds()
    assert found[0, 1] == pytest.approx(expected)
    assert found[1, 0] == found[0, 0] == found[1, 1] == 0.0


def test_a_certain_answer_stays_so_and_even_odds_become_what_the_log_odds_say():
    nothing = np.zeros((2, 2))
    assert expected_probability(np.array([1.0, 0.0]), nothing) == 1.0
    assert expected_probability(np.array([0.5, 0.5]), nothing) == pytest.approx(0.5)
    assert expected_probability(np.array([0.5, 0.5]), np.full((2, 2), np.log(99.0))) == pytest.approx(0.99)


AXIS = """[linear_axis]
moving_mass_kg = { nominal = 2.0, rel_std = 0.1 }
viscous_damping_n_s_per_m = { nominal = 30.0, rel_std = 0.1 }
force_constant_n_per_a = { nominal = 20.0, rel_std = 0.02 }
"""


@pytest.mark.parametrize(("n_trials", "words"), [(21, "1 to 20"), (3, "planned for a saw")])
def test_a_plan_that_nobody_can_run_is_refused_before_anything_is_read(n_trials, words):
    with pytest.raises(InputError, match=words):
        diagnose([], parse_config(AXIS), provenance={}, n_planned=n_trials)
