"""Wrong numbers of the plant are weighed as which and how many, and one that is wrong pays for itself alone."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import judge
from sawbench.diagnosis.inference.retuning import Retuning
from sawbench.diagnosis.inference.settings import SETTINGS
from scipy.stats import multivariate_normal

from tests.rigs.scattered_strokes import problem_of, strokes

pytestmark = pytest.mark.unit

N_POINTS, WIDE = 60, 5.0


def bench(seed, n_numbers, off_std=()):
    """Numbers that the data know to a tenth of their stated uncertainty, some of them off, and one sensor's zero."""
    rng = np.random.default_rng(seed)
    columns = np.linalg.qr(rng.standard_normal((N_POINTS, n_numbers + 1)))[0] * 10.0
    truth = rng.standard_normal(n_numbers + 1)
    truth[: len(off_std)] = off_std
    return SimpleNamespace(
        nuisance=columns, data=columns @ truth + rng.standard_normal(N_POINTS), settings=SETTINGS,
        wide_scale=np.array([WIDE] * n_numbers + [1.0]), wide_if_less=np.ones(n_numbers + 1),
        names=(*(f"number {k}" for k in range(n_numbers)), "zero"),
    )  # fmt: skip


def all_at_once(problem):
    return Marginal(problem, scale=problem.wide_scale).log_evidence - Marginal(problem).log_evidence


def found(problem):
    return Retuning(problem, Marginal(problem)).log_evidence


@pytest.mark.parametrize("seed", range(3))
def test_every_set_of_numbers_counts_with_its_own_evidence(seed):
    problem = bench(seed, 4, (3.0,))

    def log_of(wrong):
        scale = np.array([WIDE if k in wrong else 1.0 for k in range(5)])
        design = problem.nuisance * scale
        return multivariate_normal(cov=np.eye(N_POINTS) + design @ design.T).logpdf(problem.data)

    by_number = [
        np.logaddexp.reduce([log_of(wrong) for wrong in combinations(range(4), size)])
        - np.log(len(list(combinations(range(4), size)))) - size * np.log(2.0)
        for size in (1, 2, 3)
    ]  # fmt: skip
    expected = np.logaddexp.reduce([*by_number, log_of(range(4)) - 3 * np.log(2.0)]) - log_of(())
    assert found(problem) == pytest.approx(expected, abs=1e-6)


def test_one_number_five_standard_deviations_off_shows_among_a_dozen():
    wrong = [bench(seed, 12, (5.0,)) for seed in range(10)]
    assert np.median([all_at_once(p) for p in wrong]) < 0.0, "each of the others pays for what one gains"
    assert np.median([found(p) for p in wrong]) > 3.0


def test_numbers_within_their_uncertainty_are_no_finding():
    assert np.median([found(bench(seed, 12)) for seed in range(20)]) < 0.0


def test_without_a_number_of_the_plant_there_is_nothing_to_retune():
    assert found(bench(1, 0)) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("off_std", [(), (5.0,), (5.0, -4.5)])
def test_numbers_that_are_off_are_freed_and_no_others(off_std):
    problem = bench(4, 12, off_std)
    assert set(Retuning(problem, Marginal(problem)).freed) == set(problem.names[: len(off_std)])


def test_a_number_that_the_data_do_not_tell_stays_as_it_is_stated_whatever_is_missed():
    """Its column is a tenth of the noise, and the data miss something of twice the noise that looks like it."""
    problem = bench(5, 4, (5.0,))
    along = problem.nuisance[:, 3] / np.linalg.norm(problem.nuisance[:, 3])
    problem.nuisance[:, 3] = 0.1 * along
    problem.data += (2.0 - along @ problem.data) * along
    assert Retuning(problem, Marginal(problem)).freed == ("number 0",)


def test_a_background_effect_that_explains_a_misfit_frees_no_number():
    """A compliant blade of a twentieth of its typical size took the crank radius by 28 standard deviations."""
    problem = bench(6, 4)
    background = np.linalg.qr(np.random.default_rng(7).standard_normal((N_POINTS, 1)))[0] * 10.0
    own = problem.nuisance[:, 1] / np.linalg.norm(problem.nuisance[:, 1])
    problem.data += 1.5 * background[:, 0] - own * (own @ problem.data)
    problem.nuisance[:, 1] = 0.3 * background[:, 0] + 0.5 * own
    assert Retuning(problem, Marginal(problem)).freed == ("number 1",)
    assert Retuning(problem, Marginal(problem, extra=background)).freed == ()


@pytest.mark.parametrize("off", [0.0, 0.06])
def test_a_crank_radius_that_the_strokes_contradict_is_a_wrong_number(off):
    """Whatever the other channels say of it: the lever is 6 % off, and torque constant and friction make up for it."""
    unread = problem_of(strokes()).campaign
    radius = unread.baseline.plant.crank_radius_m
    read = {"crank_radius_m": ((1.0 + off) * radius.nominal, 0.01 * radius.nominal)}
    problem = build_problem(replace(unread, read=read))
    answer = judge(problem, {})
    assert ("crank_radius_m" in answer.freed) == (off != 0.0)
    assert answer.verdict == ("parameters" if off else "no_gap")
    assert problem.data[-1] == pytest.approx(100.0 * off)


@pytest.mark.parametrize(("off_std", "is_freed"), [(-9.0, True), (9.0, False)])
def test_a_number_that_is_an_effect_where_it_grew_is_re_tuned_where_it_is_less(off_std, is_freed):
    """As seen: a battery resistance stated thirty times too large was "no gap", ten standard uncertainties off."""
    problem = bench(2, 4, (off_std,))
    numbers, alone = problem.wide_scale, np.arange(5) == 0
    problem.wide_scale, problem.wide_if_less = np.where(alone, 1.0, numbers), np.where(alone, WIDE, 1.0)
    retuning = Retuning(problem, Marginal(problem))
    assert ("number 0" in retuning.freed) == is_freed
    assert (retuning.log_evidence > 20.0) == is_freed
