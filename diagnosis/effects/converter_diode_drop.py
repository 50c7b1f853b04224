"""The free-wheeling diode conducts while the switch is off: U = duty V_b - V_f (1 - duty).

    L di/dt = duty V_b - V_f (1 - duty) - R i - k_e w,   while i > 0

Positive amplitude: voltage is missing, most at low duty. Dead time adds a part that is the same at every
duty (second form: 0.3 of V_f). A brush drop is the same at every duty. Forward voltage: 0.4 V (Schottky) to
1.2 V (silicon), assumed.
"""

from __future__ import annotations

import numpy as np

from diagnosis.effects.effect import Effect, Strength
from diagnosis.equations import Baseline, Signature
from diagnosis.state import State

_CONDUCTS_FROM_A = 0.2


def _signature(baseline: Baseline, state: State, dead_share: float) -> tuple[Signature, ...]:
    if state.current_a is None:
        return ({},)
    conducts = np.clip(state.current_a / _CONDUCTS_FROM_A, 0.0, 1.0)
    return ({"electrical": (1.0 - state.setting.duty + dead_share) * conducts},)


EFFECT = Effect(
    name="converter_diode_drop",
    place="electrical",
    equation="U = duty * V_b - V_f * (1 - duty)",
    strength=Strength(
        name="forward_voltage_v",
        unit="V",
        typical=0.7,
        low=0.1,
        high=3.0,
        source="assumed; Schottky to silicon",
    ),
    signature=_signature,
    shapes=({"dead_share": 0.0}, {"dead_share": 0.3}),
    needs=("motor_current_a", "battery_voltage_v"),
    confused_with=("brush_voltage_drop",),
    told_apart_by="trials at several duties",
)
