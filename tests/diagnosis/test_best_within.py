"""Sizes of columns that may be small alone: the likeliest ones within their limits."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.diagnosis.inference.marginal import best_within

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("scale", [0.3, 3.0, 300.0])
def test_no_size_within_the_limits_is_likelier(scale):
    """The slope of the log probability is 0 where a size is free, and points out of the limits where it is at one."""
    rng = np.random.default_rng(8)
    columns = scale * rng.normal(size=(400, 30)) @ rng.normal(size=(30, 30))  # far from orthogonal
    limits = np.full(30, 1.5)
    limits[:3] = np.inf
    gram, moment = columns.T @ columns, columns.T @ (columns @ rng.normal(size=30) * 2.0 + rng.normal(size=400))
    found = best_within(gram, moment, limits)
    assert np.all(np.abs(found) <= limits)
    slope = moment - gram @ found - found
    is_at_limit = np.abs(found) > 0.999 * limits
    assert 0 < is_at_limit.sum() < 27
    assert np.abs(slope[~is_at_limit]).max() < 1e-5 * np.abs(moment).max()
    assert np.all(slope[is_at_limit] * found[is_at_limit] > 0.0)


def test_without_limits_that_matter_it_is_the_free_fit():
    gram, moment = np.array([[3.0, 2.0], [2.0, 3.0]]), np.array([6.0, 6.0])
    assert best_within(gram, moment, np.full(2, 5.0)) == pytest.approx(np.linalg.solve(gram + np.eye(2), moment))
