"""Dry friction at the motor shaft (bearings, brushes): torque tau_c sgn(w), whatever load and speed.

    J dw/dt = ... - tau_c sgn(w) (1 + (s - 1) exp(-(w/w_s)^2))

Positive amplitude: the motor needs more current than the baseline says. Told from windage by a speed sweep
(it is flat), from guide friction by the crank angle (it does not follow |sin|). The breakaway part (s > 1)
shows at the very start only. Small brushed motors of this size: 2 to 10 mN*m of dry friction torque
(no-load current times k_m; assumed).
"""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

# Below this motor speed the sign is smoothed; breakaway fades with the other one. rad/s.
_SMOOTH_RAD_S = 5.0
_STRIBECK_RAD_S = 60.0


def _signature(baseline: Baseline, state: State, static_ratio: float) -> tuple[Signature, ...]:
    speed = baseline.gear * state.speed_rad_s
    breakaway = (static_ratio - 1.0) * np.exp(-((speed / _STRIBECK_RAD_S) ** 2))
    return ({"mechanical": np.tanh(speed / _SMOOTH_RAD_S) * (1.0 + breakaway)},)


EFFECT = Effect(
    name="motor_coulomb_friction",
    place="mechanical",
    equation="tau_c * sgn(w) on the motor shaft",
    words=Words(
        happens="the motor drags at every speed",
        measure="the no-load current of the uncoupled motor at several voltages",
        mend="check brushes, bearings and seals of the motor",
    ),
    parts=("motor",),
    strength=Strength(
        name="torque_n_m",
        unit="N*m",
        typical=0.005,
        low=0.1,
        high=8.0,
        source="assumed",
        follows=lambda load: load.torque_n_m,
    ),
    signature=_signature,
    shapes=({"static_ratio": 1.0}, {"static_ratio": 1.6}),
    needs=("motor_current_a",),
    confused_with=("guide_friction", "windage_drag"),
    told_apart_by="idle runs at several speeds",
)
