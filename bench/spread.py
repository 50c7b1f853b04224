"""Scatter as most of the values show it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# Standard deviation of a normal distribution about zero over the median of its absolute values.
STD_OVER_MEDIAN: Final = 1.4826


def robust_std(deviations: ArrayLike) -> float:
    """Standard deviation of deviations from their middle, which up to half of them may spoil.

    Parameters
    ----------
    deviations : array_like

    Examples
    --------
    >>> robust_std([-1.0, 1.0, -1.0, 50.0])
    1.4826
    """
    return STD_OVER_MEDIAN * float(np.median(np.abs(deviations)))


def jackknife_std(without_one: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard error of an estimate from its values without each of n groups in turn.

    Efron, Tibshirani, An Introduction to the Bootstrap, 11.

    Parameters
    ----------
    without_one : ndarray, shape (n, ...)

    Returns
    -------
    ndarray, shape (...)

    Examples
    --------
    >>> values = np.array([3.0, 5.0, 8.0, 12.0])
    >>> without_one = (values.sum() - values) / 3
    >>> bool(np.isclose(jackknife_std(without_one), values.std(ddof=1) / 2.0))
    True
    """
    n = len(without_one)
    return np.sqrt((n - 1) / n * np.sum((without_one - without_one.mean(axis=0)) ** 2, axis=0))
