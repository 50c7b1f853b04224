"""The rules between evidence and claim: what a form misses, what a second one shares, what an intact machine leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.inference.beyond.drive import SOFTENING_FRICTION, WARMING_FRICTION
from sawbench.diagnosis.inference.columns import catalogue_columns
from sawbench.diagnosis.inference.evidence import explain
from sawbench.diagnosis.inference.form_error import form_modes
from sawbench.diagnosis.inference.forming import Formed, Forming, shared_energy
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import uncertain_by_left_over
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.unnamed import beyond_catalogue
from sawbench.diagnosis.plants.jigsaw import Jigsaw

from tests.rigs.drawn_states import BASELINE
from tests.rigs.scattered_strokes import friction, problem_of, strokes

pytestmark = pytest.mark.unit


@pytest.fixture(scope="module")
def states():
    return strokes()


@pytest.fixture(scope="module")
def problem(states):
    return problem_of(states)


def explained(problem, name):
    plant = problem.campaign.plant
    columns = catalogue_columns(problem, [e for e in plant.effects if e.name == name])
    return columns, explain(Marginal(problem), columns[name])


def with_gap(problem, signature, size=1.0):
    return replace(problem, data=problem.data + size * problem.project(signature))


def forming(problem):
    n = len(problem.data)
    return Forming(problem, np.zeros((n, 0)), Marginal(problem), np.ones(n))


def formed(problem, name):
    columns, rough = explained(problem, name)
    return rough, forming(problem).single(rough, columns[name]).explanation


def bent_friction(state):
    return {"mechanical": -2.0 * (1.0 + 0.5 * np.cos(state.angle_rad)) * friction(state)["mechanical"]}


def test_further_nuisances_beside_known_ones_are_all_of_them_together(problem):
    rng = np.random.default_rng(3)
    n = len(problem.data)
    extra, columns = rng.standard_normal((n, 4)), rng.standard_normal((n, 6))
    alone, together = Marginal(problem), Marginal(problem, extra=extra)
    beside = alone.beside(extra)
    assert beside.data_half == pytest.approx(together.data_half, rel=1e-8, abs=1e-9)
    half = beside.half(columns, alone.half(columns))
    assert half == pytest.approx(together.half(columns), rel=1e-8, abs=1e-9)
    assert beside.half(columns) == pytest.approx(half, rel=1e-8, abs=1e-9)
    for said_by in (lambda one: one.split(columns), lambda one: one.estimate()):
        for found, whole in zip(said_by(beside), said_by(together), strict=True):
            assert found == pytest.approx(whole, rel=1e-8, abs=1e-9)


def test_play_acts_in_the_cut_by_the_motion_of_the_blade_that_it_lets_loose():
    """It stands in the measured velocity, not in the signature: a lag of the force was claimed beside play for it."""
    states = [replace(s, blade_excess_m_s=0.05 * np.sin(7.0 * s.angle_rad)) for s in strokes()]
    loose = problem_of(states)
    marginal, n = Marginal(loose), len(loose.data)
    forming = Forming(loose, np.zeros((n, 0)), marginal, np.ones(n))
    columns = catalogue_columns(loose, loose.campaign.plant.effects)
    play, friction = (explain(marginal, columns[name]) for name in ("yoke_backlash", "motor_coulomb_friction"))
    beyond = loose.sums_by_equation((forming._acting(play) - play.contribution) ** 2)
    assert {equation for equation, energy in beyond.items() if energy > 0.0} == {"cutting"}
    assert np.array_equal(forming._acting(friction), friction.contribution)
    in_air = next(s for s in states if s.setting.is_idle)
    assert loose.campaign.plant.force_beyond_crank(in_air) == {}


def test_what_a_form_misses_adds_to_a_real_effect(problem):
    rough, found = formed(with_gap(problem, bent_friction), "motor_coulomb_friction")
    assert rough.log_evidence > 10.0
    assert rough.log_evidence < found.log_evidence <= 2.0 * rough.log_evidence
    assert found.form_share > 0.0


def test_an_effect_that_is_not_there_gains_nothing_from_what_its_form_may_miss(problem):
    """A gap at one harmonic of the force: wear has modes there but does not itself explain it."""

    def ringing(state):
        return {"cutting": 1.5 * np.cos(7 * state.angle_rad) * (0.0 if state.setting.is_idle else 1.0)}

    rough, found = formed(with_gap(problem, ringing), "blade_wear")
    assert rough.log_evidence < 3.0
    assert found.log_evidence <= max(2.0 * rough.log_evidence, rough.log_evidence) + 1e-9


def test_effects_of_one_equation_share_it_and_others_share_nothing(problem):
    brush = problem.project(lambda s: {"electrical": np.ones_like(s.angle_rad)})
    diode = problem.project(lambda s: {"electrical": (1.0 - s.setting.duty) * np.ones_like(s.angle_rad)})
    drag = problem.project(friction)
    assert shared_energy(problem, brush, diode) == pytest.approx(1.0)
    assert shared_energy(problem, brush, drag) == pytest.approx(0.0)
    assert shared_energy(problem, brush + drag, drag) == pytest.approx(
        np.sum(drag**2) / (np.sum(drag**2) + np.sum(brush**2))
    )


def test_a_form_that_leaves_much_makes_its_size_uncertain(problem):
    _, found = explained(with_gap(problem, bent_friction), "motor_coulomb_friction")
    clean, rough = (uncertain_by_left_over(found, left, no_gap=5.0, quiet=0.15) for left in (0.1, 2.0))
    assert clean.form_share == found.form_share
    assert rough.strength_std > 2.0 * clean.strength_std


def test_a_noisy_bench_leaves_more_and_is_no_gap(states):
    """Ten times the noise: the quiet level rises with it, up to one, and stays where the bench is quiet."""
    rng = np.random.default_rng(2)
    noisy = [
        replace(
            s,
            force_n=s.force_n + 8.0 * rng.standard_normal(s.force_n.shape),
            current_a=s.current_a + 0.4 * rng.standard_normal(s.current_a.shape),
        )
        for s in states
    ]
    quiet, loud = problem_of(states), problem_of(noisy)
    assert quiet.quiet >= SETTINGS.weights.quiet
    assert quiet.quiet < loud.quiet <= 1.0
    assert Marginal(loud).misfit / len(loud.data) < loud.quiet


def test_an_uncertain_ripple_is_an_error_of_the_model(states):
    plant = Jigsaw(baseline=BASELINE)
    state = next(s for s in states if not s.setting.is_idle)
    uncertain = replace(state, ripple_std_rad=np.full(8, 1e-3))
    layout = build_problem(problem_of(states).campaign).parts[0].layout
    before, after = (np.diag(plant.model_error(layout, s)) for s in (state, uncertain))
    for equation, place in layout.slices.items():
        grows = equation in ("electrical", "mechanical")
        assert np.all(after[place][1:3] > before[place][1:3]) == grows
        assert after[place][0] == before[place][0]


@pytest.mark.parametrize(("order", "counts"), [(5, True), (7, False)])
def test_harmonics_that_a_channel_does_not_resolve_are_not_compared(states, order, counts):
    slow = [replace(s, resolved_orders={"force_n": 5.5}) for s in states]
    # What is compared is the wave's share of the time.
    waved = [
        replace(s, force_n=s.force_n + 3.0 * np.cos(order * s.angle_rad) * s.speed_rad_s / s.speed_rad_s.mean())
        for s in slow
    ]
    before, after = (Marginal(build_problem(problem_of(of).campaign)).misfit for of in (slow, waved))
    assert (after - before > 100.0) == counts
    assert abs(after - before) < 1.0 or counts


def test_without_a_form_beyond_the_catalogue_nothing_is_added(problem):
    assert beyond_catalogue(forming(problem), Marginal(problem), {}, {}) == {}


def test_friction_that_fades_within_each_trial_is_explained_beyond_the_catalogue(states):
    lasting = [replace(s, time_s=np.linspace(0.5, 12.0, len(s.angle_rad))[:, None]) for s in states]

    def cold(state):
        return {"mechanical": 0.01 * np.exp(-np.broadcast_to(state.time_s, state.angle_rad.shape) / 3.0)}

    gap = with_gap(problem_of(lasting), cold)
    beyond = catalogue_columns(gap, gap.campaign.plant.beyond_catalogue)
    _, constant = formed(gap, "motor_coulomb_friction")
    listed = {"motor_coulomb_friction": constant.log_evidence}
    found = beyond_catalogue(forming(gap), Marginal(gap), beyond, listed)
    assert max(found, key=lambda name: found[name]) == WARMING_FRICTION.name
    assert found[WARMING_FRICTION.name] > constant.log_evidence + 5.0


def test_what_a_law_leaves_by_itself_counts_against_it(states):
    """Both gaps it explains with what its form may miss; of one of them that takes up a large share."""
    lasting = [replace(s, time_s=np.linspace(0.5, 12.0, len(s.angle_rad))[:, None]) for s in states]

    def lost(ripple):
        def cold(state):
            fading = np.exp(-np.broadcast_to(state.time_s, state.angle_rad.shape) / 3.0)
            return {"mechanical": 0.02 * fading * (1.0 + ripple * np.cos(state.angle_rad))}

        gap = with_gap(problem_of(lasting), cold)
        beyond = catalogue_columns(gap, gap.campaign.plant.beyond_catalogue)
        entries = beyond[WARMING_FRICTION.name]
        alone = forming(gap).single(explain(Marginal(gap), entries), entries).explanation
        found = beyond_catalogue(forming(gap), Marginal(gap), beyond, {})[WARMING_FRICTION.name]
        return alone.log_evidence - np.log(len(beyond)) - found

    assert abs(lost(0.0)) < 0.1
    assert lost(1.5) > 2.0


def test_friction_that_falls_over_the_session_is_explained_beyond_the_catalogue(states):
    """Trials one after another, each warmer than the one before; the law of the gap is linear, not the one sought."""
    warmer = [
        replace(s, slow={memory: held * (k + 0.5) / len(states) for memory, held in s.slow.items()})
        for k, s in enumerate(states)
    ]

    def falling(state):
        share = 1.0 - 0.6 * state.setting.index / len(states)
        return {"mechanical": np.full(state.angle_rad.shape, 0.012 * share)}

    gap = with_gap(problem_of(warmer), falling)
    beyond = catalogue_columns(gap, gap.campaign.plant.beyond_catalogue)
    _, constant = formed(gap, "motor_coulomb_friction")
    found = beyond_catalogue(
        forming(gap), Marginal(gap), beyond, {"motor_coulomb_friction": constant.log_evidence}
    )  # fmt: skip
    assert max(found, key=lambda name: found[name]) == SOFTENING_FRICTION.name
    assert found[SOFTENING_FRICTION.name] > constant.log_evidence + 5.0


def test_friction_that_stays_is_no_friction_that_falls(states):
    """Within the few seconds of a trial the two are hardly told apart: the catalogue's friction is the answer."""

    def lasting(state):
        return {"mechanical": np.full(state.angle_rad.shape, 0.004)}

    gap = with_gap(problem_of(states), lasting)
    beyond = catalogue_columns(gap, gap.campaign.plant.beyond_catalogue)
    _, constant = formed(gap, "motor_coulomb_friction")
    falling = {WARMING_FRICTION.name, SOFTENING_FRICTION.name}
    assert falling <= beyond_catalogue(forming(gap), Marginal(gap), beyond, {}).keys()
    listed = {"motor_coulomb_friction": constant.log_evidence}
    assert not falling & beyond_catalogue(forming(gap), Marginal(gap), beyond, listed).keys()


