"""Causes of simple form that the catalogue does not hold: where one of them wins, the verdict is "unknown".

A catalogue that is bent to the nearest cause would name play where the displacement sensor is bent, and dry
friction where grease warms up. These forms are weighed beside the free discrepancy, so that what they explain
better than any effect of the catalogue is left to nobody.
"""

from __future__ import annotations

import numpy as np

from diagnosis.effects.effect import Effect, Strength
from diagnosis.effects.yoke_backlash import swing
from diagnosis.equations import Baseline, Signature
from diagnosis.state import State

_N_BENT_HARMONICS = 4
_BENT_RAD = 0.03
# The torque of viscous friction is stated at this speed of the motor.
_UNIT_RAD_S = 1000.0


def _bent_displacement(baseline: Baseline, state: State) -> tuple[Signature, ...]:
    """The angle is read wrong by one smooth wave, the same in air and under load: harmonics that fall fast."""
    if state.kind != "running":
        return tuple({} for _ in range(2 * _N_BENT_HARMONICS))
    waves = [f(k * state.angle_rad) / k**2 for k in range(1, _N_BENT_HARMONICS + 1) for f in (np.cos, np.sin)]
    return tuple(swing(baseline, state, wave) for wave in waves)


def _warming_friction(
    baseline: Baseline, state: State, time_constant_s: float, viscous: float
) -> tuple[Signature, ...]:
    """Friction that falls while the machine runs and is back after a rest: stiff grease, cold bearings."""
    cold = np.exp(-np.broadcast_to(state.time_s, state.angle_rad.shape) / time_constant_s)
    speed = baseline.gear * state.speed_rad_s
    return ({"mechanical": cold * (speed / _UNIT_RAD_S if viscous else np.ones_like(speed))},)


BENT_DISPLACEMENT = Effect(
    name="bent displacement sensor",
    place="sensing",
    equation="angle read off the displacement is wrong by one smooth wave",
    strength=Strength(name="swing_rad", unit="rad", typical=_BENT_RAD, low=0.1, high=5.0, source="assumed"),
    signature=_bent_displacement,
)
WARMING_FRICTION = Effect(
    name="friction that falls as the machine warms up",
    place="mechanical",
    equation="tau * exp(-t / T) on the motor shaft, again after each rest",
    strength=Strength(name="torque_n_m", unit="N*m", typical=0.005, low=0.2, high=4.0, source="assumed"),
    signature=_warming_friction,
    shapes=tuple(
        {"time_constant_s": float(tau), "viscous": viscous} for tau in (3.0, 10.0, 30.0) for viscous in (0.0, 1.0)
    ),
)
BEYOND_CATALOGUE = (BENT_DISPLACEMENT, WARMING_FRICTION)
