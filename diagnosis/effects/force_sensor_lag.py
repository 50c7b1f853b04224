"""A low-pass in the force amplifier: tau dF_m/dt + F_m = F, 0.1 to 5 ms.

Only the reading lags: the motor feels the true force at once. So the cutting residual lags and the
mechanical one, which uses the reading, shows the same missing force with the other sign. A blade that gives
way (blade_compliance) lags in the cutting equation alone; a late clock (clock_offset) delays without loss
of amplitude. Range: amplifiers' analogue filters of 30 Hz to 1.6 kHz: assumed.
"""

from __future__ import annotations

import numpy as np

from diagnosis.effects.effect import Effect, Strength
from diagnosis.effects.transfer import filtered, force_reading
from diagnosis.equations import Baseline, Signature
from diagnosis.state import State

_TAUS_S = tuple(float(tau) for tau in np.geomspace(1.5e-4, 1e-2, 18))


def _signature(baseline: Baseline, state: State, tau_s: float) -> tuple[Signature, ...]:
    force = baseline.expected_force(state)
    return (force_reading(baseline, state, filtered(force, state, lambda f: 1 / (1 + 2j * np.pi * f * tau_s))),)


EFFECT = Effect(
    name="force_sensor_lag",
    place="sensing",
    equation="tau * dF_m/dt + F_m = F",
    strength=Strength(name="time_constant_s", unit="s", typical=1.0, low=0.7, high=1.4, source="assumed"),
    signature=_signature,
    shapes=tuple({"tau_s": tau} for tau in _TAUS_S),
    shape_strength=lambda amplitude, shape: amplitude * shape["tau_s"],
    needs=("force_n",),
    grows_with=("speed",),
    confused_with=("clock_offset", "blade_compliance"),
    told_apart_by="the motor current: it feels the true force",
)
