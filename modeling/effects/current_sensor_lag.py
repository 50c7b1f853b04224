"""A low-pass in the current sensor: tau di_m/dt + i_m = i, 0.1 to 5 ms.

The reading is wrong by i_m - i = -tau di_m/dt, exactly; every equation that uses the reading shows it:
voltage (R and L times the error), torque (k_m times) and the converter. Two equations in a fixed ratio tell
it from a parameter error; a late clock delays without loss of amplitude and is silent in the converter. A digital
amplifier takes a moving average of 2 tau: tau late at all frequencies, which is what a late clock does, but of
the motor current alone.
Range: amplifiers' and Hall sensors' filters of 30 Hz to 1.6 kHz: assumed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from sawbench.modeling.effects.effect import Effect, Prepared, Strength, Words
from sawbench.modeling.effects.transfer import (
    Spectrum,
    before_average,
    current_reading,
    delay,
    lag_on_axis,
    low_pass,
    time_derivative,
)
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

if TYPE_CHECKING:
    from sawbench.modeling.machines.linear_axis import AxisBaseline, AxisState

_TAUS_S = tuple(float(tau) for tau in np.geomspace(1.5e-4, 1e-2, 18))


def _prepared(baseline: Baseline, state: State) -> Callable[..., tuple[Signature, ...]]:
    current, rate = state.current_a, state.current_rate_a_s
    if current is None or rate is None:
        return lambda tau_s, moving=0.0: ({},)
    bend, reading = time_derivative(rate, state), Spectrum(current, state)

    def signature(tau_s: float, moving: float = 0.0) -> tuple[Signature, ...]:
        if not moving:
            return (current_reading(baseline, state, -tau_s * rate, -tau_s * bend),)
        undone, early = before_average(2.0 * tau_s), delay(-tau_s)
        error = current - reading.through(lambda f: undone(f) * early(f))
        return (current_reading(baseline, state, error, time_derivative(error, state)),)

    return signature


def _axis_signature(_: AxisBaseline, state: AxisState, tau_s: float) -> tuple[Signature, ...]:
    if not state.is_cyclic:
        return ({},)
    return ({"mechanical": Spectrum(state.drive_n, state).through(low_pass(tau_s)) - state.drive_n},)


def _on_axis(_: AxisBaseline) -> Effect:
    return lag_on_axis(EFFECT, "tau * dy/dt + y = drive", _axis_signature)


EFFECT = Effect(
    name="current_sensor_lag",
    place="sensing",
    equation="tau * di_m/dt + i_m = i",
    words=Words(
        happens="lag of the motor current sensor",
        measure="a current step on this sensor compared with a shunt",
        mend="increase the bandwidth of the current sensor",
    ),
    words_on={
        "linear_axis": Words(
            name="lag of the drive's sensor",
            happens="lag of the current or force sensor of the drive",
            measure="a step of the drive on this sensor compared with an unfiltered one",
            mend="increase the bandwidth of the drive sensor",
        )
    },
    parts=("drive_sensor",),
    strength=Strength(
        name="time_constant_s",
        unit="s",
        typical=1.0,
        low=0.7,
        high=1.4,
        usual=1e-3,
        source="assumed",
    ),
    signature=Prepared(_prepared),
    shapes=(*({"tau_s": tau} for tau in _TAUS_S), *({"tau_s": tau, "moving": 1.0} for tau in _TAUS_S)),
    continuous=("tau_s",),
    shape_strength=lambda amplitude, shape: amplitude * shape["tau_s"],
    carries=("tau_s",),
    is_pointwise=False,
    needs=("motor_current_a",),
    grows_with=("speed",),
    confused_with=("clock_offset",),
    told_apart_by="the battery current, which does not lag, and a recorded start-up",
    background=(({"tau_s": 1e-4}, 1.0),),
    keeps_hardness=True,
    variants={"linear_axis": _on_axis},
)
