"""What a hypothesis leaves of the gap, by the noise as it was measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal, side_by_side
from sawbench.diagnosis.inference.settings import SETTINGS


def left_over(
    problem: LinearProblem, dispersion: Floats, marginal: Marginal, explanation: Explanation | None = None
) -> float:
    """Misfit over the number of features, whitened by the noise as it was measured.

    The squares of the residual and of the nuisances, each over its variance. Never negative: the product of data and
    residual is the same for one common noise alone.

    Parameters
    ----------
    problem : LinearProblem
        Whitened with dispersion.
    dispersion : ndarray, shape (n,)
    marginal : Marginal
        Nuisances that take up what they can.
    explanation : Explanation, optional
        An effect whose contribution is taken off first.
    """
    return left_over_by_each(problem, dispersion, marginal, [explanation])[0]


def left_over_by_each(
    problem: LinearProblem, dispersion: Floats, marginal: Marginal, explanations: Sequence[Explanation | None]
) -> list[float]:
    """`left_over` where the contribution of one effect is taken off, for each of several, in one pass."""
    left = np.empty((len(explanations), len(problem.data)))
    for row, explanation in zip(left, explanations, strict=True):
        row[:] = problem.data if explanation is None else problem.data - explanation.contribution
    best, rest = marginal.split(left.T)
    return [float(dispersion @ r**2 + b @ b) / len(r) for b, r in zip(best.T, rest.T, strict=True)]


def left_by(problem: LinearProblem, dispersion: Floats, nominal: Marginal, members: Sequence[Explanation]) -> float:
    """`left_over` by several effects, each of the size that fits best beside the others.

    Parameters
    ----------
    problem : LinearProblem
    dispersion : ndarray, shape (n,)
    nominal : Marginal
        Nuisances without any of them.
    members : sequence of Explanation
    """
    given = [member.column.of_any_size for member in members]
    return left_over(problem, dispersion, nominal.beside(side_by_side(given, len(problem.data))))


def log_density_of_left(share: Floats | float) -> Floats | float:
    """Logarithm of the density of the share of a gap that the right cause leaves: exponential.

    Parameters
    ----------
    share : float or ndarray
    """
    mean = SETTINGS.ladder.left_by_the_right / np.log(10.0)
    return -share / mean - np.log(mean)
