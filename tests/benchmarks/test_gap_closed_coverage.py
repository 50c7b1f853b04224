"""The benchmark of the interval of `gap_closed` counts what it says; the campaigns themselves are its own work."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from benchmarks import gap_closed_coverage as coverage

pytestmark = pytest.mark.pipeline


def rows(values, reach: float, *, effect: str = "edge_force", seed: int = 701) -> list[dict]:
    return [
        {"seed": seed, "effect": effect, "repetition": k, "gap_closed": v, "gap_closed_ci95": [v - reach, v + reach]}
        for k, v in enumerate(values)
    ]


def test_an_interval_is_held_against_the_mean_of_the_others():
    # The others of 0.9 have the mean 0.5; those of each 0.5 the mean 0.6333.
    hits, n, values, width = coverage.count(rows([0.5, 0.5, 0.5, 0.9], 0.2))
    assert (hits, n, width) == (3, 4, pytest.approx(0.4))
    assert values.mean() == pytest.approx(0.6)


def test_exact_intervals_are_right_as_often_as_they_should_be():
    rng = np.random.default_rng(2)
    n_repeats, n_machines = 5, 2000
    hits = sum(coverage.count(rows(rng.normal(0.8, 0.05, n_repeats), 1.96 * 0.05))[0] for _ in range(n_machines))
    wanted = coverage.of_a_perfect_interval(n_repeats)
    assert wanted == pytest.approx(1.0 - 2.0 * norm.sf(1.959964 / np.sqrt(1.25)), abs=1e-6)
    assert hits / (n_machines * n_repeats) == pytest.approx(wanted, abs=0.01)


def test_too_few_repetitions_say_nothing():
    told = rows([0.5, 0.6], 0.2)
    told.append({"seed": 701, "effect": "edge_force", "repetition": 2, "gap_closed": None, "gap_closed_ci95": None})
    assert coverage.count(told)[:2] == (0, 0)
    text = coverage.table([*told, *rows([0.5] * 4, 0.1, effect="windage_drag", seed=702)])
    assert "2 repetitions that show it, 3 are needed" in text
    assert "4/4" in text.splitlines()[-1]


def test_machines_stay_below_the_seeds_of_claims():
    assert max(seed for seed, _ in coverage.machines(299)) == 999
    with pytest.raises(SystemExit):
        coverage.machines(300)
