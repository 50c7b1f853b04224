"""Dry friction at the motor shaft (bearings, brushes): torque tau_c sgn(w), whatever load and speed.

    J dw/dt = ... - tau_c sgn(w)

Told from windage by a speed sweep (it is flat), from guide friction by the crank angle (it does not follow
|sin|). Small brushed motors of this size: 2 to 10 mN*m of dry friction torque (no-load current times k_m;
assumed).
"""

from __future__ import annotations

import numpy as np

from diagnosis.effects.effect import Effect, Strength
from diagnosis.equations import Baseline, Signature
from diagnosis.state import State

# Below this motor speed the sign is smoothed, rad/s.
_SMOOTH_RAD_S = 5.0


def _signature(baseline: Baseline, state: State) -> tuple[Signature, ...]:
    return ({"mechanical": np.tanh(baseline.gear * state.speed_rad_s / _SMOOTH_RAD_S)},)


EFFECT = Effect(
    name="motor_coulomb_friction",
    place="mechanical",
    equation="tau_c * sgn(w) on the motor shaft",
    strength=Strength(name="torque_n_m", unit="N*m", typical=0.005, low=0.1, high=4.0, source="assumed"),
    signature=_signature,
    needs=("motor_current_a",),
    confused_with=("guide_friction", "windage_drag"),
    told_apart_by="idle runs at several speeds",
)
