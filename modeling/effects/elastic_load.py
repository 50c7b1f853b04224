"""Something springy acts on an axis (spring, cable, bellows, end stop): k (x - x_0), or its cube.

Conservative and the same at every speed, so that a sweep of the cycle rate leaves it alone; it grows with the distance
from the middle of the stroke, where cogging comes in waves. Positive amplitude: it pulls towards the middle. A linear
spring gives the first form, a cable that tightens or a stop the cubic one. A fifth of the drive's force at the end of
the stroke: assumed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Signature

if TYPE_CHECKING:
    from sawbench.modeling.machines.linear_axis import AxisBaseline, AxisState

# Without a machine, typical sizes are those of an axis of 100 N and 0.1 m.
_FORCE_N, _STROKE_M = 100.0, 0.1


def _signature(axis: AxisBaseline, state: AxisState, power: float) -> tuple[Signature, ...]:
    share = (state.position_m - np.mean(state.position_m)) / (0.5 * axis.stroke_m)
    return ({"mechanical": 0.5 * axis.stroke_m * np.sign(share) * np.abs(share) ** power},)


def _sized(force_n: float, stroke_m: float) -> Effect:
    typical_n_per_m = 0.2 * force_n / stroke_m
    return Effect(
        name="elastic_load",
        place="mechanical",
        equation="k * (x - x_0): spring, cable, bellows",
        words=Words(
            happens="an elastic load acts on the axis",
            measure="the force that holds the axis still, drive off, at several positions",
            mend="check cables, bellows and end stops",
        ),
        parts=("moving_mass",),
        strength=Strength(
            name="stiffness_n_per_m", unit="N/m", typical=typical_n_per_m, low=0.1, high=20.0, source="assumed"
        ),
        signature=_signature,
        shapes=({"power": 1.0}, {"power": 3.0}),
        grows_with=("position",),
        confused_with=("cogging",),
        told_apart_by="another stroke: it grows with the distance from the middle at any speed",
        variants={"linear_axis": lambda axis: _sized(axis.force_scale_n, axis.stroke_m)},
    )


EFFECT = _sized(_FORCE_N, _STROKE_M)
