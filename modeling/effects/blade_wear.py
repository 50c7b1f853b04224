"""The blade dulls: k (1 + w g(d)), monotone over its life, no recovery at rest.

d is the way of the teeth through the wood, one stroke a turn, not the length of the kerf. g = (d / 10 m)^q with q 0.5,
1, 1.5, or a quick running-in (1 - exp(-d/d_0)) / (1 - exp(-10 m/d_0)). w is the growth over the first 10 m. Positive
amplitude: the force grows. Heat and offset drift recover at rest or leave the shape alone. The paper changes its blades
when the specific force has grown by 20 %; rate: assumed.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.effects.strokes import StrokeTrend
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

_UNIT_M = 10.0


def growth(distance_m: Floats, power: float = 1.0, run_in_m: float = 0.0) -> Floats:
    """How far the blade has dulled, 1 after 10 m: g of the equation above.

    Parameters
    ----------
    distance_m : ndarray
        Cut so far, at least 0.
    power : float
        q; without effect where the blade runs in.
    run_in_m : float
        d_0; 0 for a power of the distance.

    Returns
    -------
    ndarray
    """
    if run_in_m > 0.0:
        return np.expm1(-distance_m / run_in_m) / np.expm1(-_UNIT_M / run_in_m)
    return (distance_m / _UNIT_M) ** power


def _signature(baseline: Baseline, state: State, **shape: float) -> tuple[Signature, ...]:
    grown = growth(np.maximum(state.cut_distance_m, 0.0), **shape)
    return ({"cutting": baseline.stock_force(state) * grown},)


def _log_change(distance_m: Floats, log_thickness: Floats, size: float, **shape: float) -> Floats:
    return np.log1p(size * growth(distance_m, **shape))


_FORMS: Final[tuple[dict[str, float], ...]] = (
    *({"power": q} for q in (1.0, 0.5, 1.5)),
    {"run_in_m": 3.0},
    {"run_in_m": 10.0},
)
_STRENGTH: Final = Strength(
    name="growth_per_10_m", unit="1", typical=0.1, low=0.1, high=4.0, source="assumed; limit 20 %: the paper"
)
EFFECT = Effect(
    name="blade_wear",
    place="cutting",
    equation="k * (1 + w * blade travel in the wood)",
    words=Words(
        happens="the blade becomes blunt during the campaign",
        measure="the force in one piece of wood with this blade and with a new one",
        mend="change the blade, and note its cut length",
    ),
    parts=("blade",),
    silent_in=("air",),
    strength=_STRENGTH,
    signature=_signature,
    shapes=_FORMS,
    form_names={
        "linear": {"power": 1.0},
        "square_root": {"power": 0.5},
        "progressive": {"power": 1.5},
        "running_in": {"run_in_m": 3.0},
    },
    needs=("force_n",),
    grows_with=("time",),
    confused_with=("force_offset_drift", "chip_thickness"),
    told_apart_by="the same operating point with a worn and a new blade, after a rest",
    strokes=StrokeTrend(
        log_change=_log_change,
        sizes=_STRENGTH.typical * np.geomspace(_STRENGTH.low, _STRENGTH.high, 44),
        shapes=_FORMS,
    ),
)
