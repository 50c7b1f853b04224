"""A battery whose voltage over the charge is another one than that of the configuration."""

from __future__ import annotations

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

_AS_PER_AH = 3600.0


def _another_discharge(baseline: Baseline, state: State, of_load: float) -> tuple[Signature, ...]:
    """Voltage, or resistance, that changes with the charge used and with its square."""
    if baseline.battery is None or state.battery_current_a is None:
        return ({}, {})
    used = state.charge_used_as / (_AS_PER_AH * baseline.battery.capacity_ah)
    drop = baseline.battery.internal_resistance_ohm * state.battery_current_a
    unit_v = drop if of_load else np.full_like(drop, baseline.battery.nominal_voltage_v)
    return ({"supply": -unit_v * used}, {"supply": -unit_v * used**2})


ANOTHER_DISCHARGE = Effect(
    name="battery that empties along another curve",
    place="supply",
    equation="E(q) + a q + b q^2, or R (1 + a q + b q^2)",
    strength=Strength(name="share", unit="1", typical=0.1, low=0.05, high=20.0, source="assumed; a weak cell"),
    signature=_another_discharge,
    n_signatures=lambda shape: 2,
    shapes=({"of_load": 0.0}, {"of_load": 1.0}),
)
