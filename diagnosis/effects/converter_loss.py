"""The converter takes more from the battery than it hands on: i_b = duty i / eta.

Positive amplitude: battery current above duty times motor current. Forms: in proportion (1/eta - 1), with
the square of the current (conduction in the switches), constant (drivers, controller), each equal to the
first at 5 A (constant: at 2 A). Needs both currents. Hand-tool converters: 85 to 98 % efficient, assumed.
"""

from __future__ import annotations

import numpy as np

from diagnosis.effects.effect import Effect, Strength
from diagnosis.equations import Baseline, Signature
from diagnosis.state import State

_SQUARE_UNIT_A = 5.0
_CONSTANT_UNIT_A = 2.0


def _signature(
    baseline: Baseline, state: State, proportional: float, square: float, constant: float
) -> tuple[Signature, ...]:
    if state.current_a is None:
        return ({},)
    ideal = state.setting.duty * state.current_a
    return (
        {
            "converter": proportional * ideal
            + square * ideal * np.abs(ideal) / _SQUARE_UNIT_A
            + constant * np.full_like(ideal, _CONSTANT_UNIT_A)
        },
    )


EFFECT = Effect(
    name="converter_loss",
    place="supply",
    equation="i_b = duty * i / eta",
    strength=Strength(name="loss_share", unit="1", typical=0.08, low=0.1, high=4.0, source="assumed"),
    signature=_signature,
    shapes=(
        {"proportional": 1.0, "square": 0.0, "constant": 0.0},
        {"proportional": 0.0, "square": 1.0, "constant": 0.0},
        {"proportional": 0.0, "square": 0.0, "constant": 1.0},
        {"proportional": 0.5, "square": 0.0, "constant": 0.5},
        {"proportional": 0.0, "square": 0.5, "constant": 0.5},
    ),
    needs=("motor_current_a", "battery_current_a"),
    grows_with=("load",),
    confused_with=(),
    told_apart_by="both currents measured, at several loads",
)
