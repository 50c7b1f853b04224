"""The cutting force is not proportional to the blade's speed.

    power law    F = k v_ref (v / v_ref)^p,             p = 0.1 to 1.6
    saturating   F = k v (1 + v_ref/v_k) / (1 + v/v_k)

v_ref is 0.81 of the usual top speed of the blade (0.7 m/s on the paper's saw), where a straight line fitted to a stroke
meets the curve; how it scales the force is the cutting coefficient's. p < 1 flattens the top of the force; the peak
then does not follow the stroke rate. Told from an edge force (a step plus a line) by a speed sweep. Tooth forces in
wood barely depend on cutting speed from 2.5 to 15 m/s (p near 0); viscous polymers exceed 1. Range assumed; reported
is p, for the saturating form its slope at 0.7 m/s.
"""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.load import OAK
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

_STATED_AT_M_S = 0.7
# Of the blade's usual top speed.
_V_REF_SHARE = _STATED_AT_M_S / OAK.blade_speed_m_s


def _signature(
    baseline: Baseline, state: State, exponent: float = 1.0, knee_m_s: float = 0.0, saturates: float = 0.0
) -> tuple[Signature, ...]:
    del saturates  # says which form it is where the exponent alone is stated
    speed, v_ref = baseline.cutting_speed(state), _V_REF_SHARE * baseline.load.blade_speed_m_s
    if knee_m_s > 0.0:
        curve = speed * (1.0 + v_ref / knee_m_s) / (1.0 + speed / knee_m_s)
    else:
        curve = np.where(speed > 0.0, v_ref * (np.maximum(speed, 1e-9) / v_ref) ** exponent, 0.0)
    return ({"cutting": state.k_guess_n_s_per_m * (curve - speed)},)


def _exponent(amplitude: float, shape: dict[str, float]) -> float:
    slope = 1.0 / (1.0 + _STATED_AT_M_S / shape["knee_m_s"]) if "knee_m_s" in shape else shape["exponent"]
    return 1.0 + amplitude * (slope - 1.0)


EFFECT = Effect(
    name="cutting_speed_exponent",
    place="cutting",
    equation="F = k * v_ref * (v / v_ref)^p",
    words=Words(
        happens="the cutting force is not proportional to the blade speed",
        measure="the peak force in one piece of wood at three speeds",
        mend="no fault; the linear cutting law is too simple for this material",
    ),
    parts=("blade",),
    silent_in=("air",),
    strength=Strength(
        name="exponent",
        unit="1",
        typical=1.0,
        low=0.7,
        high=1.4,
        source="assumed; wood: near 0 above 2.5 m/s",
    ),
    signature=_signature,
    shapes=(
        *({"exponent": p} for p in (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.15, 1.3, 1.45, 1.6)),
        *({"knee_m_s": v, "saturates": 1.0} for v in (0.15, 0.3, 0.6, 1.2, 2.4)),
    ),
    form_names={"power_law": {}, "saturating": {"saturates": 1.0}},
    continuous=("exponent", "knee_m_s"),
    shape_strength=_exponent,
    carries=("exponent", "knee_m_s"),
    needs=("force_n",),
    grows_with=("speed",),
    confused_with=("edge_force", "preload_lift_off", "engagement_delay"),
    told_apart_by="trials at several speeds, and the shape of the force within the stroke",
)
