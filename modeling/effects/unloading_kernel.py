"""A spring that cannot pull: its force from point to point, until the stroke repeats itself."""

from __future__ import annotations

import numpy as np
from sawbench.modeling.compilation import kernel

_TURNS_TO_SETTLE = 3


@kernel()
def settled(rise, keep):
    """Periodic F[k] = max(rise[k] + keep[k] F[k - 1], 0) of every row, from a start at 0.

    Parameters
    ----------
    rise, keep : ndarray, shape (n_rows, n_points)

    Returns
    -------
    ndarray, shape (n_rows, n_points)
    """
    force = np.zeros_like(rise)
    for row in range(rise.shape[0]):
        now = 0.0
        for _ in range(_TURNS_TO_SETTLE):
            for k in range(rise.shape[1]):
                now = max(rise[row, k] + keep[row, k] * now, 0.0)
                force[row, k] = now
    return force
