"""A tall matrix most of which is zero, as nuisances are that each belong to one trial."""

from __future__ import annotations

from typing import Final

import numpy as np
from sawbench.bench.recording import Floats

# Rows that are looked at together: those of half a trial.
_STRETCH: Final = 256


class Patchwork:
    """Stretches of rows, each with the columns that are not zero there: the products leave the others out.

    Parameters
    ----------
    matrix : ndarray, shape (n, p)

    Examples
    --------
    >>> own = np.kron(np.eye(3), np.ones((300, 1)))
    >>> Patchwork(own).transposed_times(np.arange(900.0)).tolist() == (own.T @ np.arange(900.0)).tolist()
    True
    """

    def __init__(self, matrix: Floats) -> None:
        self.shape: tuple[int, int] = matrix.shape
        self._patches = []
        for start in range(0, len(matrix), _STRETCH):
            rows = slice(start, start + _STRETCH)
            columns = np.flatnonzero(matrix[rows].any(axis=0))
            self._patches.append((rows, columns, matrix[rows, columns]))

    def transposed_times(self, other: Floats) -> Floats:
        """Inner products of the columns with others, shape (n,) or (n, q)."""
        found = np.zeros((self.shape[1], *other.shape[1:]))
        for rows, columns, patch in self._patches:
            found[columns] += patch.T @ other[rows]
        return found

    def times(self, weights: Floats) -> Floats:
        """Weighted sum of the columns, weights of shape (p,) or (p, q)."""
        found = np.zeros((self.shape[0], *weights.shape[1:]))
        for rows, columns, patch in self._patches:
            found[rows] = patch @ weights[columns]
        return found
