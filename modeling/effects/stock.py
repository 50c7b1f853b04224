"""How much of the blade is in the wood, against the stock for which a force is stated."""

from __future__ import annotations

from typing import Final

import numpy as np
from sawbench.modeling.state import State

UNIT_M: Final = 0.02
_K_UNIT_N_S_PER_M = 240.0


def stock_share(state: State) -> float:
    """Thickness over 20 mm: that many more teeth cut, at any wood.

    Where nobody stated the thickness, the cutting coefficient over 240 N*s/m stands for it.
    """
    thickness_m = state.setting.thickness_m
    if np.isfinite(thickness_m) and thickness_m > 0.0:
        return thickness_m / UNIT_M
    return state.k_guess_n_s_per_m / _K_UNIT_N_S_PER_M
