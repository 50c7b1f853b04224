"""Slow overvoltage of the cells: V_b = E - R_b i_b - R_p p, tau dp/dt = i_b - p, tau 1 to 60 s.

Positive amplitude: the voltage sags for seconds after a step of the current and recovers at rest. Forms:
one RC element, or the sum of a fast and a slow one, half each. Within a start-up the element follows the
measured current. Internal resistance answers at once. Charge transfer and diffusion of 18650 cells: 5 to 30
mOhm a cell and 1 to 100 s in equivalent-circuit models: assumed.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import START_UP_STEP_S, Memory, State

_TIMES_S: Final = (1.0, 3.0, 6.0, 10.0, 18.0, 30.0, 60.0)
MEMORIES: Final = {tau: Memory(drive="battery_current_a", time_constant_s=tau) for tau in _TIMES_S}


def _signature(baseline: Baseline, state: State, fast_s: float, slow_s: float) -> tuple[Signature, ...]:
    return ({"supply": -0.5 * (_overcurrent(state, fast_s) + _overcurrent(state, slow_s))},)


def _overcurrent(state: State, tau_s: float) -> Floats:
    """Follow the battery current through the RC element: p, A."""
    at_start = np.broadcast_to(state.slow[MEMORIES[tau_s]], state.angle_rad.shape)
    if state.kind != "start_up" or state.battery_current_a is None:
        return at_start
    elapsed = (np.arange(at_start.shape[-1]) + 0.5) * START_UP_STEP_S / tau_s
    gathered = np.cumsum(state.battery_current_a * np.exp(elapsed), axis=-1) * START_UP_STEP_S / tau_s
    return np.exp(-elapsed) * (at_start + gathered)


EFFECT = Effect(
    name="battery_polarization",
    place="supply",
    equation="V_b = E - R_b * i_b - R_p * p, tau * dp/dt = i_b - p",
    words=Words(
        happens="the battery sags under load and recovers at rest",
        measure="the voltage for a minute after a known load is switched off",
        mend="no fault; wait between trials, or use another battery",
    ),
    parts=("battery",),
    strength=Strength(
        name="polarization_resistance_ohm",
        unit="Ohm",
        typical=0.04,
        low=0.1,
        high=4.0,
        source="assumed",
        follows=lambda load: load.battery_ohm,
    ),
    signature=_signature,
    memories=tuple(MEMORIES.values()),
    shapes=(
        *({"fast_s": tau, "slow_s": tau} for tau in _TIMES_S),
        {"fast_s": 1.0, "slow_s": 10.0},
        {"fast_s": 3.0, "slow_s": 30.0},
        {"fast_s": 10.0, "slow_s": 60.0},
    ),
    needs=("battery_voltage_v", "battery_current_a"),
    grows_with=("time", "load"),
    confused_with=("battery_internal_resistance",),
    told_apart_by="a step of the current: the first 50 ms against the next seconds, and the recovery at rest",
)
