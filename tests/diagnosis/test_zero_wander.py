"""A zero that walks at random is measured as such, is no drift, and hides none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.columns import catalogue_columns
from sawbench.diagnosis.inference.evidence import explain
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.zero_wander import ZeroReadings, zero_wander
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME

from tests.rigs.jigsaw_in_time import BASELINE, Machine

pytestmark = pytest.mark.unit

N_UNITS, LENGTH_S, N_TRIALS, APART_S = 16, 8.0, 14, 60.0
IN_A_TRIAL = (np.arange(N_UNITS) + 0.5) * LENGTH_S / N_UNITS


def walk(rng, size_n):
    """A random walk from nothing that reaches `size_n` (one standard deviation) by the end of a trial."""
    return size_n * np.cumsum(rng.standard_normal(N_UNITS)) / np.sqrt(N_UNITS)


def zeros(rng, *, size_n, restart_n=0.0, step_n=0.0, drift_n_per_1000_s=0.0, goes_on=False):
    """Zero of each trial at each reading, and when; a walk that goes on does so between trials too."""
    last_n = 0.0
    for number in range(N_TRIALS):
        at_s = APART_S * number + IN_A_TRIAL
        walked_n = last_n + walk(rng, size_n)
        if goes_on:
            rest_s = APART_S - LENGTH_S
            last_n = walked_n[-1] + size_n * np.sqrt(rest_s / LENGTH_S) * rng.standard_normal()
        last_n += step_n * rng.standard_normal() if step_n else 0.0
        yield at_s, walked_n + restart_n * rng.standard_normal() + drift_n_per_1000_s * at_s / 1000.0


def readings(rng, white_n=0.05, **numbers):
    return [
        ZeroReadings(at_s=at_s, zero_n=zero_n + white_n * rng.standard_normal(N_UNITS), not_zero=np.zeros(3))
        for at_s, zero_n in zeros(rng, **numbers)
    ]


@pytest.mark.parametrize("size_n", [0.3, 1.0])
def test_the_density_is_found_within_its_uncertainty(size_n):
    true = size_n**2 / LENGTH_S
    found = [zero_wander(readings(np.random.default_rng(seed), size_n=size_n, restart_n=0.5)) for seed in range(40)]
    off = np.array([(w.density_n2_s - true) / w.density_std_n2_s for w in found])
    assert np.mean(np.abs(off) < 2.0) >= 0.85
    assert abs(off.mean()) < 0.6
    assert np.median([w.density_std_n2_s for w in found]) < 0.3 * true


def test_the_scatter_of_restarts_is_found():
    found = [zero_wander(readings(np.random.default_rng(seed), size_n=0.02, restart_n=0.8)) for seed in range(20)]
    assert np.median([w.restart_n for w in found]) == pytest.approx(0.8, rel=0.25)


def test_a_load_cell_that_was_not_tared_is_off_in_all_trials_alike():
    """85 N in every trial were "the zero differs by 10 N from trial to trial"."""
    for level_n in (0.0, 85.0, -40.0):
        found = [
            zero_wander(
                [
                    replace(t, zero_n=t.zero_n + level_n)
                    for t in readings(np.random.default_rng(seed), size_n=0.02, restart_n=0.8)
                ]
            )
            for seed in range(20)
        ]
        assert np.median([w.restart_n for w in found]) == pytest.approx(0.8, rel=0.25)
        assert np.median([w.level_n for w in found]) == pytest.approx(level_n, abs=0.5)


def test_a_still_zero_does_not_wander():
    found = zero_wander(readings(np.random.default_rng(1), size_n=0.0))
    assert np.sqrt(found.density_n2_s * LENGTH_S) < 0.05
    assert found.white_n == pytest.approx(0.05, rel=0.2)


def test_a_lasting_drift_is_no_wander():
    found = zero_wander(readings(np.random.default_rng(1), size_n=0.1, drift_n_per_1000_s=5.0))
    apart = found.covariance(np.array([0.0, APART_S * N_TRIALS]), np.array([0, N_TRIALS]))
    between_n = np.sqrt(apart[0, 0] + apart[1, 1] - 2.0 * apart[0, 1])
    assert between_n < 0.25 * 5.0 * APART_S * N_TRIALS / 1000.0


def test_a_drift_of_the_zero_is_believed_and_a_walk_is_not():
    """One effect of some thirty: the evidence of a drift is worth more than that choice, and of a walk it seldom is."""
    even = np.log(30.0)
    drifting = [zero_wander(readings(np.random.default_rng(k), size_n=0.1, drift_n_per_1000_s=8.0)) for k in range(20)]
    assert np.mean([w.of_drift > even for w in drifting]) >= 0.9
    for walks in (
        {"size_n": 0.3, "goes_on": True}, {"size_n": 0.1, "restart_n": 1.0}, {"size_n": 0.02},
        {"size_n": 0.1, "step_n": 0.5},
    ):  # fmt: skip
        still = [zero_wander(readings(np.random.default_rng(k), **walks)) for k in range(20)]
        assert np.mean([w.of_drift > even for w in still]) <= 0.05


def test_restarts_that_add_up_do_not_hide_a_drift():
    """Steps of 0.3 N and a trend of 0.3 N a trial: the likeliest wander holds the trend, all of them do not."""
    found = [
        zero_wander(readings(np.random.default_rng(k), size_n=0.02, step_n=0.3, drift_n_per_1000_s=5.0))
        for k in range(20)
    ]
    assert np.mean([w.of_drift for w in found]) > np.log(30.0)


def test_a_drift_within_the_trials_is_no_walk():
    """A tenth of the drift of a fast warm-up passes within each trial: the walk is what is left about that line."""
    fast = zero_wander(readings(np.random.default_rng(2), size_n=0.0, drift_n_per_1000_s=60.0))
    assert np.sqrt(fast.density_n2_s * LENGTH_S) < 0.1
    assert 60.0 * LENGTH_S / 1000.0 > 0.4


def test_too_few_or_short_trials_cannot_tell():
    trials = readings(np.random.default_rng(1), size_n=1.0)
    assert zero_wander(trials[:2]) is None
    assert zero_wander([replace(t, at_s=t.at_s[:3], zero_n=t.zero_n[:3]) for t in trials]) is None


@pytest.fixture(scope="module")
def strokes():
    return {(cuts, duty): Machine(cuts=cuts, duty=duty).run(N_UNITS) for cuts in (True, False) for duty in (0.45, 0.6)}


def drift_found(strokes, seed, **numbers):
    """Log evidence of a drift of the force's zero, on an intact machine but for that zero."""
    rng = np.random.default_rng(seed)
    states = []
    for number, (at_s, zero_n) in enumerate(zeros(rng, **numbers)):
        cuts, duty = number % 3 > 0, (0.45, 0.6)[number % 2]
        state = strokes[cuts, duty]
        noise_n = 0.3 * rng.standard_normal(state.force_n.shape)
        setting = replace(
            state.setting, label=f"t{number}", index=number, session_s=APART_S * number,
            operating_point=f"{cuts} {duty}", stock="oak" if cuts else "air",
        )  # fmt: skip
        states.append(
            replace(
                state, setting=setting, time_s=at_s[:, None] - APART_S * number,
                force_n=state.force_n + zero_n[:, None] + noise_n,
                current_a=state.current_a + 0.03 * rng.standard_normal(state.force_n.shape),
            )
        )  # fmt: skip
    campaign = Campaign(plant=Jigsaw(baseline=BASELINE), states=tuple(states), k_guess_n_s_per_m={}, warnings=())
    problem = build_problem(campaign)
    columns = catalogue_columns(problem, (EFFECT_BY_NAME["force_offset_drift"],))["force_offset_drift"]
    return explain(Marginal(problem), columns).log_evidence


@pytest.mark.parametrize(
    "walks",
    [{"restart_n": 0.5}, {"restart_n": 0.5, "goes_on": True}, {"step_n": 0.5}],
    ids=", ".join,
)
def test_a_wandering_zero_is_no_evidence_of_a_drift(strokes, walks):
    found = [drift_found(strokes, seed, size_n=0.6, **walks) for seed in range(5)]
    assert max(found) < 5.0


def test_a_drift_beyond_the_wander_is_found(strokes):
    found = [drift_found(strokes, seed, size_n=0.1, restart_n=0.2, drift_n_per_1000_s=6.0) for seed in range(3)]
    assert min(found) > 20.0
