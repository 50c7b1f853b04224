"""Median and largest value of the samples around each, by numpy alone: a short command need not load scipy for them."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from sawbench.bench.recording import Floats


def median_of_five(values: Floats) -> Floats:
    """Median of each sample and its two neighbours on either side; the end samples count again beyond the ends.

    Parameters
    ----------
    values : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)

    Examples
    --------
    >>> median_of_five(np.array([1.0, 2.0, 90.0, 4.0, 3.0])).tolist()
    [1.0, 2.0, 3.0, 3.0, 3.0]
    """
    if not len(values):
        return values
    padded = np.pad(values, 2, mode="edge")
    a, b, c, d, e = (padded[k : k + len(values)] for k in range(5))
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))


def sliding_median(values: Floats, width: int) -> Floats:
    """Median over `width` samples, centred; for some thousand values, as every window is copied.

    Parameters
    ----------
    values : ndarray, shape (n,)
    width : int
        Odd.

    Returns
    -------
    ndarray, shape (n,)
        The end samples count again beyond the ends.

    Examples
    --------
    >>> sliding_median(np.array([1.0, 5.0, 2.0, 7.0]), 3).tolist()
    [1.0, 2.0, 5.0, 7.0]
    """
    half = width // 2
    windows = sliding_window_view(np.pad(values, half, mode="edge"), width).copy()
    windows.partition(half, axis=1)
    return windows[:, half]


def sliding_maximum(values: Floats, width: int) -> Floats:
    """Largest of `width` samples, centred; an even width reaches one sample further back.

    Parameters
    ----------
    values : ndarray, shape (n,)
    width : int

    Returns
    -------
    ndarray, shape (n,)
        The end samples count again beyond the ends.

    Examples
    --------
    >>> sliding_maximum(np.array([1.0, 5.0, 2.0, 0.0, 0.0]), 3).tolist()
    [5.0, 5.0, 5.0, 2.0, 0.0]
    """
    largest = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    reached = 1
    while reached < width:  # two windows side by side make one of up to twice the width
        step = min(reached, width - reached)
        largest = np.maximum(largest[:-step], largest[step:])
        reached += step
    return largest
