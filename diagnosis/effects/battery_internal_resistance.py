"""The battery has more resistance than stated: V_b = E(soc) - (R_b + dR) i_b.

Positive amplitude: the voltage dips with the current at once (supply residual -dR i_b), in every stroke and
at spin-up. Polarization dips late and recovers at rest. Five 18650 cells in series with leads, contacts and
age: 0.05 to 0.15 Ohm against 0.02 stated (15 to 30 mOhm a cell): assumed.
"""

from __future__ import annotations

from diagnosis.effects.effect import Effect, Strength
from diagnosis.equations import Baseline, Signature
from diagnosis.state import State


def _signature(baseline: Baseline, state: State) -> tuple[Signature, ...]:
    if state.battery_current_a is None:
        return ({},)
    return ({"supply": -state.battery_current_a},)


EFFECT = Effect(
    name="battery_internal_resistance",
    place="supply",
    equation="V_b = E(soc) - (R_b + dR) * i_b",
    strength=Strength(name="extra_resistance_ohm", unit="Ohm", typical=0.04, low=0.1, high=4.0, source="assumed"),
    signature=_signature,
    needs=("battery_voltage_v", "battery_current_a"),
    grows_with=("load",),
    confused_with=("battery_polarization",),
    told_apart_by="a recorded start-up: a step of the current and the voltage's answer at once",
)
