"""A force of the cutting edge that does not depend on speed: F = F_0 + k v on the cutting half.

Positive amplitude: the force steps up at the reversal, where the baseline rises from 0. The reading is the true
force. Forms: an onset over some speed, which also ends the force before the blade stops, or over some travel after
the reversal, 1 - exp(-x/d), for an edge that ploughs until it stops; one F_0 for all stocks, or in proportion to the
thickness, since more teeth are in thicker stock (then F_0 is that of 20 mm), or to the cutting coefficient, since
harder wood resists more (then that of 240 N*s/m). A speed exponent bends the curve, an edge force shifts it.
Mechanistic models of cutting carry such an edge term (Altintas, Manufacturing Automation); 10 to 40 % of the peak
force: assumed.
"""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.effects.stock import WAYS, stock_share
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State


def _signature(
    baseline: Baseline, state: State, by_stock: float, onset_m_s: float = 0.0, onset_m: float = 0.0
) -> tuple[Signature, ...]:
    speed = baseline.cutting_speed(state)
    if onset_m:
        force = np.where(speed > 0.0, 1.0 - np.exp(-baseline.travelled(state) / onset_m), 0.0)
    else:
        force = np.tanh(speed / onset_m_s)
    return ({"cutting": force * stock_share(state, by_stock)},)


EFFECT = Effect(
    name="edge_force",
    place="cutting",
    equation="F = F_0 + k * v on the cutting half",
    words=Words(
        happens="part of the cutting force does not depend on the speed (edge force)",
        measure="the force at the slowest speed at which the blade still cuts",
        mend="check for blunt teeth; otherwise the linear cutting law is too simple for this material",
    ),
    parts=("blade",),
    silent_in=("air",),
    strength=Strength(
        name="force_n",
        unit="N",
        typical=40.0,
        low=0.1,
        high=8.0,
        source="assumed",
        follows=lambda load: load.force_n,
    ),
    signature=_signature,
    shapes=(
        *({"by_stock": s, "onset_m_s": v} for v in (0.01, 0.04, 0.12) for s in WAYS),
        *({"by_stock": s, "onset_m": d} for d in (1e-4, 3e-4, 1e-3) for s in WAYS),
    ),
    continuous=("onset_m_s", "onset_m"),
    needs=("force_n",),
    confused_with=("cutting_speed_exponent", "preload_lift_off"),
    told_apart_by="trials at several speeds",
)
