"""Brushes take a voltage that hardly depends on the current: V sgn(i), 0.5 to 1.5 V for the pair.

    L di/dt = U - R i - k_e w - V tanh(i / i_0)

Positive amplitude: a constant voltage is missing at every duty. Below i_0 the drop turns ohmic. A diode
drop shrinks with duty, resistance grows with current. The form, ohmic at small current and flat above, is
that of Modelica.Electrical.Machines.Losses.DCMachines.Brush; a part of a contact's voltage may go on rising with
the logarithm of the current, ln(1 + i/i_0) / ln(1 + 10 A/i_0), or fall with it, as carbon does that gets hot. V is
that at 10 A. Range: assumed.
"""

from __future__ import annotations

from sawbench.modeling.effects.contact import contact_voltage
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State


def _signature(baseline: Baseline, state: State, knee_a: float, rise: float) -> tuple[Signature, ...]:
    if state.current_a is None:
        return ({},)
    return ({"electrical": contact_voltage(state.current_a, knee_a, rise)},)


EFFECT = Effect(
    name="brush_voltage_drop",
    place="electrical",
    equation="V * sgn(i) in the armature circuit",
    words=Words(
        happens="constant voltage drop across the brushes",
        measure="the voltage across the stalled motor at several small currents, extrapolated to zero",
        mend="check brushes and commutator",
    ),
    parts=("motor",),
    strength=Strength(name="voltage_v", unit="V", typical=0.8, low=0.1, high=3.0, source="assumed"),
    signature=_signature,
    shapes=tuple(
        {"knee_a": knee, "rise": rise} for rise in (0.0, 0.03, 0.3, 1.0, -0.3) for knee in (0.1, 0.3, 1.0, 3.0)
    ),
    continuous=("knee_a", "rise"),
    needs=("motor_current_a", "battery_voltage_v"),
    confused_with=("converter_diode_drop", "winding_heating"),
    told_apart_by="trials at several duties, idle and loaded",
)