@pytest.mark.parametrize(("falls_by", "is_one_that_falls"), [(0.25, False), (0.6, True)])
def test_what_the_form_of_a_strong_friction_misses_is_no_friction_that_falls(states, falls_by, is_one_that_falls):
    """Evidence of hundreds is not known to a few: a form misses that much."""
    lasting = [replace(s, time_s=np.linspace(0.5, 12.0, len(s.angle_rad))[:, None]) for s in states]

    def friction(state):
        falling = np.exp(-np.broadcast_to(state.time_s, state.angle_rad.shape) / 3.0)
        return {"mechanical": 0.05 * (1.0 - falls_by * (1.0 - falling))}

    gap = with_gap(problem_of(lasting), friction)
    beyond = catalogue_columns(gap, gap.campaign.plant.beyond_catalogue)
    _, constant = formed(gap, "motor_coulomb_friction")
    alone = beyond_catalogue(forming(gap), Marginal(gap), beyond, {})[WARMING_FRICTION.name]
    assert alone > constant.log_evidence + 4.0
    listed = {"motor_coulomb_friction": constant.log_evidence}
    found = beyond_catalogue(forming(gap), Marginal(gap), beyond, listed)
    assert (WARMING_FRICTION.name in found) == is_one_that_falls


def test_a_second_effect_may_miss_no_more_than_goes_with_its_size_beside_the_first(problem):
    """Alone windage explains most of a bent friction; what its form would then miss is no freedom of the pair."""
    gap = with_gap(problem, bent_friction)
    columns, friction_alone = explained(gap, "motor_coulomb_friction")
    windage_columns, windage_alone = explained(gap, "windage_drag")
    weighed = forming(gap)
    weighed.single(windage_alone, windage_columns["windage_drag"])
    first = Formed(explanation=friction_alone, column=friction_alone.column, with_modes=friction_alone.log_evidence)
    beside = explain(Marginal(gap, extra=first.shapes[0]), windage_columns["windage_drag"])
    assert np.linalg.norm(beside.contribution) < 0.5 * np.linalg.norm(windage_alone.contribution)
    asked = []

    def noted(problem, contribution, **options):
        asked.append(np.linalg.norm(contribution))
        return form_modes(problem, contribution, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sawbench.diagnosis.inference.forming.form_modes", noted)
        shown = replace(beside, log_evidence=2.0 * SETTINGS.forms.worth_forming)
        weighed._pair(first, shown, columns | windage_columns)
    assert sorted(asked) == pytest.approx(sorted([np.linalg.norm(e.contribution) for e in (friction_alone, beside)]))
