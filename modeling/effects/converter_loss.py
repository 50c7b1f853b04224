"""The converter takes more from the battery than it hands on: i_b = duty i / eta.

Positive amplitude: battery current above duty times motor current. The losses are gate drive and controller
(constant), switching (in proportion to the motor current i), conduction all the time (R i^2, over the battery
voltage) or while the upper switch is on (duty times that), lumped into one efficiency (in proportion to duty i), or
large for its load where that is light, as most efficiency curves are (in proportion to duty times the root of i);
here mixtures of those, each part in units of what a lumped efficiency gives at 10 A and half duty. Needs both
currents. Hand-tool converters: 85 to 98 % efficient, assumed.
"""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

_UNIT_A, _UNIT_DUTY = 10.0, 0.5


def _signature(
    baseline: Baseline,
    state: State,
    lumped: float,
    switching: float,
    conduction: float,
    constant: float,
    light: float,
    on_state: float = 0.0,
) -> tuple[Signature, ...]:
    if state.current_a is None:
        return ({},)
    share, duty = state.current_a / _UNIT_A, state.setting.duty / _UNIT_DUTY
    per_duty = lumped * share + light * np.sign(share) * np.sqrt(np.abs(share)) + on_state * share**2
    relative = duty * per_duty + switching * share + conduction * share**2 + constant
    return ({"converter": _UNIT_DUTY * _UNIT_A * relative},)


_PARTS = ("lumped", "switching", "conduction", "constant", "light", "on_state")
_MIXTURES = (
    (1.0, 0.0, 0.0, 0.0, 0.0),
    (0.0, 1.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 1.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 1.0, 0.0),
    (0.0, 0.0, 0.0, 0.0, 1.0),
    (0.5, 0.0, 0.0, 0.5, 0.0),
    (0.5, 0.0, 0.5, 0.0, 0.0),
    (0.5, 0.0, 0.0, 0.0, 0.5),
    (0.0, 0.5, 0.5, 0.0, 0.0),
    (0.0, 0.25, 0.75, 0.0, 0.0),
    (0.0, 0.0, 0.5, 0.5, 0.0),
    (0.0, 0.0, 0.8, 0.2, 0.0),
    (0.0, 0.5, 0.0, 0.5, 0.0),
    (0.0, 0.3, 0.4, 0.3, 0.0),
    (0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    (0.5, 0.0, 0.0, 0.0, 0.0, 0.5),
    (0.0, 0.0, 0.0, 0.5, 0.0, 0.5),
)


EFFECT = Effect(
    name="converter_loss",
    place="supply",
    equation="i_b = duty * i / eta",
    words=Words(
        happens="power loss of the converter",
        measure="input and output power of the converter at several loads",
        mend="check the losses of the converter",
    ),
    parts=("converter",),
    strength=Strength(name="loss_share", unit="1", typical=0.08, low=0.1, high=4.0, source="assumed"),
    signature=_signature,
    shapes=tuple(dict(zip(_PARTS, mixture, strict=False)) for mixture in _MIXTURES),
    needs=("motor_current_a", "battery_current_a"),
    grows_with=("load",),
    confused_with=(),
    told_apart_by="both currents measured, at several loads",
)
