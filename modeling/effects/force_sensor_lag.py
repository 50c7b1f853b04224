"""A low-pass in the force amplifier: tau dF_m/dt + F_m = F, 0.1 to 5 ms.

Only the reading lags: the motor feels the true force at once. So the cutting residual lags and the
mechanical one, which uses the reading, shows the same missing force with the other sign. A blade that gives
way (blade_compliance) lags in the cutting equation alone; a late clock (clock_offset) delays without loss
of amplitude. Amplifiers filter in first order or, as often, in second: there tau is the delay of slow signals,
2 zeta / w_0, with zeta from 0.5 (peaking) over 0.7 (Butterworth) to 1.
Range: analogue filters of 30 Hz to 1.6 kHz: assumed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Prepared, Strength, TransferFunction, Words
from sawbench.modeling.effects.transfer import Spectrum, force_error, lag_on_axis, low_pass
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

if TYPE_CHECKING:
    from sawbench.modeling.machines.linear_axis import AxisBaseline, AxisState

_TAUS_S = tuple(float(tau) for tau in np.geomspace(1.5e-4, 1e-2, 18))


def _prepared(baseline: Baseline, state: State) -> Callable[..., tuple[Signature, ...]]:
    force_n = baseline.expected_force(state)
    force = Spectrum(force_n, state)
    return lambda tau_s, damping: (force_error(baseline, state, force.through(low_pass(tau_s, damping)) - force_n),)


def _distorts(state: State, coefficients: Floats, tau_s: float, damping: float) -> Mapping[str, TransferFunction]:
    return {"cutting": low_pass(tau_s, damping)}


def _axis_signature(axis: AxisBaseline, state: AxisState, tau_s: float) -> tuple[Signature, ...]:
    if state.force_n is None or not state.is_cyclic:
        return ({},)
    return ({"mechanical": state.force_n - Spectrum(state.force_n, state).through(low_pass(tau_s))},)


def _on_axis(_: AxisBaseline) -> Effect:
    return lag_on_axis(EFFECT, "tau * dF_m/dt + F_m = F_load", _axis_signature)


EFFECT = Effect(
    name="force_sensor_lag",
    place="sensing",
    equation="tau * dF_m/dt + F_m = F",
    words=Words(
        happens="lag of the force measurement",
        measure="the force reading after a light hammer blow compared with an unfiltered accelerometer",
        mend="increase the bandwidth of the force amplifier",
    ),
    parts=("load_cell",),
    strength=Strength(name="time_constant_s", unit="s", typical=1.0, low=0.7, high=1.4, usual=1e-3, source="assumed"),
    signature=Prepared(_prepared),
    shapes=tuple({"tau_s": tau, "damping": z} for z in (0.0, 0.5, 0.6, 0.7, 0.85, 1.0) for tau in _TAUS_S),
    continuous=("tau_s", "damping"),
    shape_strength=lambda amplitude, shape: amplitude * shape["tau_s"],
    carries=("tau_s",),
    is_pointwise=False,
    needs=("force_n",),
    grows_with=("speed",),
    confused_with=("clock_offset", "blade_compliance"),
    told_apart_by="the motor current: it responds to the true force",
    background=(({"tau_s": 1e-4, "damping": 0.0}, 1.0), ({"tau_s": 2e-4, "damping": 0.5}, 1.0)),
    variants={"linear_axis": _on_axis},
    distorts=_distorts,
)
