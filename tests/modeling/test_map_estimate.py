"""The estimator itself, on models that are formulas."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.modeling.map_estimate import Parameters, most_probable

pytestmark = pytest.mark.unit


def parameters(n):
    ones = np.ones(n)
    return Parameters(
        names=tuple("abc"[:n]), start=ones, prior_mean=ones, prior_std=np.full(n, np.inf), step=1e-4 * ones,
        lower=-10.0 * ones, upper=10.0 * ones,
    )  # fmt: skip


def test_a_line_is_found():
    x = np.linspace(0.0, 1.0, 5)

    def line(rows):
        return rows[:, :1] + rows[:, 1:] * x, np.ones(len(rows), dtype=bool)

    found = most_probable(line, 2.0 + 3.0 * x, np.eye(5), parameters(2))
    assert found.is_valid and found.is_converged
    np.testing.assert_allclose(found.values, [2.0, 3.0], rtol=1e-6)


def test_a_parameter_on_which_nothing_depends_is_no_crash():
    def constant(rows):
        return np.repeat(rows[:, :1], 5, axis=1), np.ones(len(rows), dtype=bool)

    assert not most_probable(constant, np.arange(5.0), np.eye(5), parameters(2)).is_valid
