"""A low-pass in the current sensor: tau di_m/dt + i_m = i, 0.1 to 5 ms.

The reading is wrong by i_m - i = -tau di_m/dt, exactly; every equation that uses the reading shows it:
voltage (R and L times the error), torque (k_m times) and the converter. Two equations in a fixed ratio tell
it from a parameter error; a late clock delays without loss of amplitude and is silent in the converter.
Range: amplifiers' and Hall sensors' filters of 30 Hz to 1.6 kHz: assumed.
"""

from __future__ import annotations

import numpy as np

from diagnosis.effects.effect import Effect, Strength
from diagnosis.effects.transfer import current_reading, time_derivative
from diagnosis.equations import Baseline, Signature
from diagnosis.state import State

_TAUS_S = tuple(float(tau) for tau in np.geomspace(1.5e-4, 1e-2, 18))


def _signature(baseline: Baseline, state: State, tau_s: float) -> tuple[Signature, ...]:
    if state.current_rate_a_s is None:
        return ({},)
    bend = time_derivative(state.current_rate_a_s, state)
    return (current_reading(baseline, state, -tau_s * state.current_rate_a_s, -tau_s * bend),)


EFFECT = Effect(
    name="current_sensor_lag",
    place="sensing",
    equation="tau * di_m/dt + i_m = i",
    strength=Strength(
        name="time_constant_s",
        unit="s",
        typical=1.0,
        low=0.7,
        high=1.4,
        source="assumed",
    ),
    signature=_signature,
    shapes=tuple({"tau_s": tau} for tau in _TAUS_S),
    shape_strength=lambda amplitude, shape: amplitude * shape["tau_s"],
    needs=("motor_current_a",),
    grows_with=("speed",),
    confused_with=("clock_offset",),
    told_apart_by="the battery current, which does not lag, and a recorded start-up",
    background=(({"tau_s": 1e-4}, 0.5),),
)
