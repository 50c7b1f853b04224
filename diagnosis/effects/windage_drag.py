"""Air drag of fan and rotor: torque c w^2 at the motor.

    J dw/dt = ... - tau_1000 (w / 1000 rad/s)^p,  p = 2 (laminar gaps and recirculation: 1.6 to 2.4)

Positive amplitude: the motor needs more current than the baseline says, the more the faster. Told from
viscous and Coulomb friction by a speed sweep in air. Fans of hand tools take 1 to 10 W of shaft power near
1000 rad/s, that is 1 to 10 mN*m: assumed.
"""

from __future__ import annotations

import numpy as np

from diagnosis.effects.effect import Effect, Strength
from diagnosis.equations import Baseline, Signature
from diagnosis.state import State

_REFERENCE_RAD_S = 1000.0


def _signature(baseline: Baseline, state: State, power: float) -> tuple[Signature, ...]:
    speed = baseline.gear * state.speed_rad_s / _REFERENCE_RAD_S
    return ({"mechanical": np.sign(speed) * np.abs(speed) ** power},)


EFFECT = Effect(
    name="windage_drag",
    place="mechanical",
    equation="c * w^2 on the motor shaft",
    strength=Strength(name="torque_at_1000_rad_s_n_m", unit="N*m", typical=0.006, low=0.1, high=4.0, source="assumed"),
    signature=_signature,
    shapes=tuple({"power": p} for p in (2.0, 1.6, 1.8, 2.2, 2.4)),
    needs=("motor_current_a",),
    grows_with=("speed",),
    confused_with=("motor_coulomb_friction", "guide_friction"),
    told_apart_by="idle runs at several speeds",
)
