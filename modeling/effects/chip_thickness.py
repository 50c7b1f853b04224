"""Thicker chips cut harder: k grows with feed per stroke, k (h / h_ref)^m, h = feed / stroke rate.

Or a part grows with the chip and one does not: k (1 + m (h / h_ref - 1)), of the same slope at h_ref.
h_ref = 0.3 mm. The gain changes with feed and stroke rate, the shape of the force over the stroke does not; or, where
the wood feeds on while the cut slows the crank, h follows the crank within the stroke: h = feed * 2 pi / crank speed.
Nothing can be said where nobody told the feed. m = 0.4 to 0.9 in wood (tooth forces about h^0.68), assumed.
A speed exponent changes the shape too; wear grows at any feed.
"""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.effects.strokes import StrokeTrend
from sawbench.modeling.effects.transfer import stroke_rate_hz
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import TWO_PI, State

_H_REF_M = 3e-4


def _signature(
    baseline: Baseline, state: State, exponent: float, in_stroke: float = 0.0, affine: float = 0.0
) -> tuple[Signature, ...]:
    if not state.setting.feed_m_s > 0.0:
        return ({},)
    rate_hz = np.maximum(state.speed_rad_s, 1e-3) / TWO_PI if in_stroke else stroke_rate_hz(state)
    thickness = state.setting.feed_m_s / rate_hz / _H_REF_M
    grown = exponent * (thickness - 1.0) if affine else thickness**exponent - 1.0
    return ({"cutting": baseline.stock_force(state) * grown},)


def _log_change(distance_m: Floats, log_thickness: Floats, size: float) -> Floats:
    return size * log_thickness


EFFECT = Effect(
    name="chip_thickness",
    place="cutting",
    equation="k proportional to (feed / stroke rate)^m",
    words=Words(
        happens="the cutting force depends on the chip thickness",
        measure="the force in one piece of wood at three feeds and one speed",
        mend="no fault; compare only trials at equal feed per stroke",
    ),
    parts=("blade",),
    silent_in=("air", "start_up"),
    strength=Strength(
        name="exponent",
        unit="1",
        typical=1.0,
        low=0.6,
        high=1.5,
        source="assumed; wood: about 0.68",
    ),
    signature=_signature,
    shapes=(
        *({"exponent": m, **way} for way in ({}, {"in_stroke": 1.0}) for m in (0.3, 0.45, 0.6, 0.75, 0.9)),
        *({"exponent": 0.6, **way, "affine": 1.0} for way in ({}, {"in_stroke": 1.0})),
    ),
    continuous=("exponent",),
    shape_strength=lambda amplitude, shape: amplitude * shape["exponent"],
    carries=("exponent",),
    is_pointwise=False,
    needs=("force_n",),
    grows_with=("feed", "speed"),
    confused_with=("cutting_speed_exponent", "blade_wear"),
    told_apart_by="trials at several feeds",
    strokes=StrokeTrend(
        log_change=_log_change,
        sizes=np.geomspace(0.1, 2.0, 44),
        goes_with_feed=True,
        is_whole_in=lambda shape: not shape.get("in_stroke"),
    ),
)
