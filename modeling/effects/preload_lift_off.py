"""The force lifts the carriage off its preload: the reading is clipped at the preload, the true force is not.

    F_m = min(F, P)

Flat-topped force, always at the same height; the current follows the true force, so the mechanical
residual, which uses the reading, is positive at the peaks. P is a share of the largest mean-cycle force of
the campaign. A clipped campaign makes its own k_Fc look small: the expected force is that of the trial's own
coefficient where its force is low, or that of the stock scaled up. Strokes differ, so the corner of a mean
cycle is round by a few per cent. A speed exponent flattens the force without such a ceiling. Preload: chosen
by the operator.
"""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.effects.transfer import force_error
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

_ROUND = 0.02


def _signature(baseline: Baseline, state: State, share: float, scale: float) -> tuple[Signature, ...]:
    preload_n = share * state.peak_force_n
    if not preload_n > 0.0:
        return ({},)
    true_n = scale * baseline.stock_force(state)
    if not scale:
        true_n = (state.k_below_n_s_per_m or state.k_guess_n_s_per_m) * baseline.cutting_speed(state)
    width_n = _ROUND * preload_n
    clipped_off = width_n * np.logaddexp(0.0, (true_n - preload_n) / width_n)
    # Far below the preload the round corner leaves nothing.
    clipped_off = np.where(true_n > preload_n - 8.0 * width_n, clipped_off, 0.0)
    return (force_error(baseline, state, -clipped_off),)


EFFECT = Effect(
    name="preload_lift_off",
    place="sensing",
    equation="F_m = min(F, preload)",
    words=Words(
        happens="the force lifts the carriage off its preload",
        measure="the force at which a feeler gauge slips between carriage and stop",
        mend="preload the carriage more",
    ),
    parts=("carriage",),
    silent_in=("air",),
    strength=Strength(name="preload_share_of_peak", unit="1", typical=1.0, low=0.7, high=1.4, source="assumed"),
    signature=_signature,
    shapes=tuple({"share": s, "scale": k} for s in (0.96, 1.0) for k in (0.0, 1.0, 1.1, 1.2, 1.35, 1.6)),
    continuous=("share", "scale"),
    shape_strength=lambda amplitude, shape: shape["share"],
    carries=("share",),
    scales=("peak_force_n",),
    needs=("force_n",),
    grows_with=("load",),
    confused_with=("cutting_speed_exponent", "current_limit"),
    told_apart_by="the histogram of the force, trials at several speeds, the motor current at the peaks",
    background=(),
)
