"""Stretches in which a mask holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def run_ends(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """First element, and one past the last, of every stretch in which a mask holds.

    Parameters
    ----------
    mask : ndarray of bool, shape (n,)

    Returns
    -------
    first, end : ndarray, shape (n_runs,)

    Examples
    --------
    >>> [ends.tolist() for ends in run_ends(np.array([True, True, False, True]))]
    [[0, 3], [2, 4]]
    """
    edges = np.flatnonzero(np.diff(np.r_[False, mask, False]))
    return edges[::2], edges[1::2]
