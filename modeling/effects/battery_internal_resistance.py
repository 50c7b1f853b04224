"""The battery has more resistance than stated: V_b = E(soc) - (R_b + dR) i_b.

Positive amplitude: the voltage dips with the current at once (supply residual -dR i_b), in every stroke and
at spin-up. Polarization dips late and recovers at rest. A cell's resistance rises as it empties: forms
dR * soc^-q, q = 0 to 2, and dR * (1 + g (1 - soc)). Five 18650 cells in series with leads, contacts and
age: 0.05 to 0.15 Ohm against 0.02 stated (15 to 30 mOhm a cell): assumed.
"""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State


def _signature(baseline: Baseline, state: State, power: float = 0.0, growth: float = 0.0) -> tuple[Signature, ...]:
    if state.battery_current_a is None or baseline.battery is None:
        return ({},)
    soc = np.clip(1.0 - state.charge_used_as / (3600.0 * baseline.battery.capacity_ah), 0.05, 1.0)
    return ({"supply": -state.battery_current_a * (soc**-power + growth * (1.0 - soc))},)


EFFECT = Effect(
    name="battery_internal_resistance",
    place="supply",
    equation="V_b = E(soc) - (R_b + dR) * i_b",
    words=Words(
        happens="the battery has more resistance than stated",
        measure="the voltage just before and 10 ms after a known load is switched on",
        mend="measure the battery's resistance, its leads and contacts",
    ),
    parts=("battery",),
    strength=Strength(
        name="extra_resistance_ohm",
        unit="Ohm",
        typical=0.04,
        low=0.1,
        high=4.0,
        source="assumed",
        follows=lambda load: load.battery_ohm,
    ),
    signature=_signature,
    shapes=({}, {"power": 0.5}, {"power": 1.0}, {"power": 2.0}, {"growth": 1.0}, {"growth": 4.0}),
    needs=("battery_voltage_v", "battery_current_a"),
    grows_with=("load",),
    confused_with=("battery_polarization",),
    told_apart_by="a recorded start-up: a step of the current and the voltage's answer at once",
)
