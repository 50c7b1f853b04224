"""The winding gets warm: R (1 + 0.0039/K * dT), dT = R_th * copper loss through one or two thermal masses.

Positive amplitude: voltage R * 0.0039 * dT * i is missing, growing under load and gone after a rest.
Copper: 0.0039/K (IEC 60028). Thermal resistance of small brushed motors winding to air 3 to 8 K/W, time
constants 15 s (winding) to 900 s (housing): assumed; the two-body form is that of motor makers (Portescap,
thermal parameters of DC motors). Weaker magnets act on back-EMF and torque, not on R i.
"""

from __future__ import annotations

from typing import Final

from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.effects.heat import COPPER_HEAT, HEAT_SHAPES, copper_loss_w
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

COPPER_PER_K: Final = 0.0039


def _signature(
    baseline: Baseline, state: State, fast_s: float, slow_s: float, fast_share: float
) -> tuple[Signature, ...]:
    if state.current_a is None:
        return ({},)
    rise_k = copper_loss_w(baseline, state, fast_s, slow_s, fast_share)  # at 1 K/W
    return ({"electrical": baseline.plant.resistance_ohm.nominal * COPPER_PER_K * rise_k * state.current_a},)


EFFECT = Effect(
    name="winding_heating",
    place="electrical",
    equation="R * (1 + 0.0039/K * dT), thermal mass",
    words=Words(
        happens="the motor's winding gets warm",
        measure="the resistance of the winding cold, and again right after a hot trial",
        mend="let the motor cool between trials, or measure its temperature",
    ),
    parts=("motor",),
    strength=Strength(
        name="thermal_resistance_k_per_w",
        unit="K/W",
        typical=4.0,
        low=0.1,
        high=4.0,
        source="assumed",
        follows=lambda load: 1.0 / load.heat_w,  # a rise of 40 K
    ),
    signature=_signature,
    memories=tuple(COPPER_HEAT.values()),
    shapes=HEAT_SHAPES,
    needs=("motor_current_a",),
    grows_with=("load", "time"),
    confused_with=("magnet_weakening", "brush_voltage_drop"),
    told_apart_by="hot and cold trials: resistance (load) against back-EMF (idle), recovery at rest",
)
