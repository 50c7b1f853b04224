"""The free-wheeling diode conducts while the switch is off: U = duty V_b - V_f (1 - duty).

    L di/dt = duty V_b - V_f (1 - duty) - R i - k_e w,   while i > 0

Positive amplitude: voltage is missing, most at low duty. Dead time adds a part that is the same at every
duty (0.3 of V_f). The forward voltage is constant, ohmic below a knee, follows the diode's law,
V_f = n V_T ln(1 + i/i_s), lies between, or is ohmic almost throughout (knee of 30 A: its leads, or a switch in
its place); each scaled to 1 at 10 A, so V_f is that at 10 A. A brush drop is the same at every duty. Forward voltage:
0.4 V (Schottky) to 1.2 V (silicon), assumed.
"""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.contact import contact_voltage
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State


def _signature(
    baseline: Baseline, state: State, dead_share: float, knee_a: float, rise: float
) -> tuple[Signature, ...]:
    if state.current_a is None:
        return ({},)
    forward = contact_voltage(np.maximum(state.current_a, 0.0), knee_a, rise)
    return ({"electrical": (1.0 - state.setting.duty + dead_share) * forward},)


EFFECT = Effect(
    name="converter_diode_drop",
    place="electrical",
    equation="U = duty * V_b - V_f * (1 - duty)",
    words=Words(
        happens="voltage loss of the converter during the off time",
        measure="the motor voltage with an oscilloscope while the switch is off",
        mend="check diode and dead time of the converter",
    ),
    parts=("converter",),
    strength=Strength(
        name="forward_voltage_v",
        unit="V",
        typical=0.7,
        low=0.1,
        high=3.0,
        source="assumed; Schottky to silicon",
    ),
    signature=_signature,
    shapes=tuple(
        {"dead_share": dead, "knee_a": knee, "rise": rise}
        for dead in (0.0, 0.3)
        for rise, knees in (
            (0.0, (0.1, 0.3, 1.0, 3.0, 30.0)),
            (0.03, (0.1, 0.3, 1.0)),
            (0.3, (0.1, 0.3, 1.0)),
            (1.0, (0.03, 0.1, 0.3, 1.0, 1.5)),
        )
        for knee in knees
    ),
    continuous=("knee_a", "dead_share", "rise"),
    needs=("motor_current_a", "battery_voltage_v"),
    confused_with=("brush_voltage_drop",),
    told_apart_by="trials at several duties",
)
