"""Laws of dry friction, for whatever guide: how hard it grips, which way it points, and how play lets it be felt."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
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

    def dahl(z: float, travel_m: Floats) -> Floats:
        sign = np.sign(travel_m[-1])
        return sign + (z - sign) * np.exp(-np.abs(travel_m) / presliding_m)

    return _along(state, dahl)


def through_play(state: AxisState, gap_m: float, spring_m: float) -> Floats:
    """Dry friction felt through play and a spring in series with it, over its own size, -1..1; shape of the state.

    After a reversal the spring lets go over `spring_m`, nothing is felt across `gap_m`, and the spring is wound up
    over `spring_m` again until the friction slips.
    """
    most_m = 0.5 * gap_m + spring_m

    def stretched(stretch_m: float, travel_m: Floats) -> Floats:
        return np.clip(stretch_m + travel_m, -most_m, most_m)

    stretch_m = _along(state, stretched)
    return np.sign(stretch_m) * np.maximum(np.abs(stretch_m) - 0.5 * gap_m, 0.0) / spring_m


def _along(state: AxisState, law: Callable[[float, Floats], Floats]) -> Floats:
    """Follow something that remembers along the path: (value before, travel since then in one direction) -> values.

    A cycle is run through twice: the second time it is periodic. Any other motion begins at 0.
    """
    out = np.zeros_like(state.position_m)
    for row, position_m in enumerate(state.position_m):
        path = np.concatenate([position_m[-1:], position_m, position_m]) if state.is_cyclic else position_m
        step = np.sign(np.diff(path))
        turns = [0, *(np.flatnonzero(step[1:] != step[:-1]) + 1).tolist(), len(step)]
        values, value = np.zeros(len(path)), 0.0
        for start, end in pairwise(turns):
            if step[start] != 0.0:
                values[start + 1 : end + 1] = law(value, path[start + 1 : end + 1] - path[start])
                value = float(values[end])
            else:
                values[start + 1 : end + 1] = value
        out[row] = values[-len(position_m) :]
    return out
