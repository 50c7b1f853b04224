"""The one-standard-error rule."""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats


def exceeds_its_error(gains: Floats) -> bool:
    """Whether the sum of paired gains exceeds its own standard error: below, the simpler of two models is kept.

    The one-standard-error rule of cross-validation (Hastie, Tibshirani, Friedman, The Elements of Statistical
    Learning, 7.10).

    Parameters
    ----------
    gains : ndarray, shape (n,)
        Of one model over another one, a withheld group each; at least two.

    Examples
    --------
    >>> import numpy as np
    >>> exceeds_its_error(np.array([1.0, 2.0, 1.5])), exceeds_its_error(np.array([6.0, -2.0, -3.0]))
    (True, False)
    """
    return float(gains.sum()) > std_of_sum(gains)


def std_of_sum(values: Floats) -> float:
    """Standard error of the sum of values that scatter independently.

    Parameters
    ----------
    values : ndarray, shape (n,)
        At least two.

    Examples
    --------
    >>> round(std_of_sum(np.array([1.0, 3.0, 2.0, 2.0])), 6)
    1.632993
    """
    return float(np.sqrt(len(values)) * values.std(ddof=1))
