"""Laws of the cut that model and catalogue take as ideal: a kerf that stays open, teeth that cut alike all the way."""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength
from sawbench.modeling.effects.stock import WAYS, stock_share
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

_SMOOTH_M_S = 0.03
# Way of the feed over which the kerf closes on the blade; 0 where it presses from the start.
_CLOSES_OVER_M = (0.0, 0.004, 0.012, 0.04)


def _pinching_kerf(baseline: Baseline, state: State, over_m: float, by_stock: float) -> tuple[Signature, ...]:
    """Dry friction of the wood on both ways, from the start of the cut or as the kerf gets longer."""
    speed = baseline.cutting_sign * baseline.blade_velocity(state) / _SMOOTH_M_S
    pressed = stock_share(state, by_stock)
    if over_m:
        pressed = pressed * -np.expm1(-state.setting.feed_m_s * state.time_s / over_m)
    return ({"cutting": pressed * np.tanh(speed)},)


def _uneven_cut(baseline: Baseline, state: State, power: float, sign: float) -> tuple[Signature, ...]:
    """A coefficient that rises or falls along the cutting stroke; its mean stays."""
    done = np.clip(0.5 * baseline.travelled(state) / baseline.radius_m, 0.0, 1.0)
    return ({"cutting": sign * (done**power - 1.0 / (power + 1.0)) * baseline.expected_force(state)},)


PINCHING_KERF = Effect(
    name="kerf that pinches the blade",
    place="cutting",
    equation="F = F_0 sign(v) on both ways, from the start or as the kerf gets longer",
    strength=Strength(
        name="force_n", unit="N", typical=20.0, low=0.1, high=8.0, source="assumed", follows=lambda load: load.force_n
    ),
    signature=_pinching_kerf,
    silent_in=("air",),
    shapes=tuple({"over_m": over, "by_stock": by} for over in _CLOSES_OVER_M for by in WAYS),
    needs=("force_n",),
)
UNEVEN_CUT = Effect(
    name="cut that is harder towards one end of the stroke",
    place="cutting",
    equation="k_Fc (1 +- a (x^n - 1 / (n + 1))), x along the cutting stroke",
    strength=Strength(name="share", unit="1", typical=0.2, low=0.05, high=8.0, source="assumed; gullets that fill"),
    signature=_uneven_cut,
    silent_in=("air",),
    shapes=tuple({"power": power, "sign": sign} for power in (1.0, 2.0) for sign in (1.0, -1.0)),
    needs=("force_n",),
)
