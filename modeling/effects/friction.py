"""Laws of dry friction on a velocity, for whatever guide: how hard it grips, and which way it points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from sawbench.bench.recording import Floats

if TYPE_CHECKING:
    from sawbench.modeling.machines.linear_axis import AxisState

# Below this share of the cycle's top speed the sign of the velocity is smoothed.
_SMOOTH_SHARE: Final = 0.01
# Presliding: friction turns round over a distance (Dahl 1968), here as a share of the stroke; 0 is Coulomb's law.
PRESLIDING: Final = (0.0, 0.002, 0.004, 0.007, 0.012, 0.02, 0.035, 0.06, 0.1)


def stribeck(speed_m_s: Floats, static_ratio: float, stribeck_m_s: float) -> Floats:
    """Friction over kinetic friction at a speed: static_ratio at standstill, 1 far above `stribeck_m_s`.

    Examples
    --------
    >>> stribeck(np.array([0.0, 10.0]), 1.5, 0.1).tolist()
    [1.5, 1.0]
    """
    return 1.0 + (static_ratio - 1.0) * np.exp(-((speed_m_s / stribeck_m_s) ** 2))


def direction(state: AxisState, presliding_m: float) -> Floats:
    """Direction of the friction force, -1..1, over the cycle; shape of the state.

    dz/dx = (sgn(v) - z) / presliding_m (Dahl): without presliding the smoothed sign of the velocity.
    """
    if presliding_m <= 0.0:
        top = np.abs(state.velocity_m_s).max(axis=1, keepdims=True)
        return np.tanh(state.velocity_m_s / (_SMOOTH_SHARE * top))
    step = np.diff(state.position_m, axis=1, prepend=state.position_m[:, -1:])
    keep, sign = np.exp(-np.abs(step) / presliding_m), np.sign(step)
    out, z = np.zeros_like(step), np.zeros(len(step))
    for _ in range(2):  # the second time round the cycle is periodic
        for k in range(step.shape[1]):
            z = sign[:, k] + (z - sign[:, k]) * keep[:, k]
            out[:, k] = z
    return out
