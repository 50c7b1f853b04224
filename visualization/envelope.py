"""Fewer points, the same peaks: the envelope of a signal for the screen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.recording import Floats


def envelope_indices(time_s: Floats, values: Floats, *, max_rate_hz: float) -> NDArray[np.int64]:
    """Choose the samples that keep the outline of a signal at a bounded point rate.

    Time is cut into buckets of `2 / max_rate_hz`; of each bucket the smallest and the largest sample stay, at
    their own times. Every peak survives; what lies between two extremes of one bucket does not.

    Parameters
    ----------
    time_s : ndarray, shape (n,), s
        Non-decreasing.
    values : ndarray, shape (n,)
        Finite; any unit.
    max_rate_hz : float
        Points a second that may remain, greater than 0. A signal at or below this rate passes unchanged.

    Returns
    -------
    ndarray of int, shape (m,)
        Increasing indices into the input, m <= n.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = np.arange(8) / 8.0
    >>> envelope_indices(time_s, np.array([0.0, 5.0, 1.0, 2.0, 0.0, 0.5, -3.0, 0.2]), max_rate_hz=4.0)
    array([0, 1, 5, 6])
    """
    n = len(time_s)
    if n < 2 or (n - 1) <= max_rate_hz * float(time_s[-1] - time_s[0]) * (1.0 + 1e-9):
        return np.arange(n, dtype=np.int64)
    bucket = np.floor(time_s * (0.5 * max_rate_hz)).astype(np.int64)
    order = np.lexsort((values, bucket))
    is_first = np.r_[True, np.diff(bucket[order]) != 0]
    is_last = np.r_[is_first[1:], True]
    is_kept: NDArray[np.bool_] = np.logical_or(is_first, is_last)
    return np.unique(order[is_kept])
