"""The zero of the load cell drifts over the session: F_m = F + d(t).

d over the first 1000 s: linear, square root, or a warm-up 1 - exp(-t/t_w). Rising and falling zeros
are separate forms (an amplitude is positive); reported is the signed drift. The same at all angles, cutting
or not; the mechanical residual, which uses the reading, shows it as -d times the lever. A constant offset
is no drift (see nuisances). Bridge amplifiers and strain gauges: 0.02 to 0.1 % of the range per 10 K, that
is 1 to 10 N: assumed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.effects.strokes import ZeroTrend
from sawbench.modeling.effects.transfer import force_error
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

if TYPE_CHECKING:
    from sawbench.modeling.machines.linear_axis import AxisBaseline, AxisState

_UNIT_S = 1000.0


def _signature(
    baseline: Baseline, state: State, direction: float, power: float = 1.0, warm_up_s: float = 0.0
) -> tuple[Signature, ...]:
    elapsed_s = np.maximum(state.setting.session_s + state.time_s, 0.0)
    drift = (
        np.expm1(-elapsed_s / warm_up_s) / np.expm1(-_UNIT_S / warm_up_s)
        if warm_up_s > 0.0
        else (elapsed_s / _UNIT_S) ** power
    )
    return (force_error(baseline, state, direction * drift),)


def _axis_signature(_: AxisBaseline, state: AxisState, direction: float) -> tuple[Signature, ...]:
    elapsed_s = state.setting.session_s + state.time_s
    return ({"mechanical": direction * elapsed_s / _UNIT_S},)


def _on_axis(axis: AxisBaseline) -> Effect:
    return replace(
        EFFECT,
        strength=replace(EFFECT.strength, typical=0.05 * axis.force_scale_n),
        signature=_axis_signature,
        shapes=({"direction": 1.0}, {"direction": -1.0}),
        needs=(),
        confused_with=(),
        told_apart_by="the first trial again at the end",
    )


EFFECT = Effect(
    name="force_offset_drift",
    place="sensing",
    equation="F_m = F + d(t)",
    words=Words(
        happens="the zero of the load cell drifts",
        measure="the unloaded force reading over half an hour from switching on",
        mend="let the load cell warm up and tare before each trial",
    ),
    parts=("load_cell",),
    strength=Strength(
        name="drift_n_per_1000_s",
        unit="N",
        typical=4.0,
        low=0.1,
        high=6.0,
        source="assumed",
    ),
    signature=_signature,
    shapes=tuple(
        {"direction": d, **form}
        for form in ({"power": 1.0}, {"power": 0.5}, {"warm_up_s": 100.0}, {"warm_up_s": 400.0})
        for d in (1.0, -1.0)
    ),
    shape_strength=lambda amplitude, shape: amplitude * shape["direction"],
    needs=("force_n",),
    grows_with=("time",),
    confused_with=("blade_wear", "return_stroke_rubbing"),
    told_apart_by="idle runs before and after",
    keeps_hardness=True,
    strokes=ZeroTrend(),
    variants={"linear_axis": _on_axis},
)
