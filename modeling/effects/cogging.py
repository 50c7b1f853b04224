"""A linear drive is pulled towards fixed positions: a sin(2 pi x / p + psi), p the pitch of its magnets.

Locked to the position, at any speed in both directions: the work over a cycle is 0, where friction takes some.
Free phase: sine and cosine part. An elastic load pulls towards one place, cogging towards many. Iron-core linear
motors: some per cent of the rated force, pitches of a tenth to a third of the stroke: assumed.
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


def _signature(_: AxisBaseline, state: AxisState, pitch_m: float) -> tuple[Signature, ...]:
    phase = 2.0 * np.pi * state.position_m / pitch_m
    return {"mechanical": np.sin(phase)}, {"mechanical": np.cos(phase)}


def _sized(force_n: float, stroke_m: float) -> Effect:
    return Effect(
        name="cogging",
        place="mechanical",
        equation="a * sin(2 pi x / p + psi)",
        words=Words(
            happens="cogging: the drive is pulled towards fixed positions",
            measure="the force needed to move the axis slowly with a spring balance, drive off: it is periodic",
            mend="no fault; keep it in the model",
        ),
        parts=("linear_drive",),
        strength=Strength(name="amplitude_n", unit="N", typical=0.05 * force_n, low=0.1, high=6.0, source="assumed"),
        signature=_signature,
        n_signatures=lambda shape: 2,
        shapes=tuple({"pitch_m": float(p) * stroke_m} for p in np.geomspace(0.1, 0.4, 48)),
        continuous=("pitch_m",),
        grows_with=("position",),
        confused_with=("elastic_load",),
        told_apart_by="another stroke: it stays at the same positions",
        variants={"linear_axis": lambda axis: _sized(axis.force_scale_n, axis.stroke_m)},
    )


EFFECT = _sized(_FORCE_N, _STROKE_M)
