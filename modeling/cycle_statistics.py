"""Features of a mean stroke, and how many strokes they need."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
FEWEST_STROKES = 4


def fourier_basis(angle_rad: Floats, n_harmonics: int) -> Floats:
    """Orthonormal rows 1, cos(h a), sin(h a) over equally spaced bins.

    Parameters
    ----------
    angle_rad : ndarray, shape (n_bins,), rad
    n_harmonics : int
        Highest harmonic h, below n_bins / 2.

    Returns
    -------
    ndarray, shape (1 + 2 * n_harmonics, n_bins)
        `basis @ basis.T` is the identity.
    """
    rows = [np.full(len(angle_rad), 1.0 / np.sqrt(len(angle_rad)))]
    for harmonic in range(1, n_harmonics + 1):
        scale = np.sqrt(2.0 / len(angle_rad))
        rows += [scale * np.cos(harmonic * angle_rad), scale * np.sin(harmonic * angle_rad)]
    return np.array(rows)
