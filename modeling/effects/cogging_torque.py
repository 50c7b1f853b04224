"""The rotor's slots snap to the magnets: torque a sin(slots phi_motor + psi), phi_motor = gear * crank angle.

    J dw/dt = ... - a sin(slots * gear * angle + psi)

Position-locked to the motor's angle: it takes no power over a turn, whatever load and speed, where friction does.
Free phase: sine and cosine part. Where slots times gear is a whole number it repeats with the stroke; otherwise the
mean over strokes leaves nothing of it, and a recorded start alone can show it. Behind a gear of 9 it swings 30 to 130
times a stroke, faster than the rotor follows and than any harmonic that is compared: there it is not found. Small
brushed motors have 3 to 14 slots, the usual numbers here; 1 to 24 mN*m, some per cent of their torque: assumed.
"""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

# So near to a whole number of cycles a stroke, it keeps its phase for as long as a trial lasts.
_LOCKED = 1e-4
_SLOTS = (3.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 14.0)


def _signature(baseline: Baseline, state: State, slots: float) -> tuple[Signature, ...]:
    order = slots * baseline.gear
    if state.kind == "running":
        is_locked = abs(order - round(order)) < _LOCKED
        if not is_locked or order > state.angle_rad.shape[-1] / 2:
            return {}, {}
        order = round(order)
    phase = order * state.angle_rad
    return {"mechanical": np.sin(phase)}, {"mechanical": np.cos(phase)}


EFFECT = Effect(
    name="cogging_torque",
    place="mechanical",
    equation="a * sin(slots * gear * angle + psi) on the motor shaft",
    words=Words(
        happens="cogging torque between the slots and the magnets of the motor",
        measure="the torque needed to turn the uncoupled motor slowly by hand: one period per slot",
        mend="no fault; keep it in the model, or use a motor with skewed slots",
    ),
    parts=("motor", "gear", "crank"),
    strength=Strength(
        name="torque_n_m",
        unit="N*m",
        typical=0.006,
        low=0.2,
        high=8.0,
        source="assumed",
        follows=lambda load: load.torque_n_m,
    ),
    signature=_signature,
    n_signatures=lambda shape: 2,
    shapes=tuple({"slots": slots} for slots in _SLOTS),
    needs=("motor_current_a",),
    grows_with=("position",),
    confused_with=("gear_eccentricity", "motor_coulomb_friction"),
    told_apart_by="idle runs at several speeds: the same number of cycles per stroke at each, slots times gear ratio",
)
