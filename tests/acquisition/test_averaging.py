"""Means of resting values against processes whose autocorrelation is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.averaging import resting_mean, unsteady
from sawbench.bench.errors import InputError
from scipy.signal import lfilter

pytestmark = pytest.mark.unit

RATE_HZ = 1000.0


def first_order(rng, n, a, std=1.0):
    """Stationary first-order process with standard deviation `std`; its autocorrelation time is (1 + a)/(1 - a)."""
    steps = rng.standard_normal(n + 2000) * std * np.sqrt(1 - a**2)
    return lfilter([1.0], [1.0, -a], steps)[2000:]


@pytest.mark.parametrize("a", [0.0, 0.9])
def test_the_stated_uncertainty_of_the_mean_is_the_scatter_of_means(a):
    rng = np.random.default_rng(4)
    time_s = np.arange(4000) / RATE_HZ
    found = [resting_mean(time_s, 7.0 + first_order(rng, 4000, a)) for _ in range(400)]
    pulls = np.array([(f.mean - 7.0) / f.mean_std for f in found])
    assert abs(pulls.mean()) < 0.2
    assert 0.9 < pulls.std() < 1.15
    drift_pulls = np.array([f.drift_per_s / f.drift_std_per_s for f in found])
    assert 0.9 < drift_pulls.std() < 1.15
    # White-noise arithmetic would be wrong by the root of 19 for a = 0.9.
    assert found[0].n_effective == pytest.approx(4000 * (1 - a) / (1 + a), rel=0.3)


def test_rest_is_let_pass_and_each_kind_of_motion_is_named():
    rng = np.random.default_rng(5)
    time_s = np.arange(3000) / RATE_HZ

    def said(extra, std=0.3):
        return unsteady(resting_mean(time_s, first_order(rng, 3000, 0.8, std) + extra), tolerance=0.5, unit="N")

    assert [said(0.0) for _ in range(100)].count("") >= 99
    assert "drifts by +2" in said(0.7 * time_s)
    assert "drifts by -2" in said(-0.7 * time_s)
    # Slow and back and forth: no drift over the whole, no rest either.
    assert "moves by" in said(1.5 * np.cos(2 * np.pi * time_s / 1.5))
    assert "vibrates" in said(10.0 * np.sin(2 * np.pi * 50.0 * time_s))


def test_a_drift_that_is_let_pass_widens_the_uncertainty():
    time_s = np.arange(3000) / RATE_HZ
    found = resting_mean(time_s, 0.1 * time_s)
    assert found.drift == pytest.approx(0.3, rel=0.01)
    assert found.std == pytest.approx(0.3 / np.sqrt(12), rel=0.01)


def test_too_few_samples_are_refused():
    with pytest.raises(InputError, match="too few"):
        resting_mean(np.arange(10) / RATE_HZ, np.zeros(10))
