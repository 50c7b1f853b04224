"""With what of the workpiece a force grows that does not come from the speed, against the stock it is stated for."""

from __future__ import annotations

from typing import Final

import numpy as np
from sawbench.modeling.state import State

UNIT_M: Final = 0.02
K_UNIT_N_S_PER_M: Final = 240.0
# The same in every stock; with its thickness, as more teeth cut; with its cutting coefficient, as harder wood resists.
ALIKE, BY_THICKNESS, BY_COEFFICIENT = 0.0, 1.0, 2.0
WAYS: Final = (ALIKE, BY_THICKNESS, BY_COEFFICIENT)


def stock_share(state: State, by_stock: float) -> float:
    """Force in the stock of a trial over that in the stock for which it is stated: 20 mm, or 240 N*s/m.

    Where nobody stated the thickness, the cutting coefficient stands for it.

    Parameters
    ----------
    state : State
    by_stock : float
        One of `WAYS`.
    """
    if by_stock == ALIKE:
        return 1.0
    thickness_m = state.setting.thickness_m
    if by_stock == BY_THICKNESS and np.isfinite(thickness_m) and thickness_m > 0.0:
        return thickness_m / UNIT_M
    return state.k_guess_n_s_per_m / K_UNIT_N_S_PER_M
