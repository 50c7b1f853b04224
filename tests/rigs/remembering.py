"""A process that forgets from stroke to stroke, as the hardness of wood does."""

from __future__ import annotations

import numpy as np


def remembering(rng: np.random.Generator, memory: float, n: int) -> np.ndarray:
    """Stationary process of unit variance, shape (n,), whose neighbours correlate by `memory`."""
    found = rng.standard_normal(n)
    for k in range(1, n):
        found[k] = memory * found[k - 1] + np.sqrt(1.0 - memory**2) * found[k]
    return found
