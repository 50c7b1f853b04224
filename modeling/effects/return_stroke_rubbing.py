"""The blade drags in the kerf on its way back: F = -c |v| or -F_r on the return half (baseline: 0).

Positive amplitude: the load cell reads negative on the return half. The reading is the true force, so the mechanical
equation, which uses it, stays right. Forms: viscous, dry with 0.5 N per N*s/m (the same at 0.5 m/s), and in part dry,
where what is dry sets in at once or as the blade gains speed; the same all the way back, or harder towards one end of
it, where the blade is thicker or the kerf full of dust; for every stock alike, or in proportion to its thickness or its
cutting coefficient, and then stated for 20 mm or 240 N*s/m. Stated for the middle of the stroke. Told from an offset of
the load cell by the half stroke it lives on and by idle runs. Some per cent to 20 % of the cutting force: assumed.
"""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.effects.stock import WAYS, stock_share
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

_DRY_AT_M_S = 0.5
# Speed at which what is dry has set in by three quarters: at once, and as lips or dust give way first.
_SETS_IN_M_S = (0.03, 0.12)
# How hard it rubs at the end of the way back against its start.
_END_OVER_START = (1.0, 1.0 / 3.0, 3.0)


def _signature(
    baseline: Baseline, state: State, dry: float, by_stock: float, end_over_start: float = 1.0,
    sets_in_m_s: float = _SETS_IN_M_S[0],
) -> tuple[Signature, ...]:  # fmt: skip
    velocity = np.maximum(-baseline.cutting_sign * baseline.blade_velocity(state), 0.0)
    set_in = np.tanh(velocity / sets_in_m_s) / np.tanh(_DRY_AT_M_S / sets_in_m_s)
    force = (1.0 - dry) * velocity + dry * _DRY_AT_M_S * set_in
    back = 1.0 - 0.5 * baseline.travelled(state) / baseline.radius_m  # share of the way back that is done
    along = (1.0 + (end_over_start - 1.0) * back) / (0.5 + 0.5 * end_over_start)
    return ({"cutting": -force * along * stock_share(state, by_stock)},)


EFFECT = Effect(
    name="return_stroke_rubbing",
    place="cutting",
    equation="F = -c * |v| or -F_r on the return half",
    words=Words(
        happens="the blade rubs in the kerf on its way back",
        measure="the force of the return stroke of a new blade against that of this one",
        mend="check set and alignment of the blade",
    ),
    parts=("blade",),
    silent_in=("air",),
    strength=Strength(
        name="damping_n_s_per_m",
        unit="N*s/m",
        typical=25.0,
        low=0.1,
        high=8.0,
        source="assumed",
        follows=lambda load: load.force_n / load.blade_speed_m_s,
    ),
    signature=_signature,
    shapes=tuple(
        {"dry": dry, "by_stock": stock, "end_over_start": ratio, "sets_in_m_s": sets_in}
        for ratio in _END_OVER_START
        for dry in (0.0, 0.25, 0.5, 1.0)
        for sets_in in (_SETS_IN_M_S if dry else _SETS_IN_M_S[:1])
        for stock in WAYS
    ),
    continuous=("dry", "end_over_start", "sets_in_m_s"),
    needs=("force_n",),
    grows_with=("speed",),
    confused_with=("force_offset_drift", "blade_compliance"),
    told_apart_by="the sign and the half stroke of the force; idle runs fix the zero of the load cell",
)
