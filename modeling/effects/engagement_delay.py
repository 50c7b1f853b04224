"""The teeth bite late: no force until a fraction of the cutting half has been travelled.

    F = 0 while travelled / stroke < d,  then k v  (sharp, or rising over a few per cent of the stroke)

Fixed in position, at any speed; the reading is the true force. Residual: negative at the start of the cut, and
positive after it where k_Fc was regressed over the whole cutting half: that is too small, by the share of the squared
speed that is travelled without a force. Backlash delays by far less and also bends the displacement; a lag moves with
the stroke rate. Range 2 to 40 % of the travel: assumed (play of blade and workpiece, tooth pitch over thickness).
On every saw the teeth take the cut up one after the other, within a tooth pitch (up to 4 mm): a force that rises softly
from the very start, over up to a twelfth of the travel, is background. So is a bite that is late by up to 1 % of it,
as a play of some hundredths of a millimetre makes it.
"""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

_FRACTIONS = (0.02, 0.03, 0.04, 0.055, *np.arange(0.07, 0.25, 0.015).round(3).tolist(), 0.265, 0.29, 0.32, 0.36, 0.4)


def _signature(baseline: Baseline, state: State, fraction: float, ramp: float) -> tuple[Signature, ...]:
    travelled = baseline.travelled(state) / (2.0 * baseline.radius_m)
    engaged = np.clip((travelled - fraction) / ramp + 0.5, 0.0, 1.0)
    force = baseline.expected_force(state)
    rise = 1.0
    if state.regressed_at_rad_s > 0.0:
        rise = float(np.sum(force**2) / max(np.sum(force**2 * engaged), 1e-300))
    return ({"cutting": force * (rise * engaged - 1.0)},)


EFFECT = Effect(
    name="engagement_delay",
    place="cutting",
    equation="F = 0 until a fraction of the cutting half is travelled",
    words=Words(
        happens="the teeth engage late in the stroke",
        measure="the blade position at which the force starts, at two speeds",
        mend="check the play of blade and workpiece",
    ),
    parts=("blade",),
    silent_in=("air",),
    strength=Strength(name="fraction", unit="1", typical=1.0, low=0.7, high=1.3, usual=0.1, source="assumed"),
    signature=_signature,
    shapes=tuple({"fraction": d, "ramp": ramp} for d in _FRACTIONS for ramp in (0.01, 0.03, 0.08)),
    continuous=("fraction", "ramp"),
    shape_strength=lambda amplitude, shape: shape["fraction"],
    carries=("fraction",),
    needs=("force_n",),
    grows_with=("position",),
    confused_with=("yoke_backlash", "cutting_speed_exponent", "force_sensor_lag"),
    told_apart_by="trials at several speeds: it stays at the same blade position",
    # From half of the force at the very start to all of it at half of the ramp.
    background=(
        *(({"fraction": 0.0, "ramp": ramp}, 1.0) for ramp in (0.01, 0.02, 0.04, 0.08, 0.16)),
        *(({"fraction": d, "ramp": 0.001}, 1.0) for d in (0.0025, 0.005, 0.01)),
    ),
)
