"""Averages of likelihoods that are kept as logarithms."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from sawbench.bench.recording import Floats


def log_mean_exp_rows(logs: Floats) -> Floats:
    """`log_mean_exp` of every row, shape (k, n) -> (k,)."""
    top = logs.max(axis=1)
    return top + np.log(np.mean(np.exp(logs - top[:, None]), axis=1))


def log_mean_exp(logs: ArrayLike) -> float:
    """Logarithm of the mean of exp(logs), without overflow.

    Parameters
    ----------
    logs : array_like, shape (n,)

    Examples
    --------
    >>> round(log_mean_exp([1000.0, 1000.0]), 6)
    1000.0
    """
    values = np.asarray(logs, dtype=np.float64)
    top = float(values.max())
    return top + float(np.log(np.mean(np.exp(values - top))))
