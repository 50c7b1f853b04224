"""Standard uncertainty of means of autocorrelated series, against theory."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.correlated import autocorrelation_time, std_of_mean
from sawbench.bench.errors import InputError

pytestmark = pytest.mark.unit


def ar1(rng, n, rho):
    series = np.empty(n)
    value = rng.normal()
    for k in range(n):
        series[k] = value
        value = rho * value + np.sqrt(1 - rho**2) * rng.normal()
    return series


@pytest.mark.parametrize("rho", [0.0, 0.4, 0.7])
def test_autocorrelation_time_of_a_first_order_process(rho):
    rng = np.random.default_rng(11)
    found = np.mean([autocorrelation_time(ar1(rng, 2000, rho)) for _ in range(20)])
    assert found == pytest.approx((1 + rho) / (1 - rho), rel=0.12)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, -0.5])
def test_autocorrelation_time_of_many_values(rho):
    values = ar1(np.random.default_rng(3), 60000, rho)
    assert autocorrelation_time(values, may_alternate=True) == pytest.approx((1 + rho) / (1 - rho), rel=0.15)


@pytest.mark.parametrize(("n", "rho"), [(2, 0.0), (3, 0.0), (12, 0.0), (60, 0.0), (100, 0.5)])
def test_interval_of_the_mean_covers(n, rho):
    rng = np.random.default_rng(12)
    held = 0
    n_series = 600
    for _ in range(n_series):
        series = ar1(rng, n, rho)
        held += abs(series.mean()) <= 1.96 * std_of_mean(series)[0]
    assert 0.92 <= held / n_series <= 0.98


@pytest.mark.parametrize("n", [12, 150, 3000])
def test_the_mean_of_a_trend_is_as_certain_as_a_value_within_its_range(n):
    """A rectangle of full width 2 has the standard deviation 1/sqrt(3)."""
    rng = np.random.default_rng(n)
    falling = np.linspace(1.0, -1.0, n)
    assert std_of_mean(falling)[0] == pytest.approx(1.0 / np.sqrt(3.0), rel=1e-9)
    assert std_of_mean(falling + 0.01 * rng.standard_normal(n))[0] == pytest.approx(1.0 / np.sqrt(3.0), rel=0.05)


def test_two_values_are_as_uncertain_as_student_says():
    assert std_of_mean([0.0, 1.0])[0] == pytest.approx(0.5 * 12.7062 / 1.95996, rel=1e-4)


def test_constant_series_has_no_scatter_and_a_single_value_is_refused():
    assert std_of_mean(np.ones(10))[0] == 0.0
    with pytest.raises(InputError, match="not enough"):
        std_of_mean([1.0])
