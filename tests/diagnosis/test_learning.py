"""The learned term: what it depends on is found, what it closes is withheld, and it is silent without a gap."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.diagnosis.answer.hold_out import HoldOut
from sawbench.diagnosis.answer.learned_term import NOTHING, learned_answer, learned_warnings
from sawbench.diagnosis.inference.columns import catalogue_columns
from sawbench.diagnosis.inference.features import Layout, times_over_angles
from sawbench.diagnosis.inference.learning import learn
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Part
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME

from tests.rigs.drawn_states import BASELINE, running, setting_of

pytestmark = pytest.mark.unit

LAYOUT = Layout(kind="running", equations=("mechanical", "cutting"), n_harmonics={"mechanical": 8, "cutting": 12})
NOISE = np.repeat([1e-4, 0.05], [17, 25])  # N*m and N
UNKNOWN = SimpleNamespace(verdict="unknown", freed=())
GEAR = 9.333333333333334


def strokes(point, repeat):
    """Strokes of one trial; speed and current differ from point to point, each with a ripple of its own."""
    state = running(is_idle=point >= 4)
    faster = (0.6, 0.75, 0.9, 1.05, 0.7, 1.0)[point]
    harder = (1.0, 1.6, 0.8, 1.3, 0.3, 0.4)[point]
    setting = setting_of(point >= 4, label=f"t{point}{repeat}", operating_point=f"p{point}")
    return replace(
        state, setting=setting, speed_rad_s=faster * state.speed_rad_s, current_a=harder * state.current_a,
        time_s=state.time_s + 3.0 * repeat,
    )  # fmt: skip


def problem(hidden, seed=0):
    """Residuals that hold what `hidden` makes of a state, noise, and one thing that is mistuned."""
    rng = np.random.default_rng(seed)
    whitener = np.diag(1.0 / NOISE)
    parts, data, start = [], [], 0
    for point in range(6):
        for repeat in range(2):
            state = strokes(point, repeat)
            rows = LAYOUT.place(hidden(state), times_over_angles(state)) @ whitener + rng.standard_normal(
                (3, LAYOUT.size)
            )
            place = slice(start, start + rows.size)
            parts.append(
                Part(
                    state=state,
                    smooth=state,
                    layout=LAYOUT,
                    times=times_over_angles(state),
                    blocks=np.eye(3),
                    whitener=whitener,
                    common=np.zeros((LAYOUT.size, LAYOUT.size)),
                    scatter=np.ones(LAYOUT.size),
                    place=place,
                )
            )
            data.append(rows.ravel())
            start = place.stop
    states = tuple(part.state for part in parts)
    campaign = SimpleNamespace(
        plant=Jigsaw(baseline=BASELINE), baseline=BASELINE, states=states, angle_is_assumed=False
    )
    column = rng.standard_normal((start, 1))
    return LinearProblem(
        campaign=campaign, parts=tuple(parts), data=np.concatenate(data) + 2.0 * column[:, 0],
        known=np.zeros(len(column)), nuisance=3.0 * column,
        names=("mistuned",), prior_std=np.ones(1), quiet=1.0,
    )  # fmt: skip


def drag(state):
    """Air that a fan moves: 4 mN m at 1000 rad/s of the motor, growing with the square."""
    return {"mechanical": 0.004 * (GEAR * state.speed_rad_s / 1000.0) ** 2}


def crosstalk(state):
    return {"cutting": 0.4 * state.current_a}


def whip(state):
    """A wave over the crank angle that grows with the speed."""
    return {"cutting": 3.0 * (state.speed_rad_s / 88.0) ** 2 * np.cos(3.0 * state.angle_rad)}


@cache
def answered(hidden):
    whole = problem(hidden)
    names = ("windage_drag", "guide_friction", "edge_force")
    return learned_answer(whole, catalogue_columns(whole, [EFFECT_BY_NAME[name] for name in names]), UNKNOWN)


@pytest.mark.parametrize(
    ("hidden", "site", "quantities"),
    [
        (drag, "mechanical", ("crank_speed_rad_s",)),
        (crosstalk, "cutting", ("motor_current_a",)),
        (whip, "cutting", ("crank_angle_rad", "crank_speed_rad_s")),
    ],
)
def test_place_dependence_and_values_are_found(hidden, site, quantities):
    answer = answered(hidden)
    assert answer is not None
    term = answer.learned.term
    assert (term.site, term.quantities) == (site, quantities)
    closed, (low, _) = answer.ladder.closed
    assert closed > 0.9 and low > 0.8
    state = strokes(1, 0)
    (found,) = term(BASELINE, state)
    expected = hidden(state)[site]
    assert np.abs(found[site] - expected).max() < 0.1 * np.abs(expected).max()
    # The band holds the truth where the trials were.
    stds = replace(term, values=term.stds)(BASELINE, state)[0][site]
    assert np.mean(np.abs(found[site] - expected) < 3.0 * stds) > 0.9


def test_what_it_resembles_is_the_effect_of_that_form():
    answer = answered(drag)
    assert answer is not None
    (name, correlation), *_ = answer.resembles
    assert name == "windage_drag" and correlation > 0.97
    assert "rises with crank speed" in answer.words() and "windage drag" in answer.words()


def test_no_term_without_a_gap_and_the_report_says_so():
    whole = problem(lambda state: {})
    assert learned_answer(whole, {}, UNKNOWN) is None
    assert learned_warnings(whole, UNKNOWN, None) == [NOTHING]


def test_a_gap_of_the_run_up_is_not_put_into_running_strokes():
    whole = problem(drag)
    layout = Layout(kind="start_up", equations=("electrical",))
    state = replace(strokes(0, 0), kind="start_up")
    start = len(whole.data)
    part = Part(
        state=state, smooth=state, layout=layout, times=times_over_angles(state), blocks=np.eye(1),
        whitener=np.eye(layout.size),
        common=np.zeros((layout.size, layout.size)), scatter=np.zeros(layout.size),
        place=slice(start, start + layout.size),
    )  # fmt: skip
    far = 1e3 * np.abs(whole.data).max()
    with_run_up = replace(
        whole, parts=(*whole.parts, part), data=np.append(whole.data, np.full(layout.size, far)),
        nuisance=np.vstack([whole.nuisance, np.zeros((layout.size, 1))]),
    )  # fmt: skip
    assert learn(with_run_up, HoldOut(with_run_up).free_errors) is None
    # A run-up without a gap leaves the term to be found.
    quiet = replace(with_run_up, data=np.append(whole.data, np.zeros(layout.size)))
    assert learn(quiet, HoldOut(quiet).free_errors) is not None


@pytest.mark.parametrize("verdict", ["no_gap", "parameters", "effect", "effects"])
def test_other_answers_learn_nothing(verdict):
    posterior = SimpleNamespace(verdict=verdict, freed=())
    assert learned_answer(problem(drag), {}, posterior) is None
    assert learned_warnings(problem(drag), posterior, None) == []


def test_errors_without_bounds_are_those_of_a_fit_to_the_other_points():
    whole = problem(drag)
    hold_out = HoldOut(whole)
    assert hold_out.held_out == "operating points"
    column = np.random.default_rng(3).standard_normal((len(whole.data), 1))
    found = hold_out.free_errors(column)
    design = np.hstack([whole.nuisance * whole.wide_scale, column])
    for group, square in zip(hold_out.groups, found, strict=True):
        held = hold_out.rows[group]
        # Unit priors as further rows of a least-squares problem.
        stacked = np.vstack([design[~held], np.eye(design.shape[1])])
        data = np.append(whole.data[~held], np.zeros(design.shape[1]))
        rest = whole.data[held] - design[held] @ np.linalg.lstsq(stacked, data, rcond=None)[0]
        own = design[held][:, :-1][:, whole.is_of_trial]
        n = own.shape[1]
        again = np.linalg.lstsq(np.vstack([own, np.eye(n)]), np.append(rest, np.zeros(n)), rcond=None)[0]
        assert square == pytest.approx(float(np.sum((rest - own @ again) ** 2)), rel=1e-6)
