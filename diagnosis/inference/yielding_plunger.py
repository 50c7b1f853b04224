"""Pins and bearings between crank and plunger that yield: it is behind the crank by the force over a stiffness.

The angle of the crank is told from the plunger, so that the motor seems to be ahead of it while the blade cuts. A
linear cut holds the plunger back by an angle that is even over the cutting half, and is none on the way back: its edges
lie at the dead centres, where the torque of inertia shows them. Some hundredths of a millimetre are ordinary, and no
gap of the saw. What yields by far more is play of the yoke or a shaft that twists (`diagnosis.inference.beyond.drive`).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from sawbench.diagnosis.inference.nuisance import Nuisance
from sawbench.modeling.residuals import Baseline, Signature, is_angle_known, motor_ahead
from sawbench.modeling.state import State, angle_derivative

# Assumed: 5 N a micrometre, of pin, bearings and guide one behind the other.
_STD_M_PER_N: Final = 2e-7
# In radii: this close to its dead centre the motion of a plunger tells little of the crank, and edges are rounded.
_NEAR_DEAD_CENTRE: Final = 0.2


def yielding_plunger() -> Nuisance:
    """Return what a plunger that yields may take off the balances, in m/N."""
    return Nuisance(
        name="compliance of the plunger's drive",
        nominal=0.0,
        std=_STD_M_PER_N,
        is_plant=False,
        signature=_held_back,
    )


def _held_back(baseline: Baseline, state: State) -> Signature:
    if state.kind != "running" or state.force_n is None or not is_angle_known(state):
        return {}
    lever = baseline.cutting_sign * baseline.lever(state)
    cutting = np.maximum(lever, 0.0)
    per_lever = np.sum(state.force_n * cutting, axis=-1) / np.sum(cutting**2, axis=-1)
    is_cutting = 0.5 * (1.0 + np.tanh(lever / (_NEAR_DEAD_CENTRE * baseline.radius_m)))
    behind_rad = per_lever[..., None] * is_cutting
    speed = baseline.gear * state.speed_rad_s * angle_derivative(behind_rad)
    return motor_ahead(baseline, speed, state.speed_rad_s * angle_derivative(speed))
