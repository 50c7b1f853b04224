"""What slow instruments take off the ripple of a current: that is no gap either.

An instrument that sends a value every few milliseconds sends the mean of that time, or what it read last; nothing in a
recording says which. And the sensor of a battery is there for the charge: its filter may be anything up to some
milliseconds, of current and voltage alike, so that the balance of the battery holds and that of the converter does not.
A filter of the motor current is an effect of the catalogue (`current_sensor_lag`). In the balance of the converter it
is a filter of the battery's sensor with the other sign, and no filter reads ahead: where the battery's current is ahead
of that of the motor, its sensor has no filter to be seen.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Final

import numpy as np
from sawbench.bench.units import BATTERY_CURRENT, MOTOR_CURRENT
from sawbench.diagnosis.inference.nuisance import Nuisance
from sawbench.diagnosis.standard_error import exceeds_its_error
from sawbench.modeling.effects.effect import TransferFunction
from sawbench.modeling.effects.transfer import (
    Spectrum,
    average,
    before_average,
    current_reading,
    low_pass,
    time_derivative,
)
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

# From none to all of it, evenly.
_AVERAGED_STD: Final = 1.0 / np.sqrt(3.0)
# Time constants of a battery's sensor: one of them, or between two.
_BATTERY_S: Final = (2e-4, 5e-4, 1.2e-3, 3e-3)
_BATTERY_STD: Final = 1.0 / np.sqrt(len(_BATTERY_S))
# Times over which its values may be means, or lines between samples, where the rows do not show it.
_MEAN_S: Final = (2e-3, 5e-3, 1e-2)
_MEAN_STD: Final = 1.0 / np.sqrt(len(_MEAN_S))


def bandwidth_nuisances(states: Sequence[State]) -> Iterator[Nuisance]:
    """List what the instruments of a campaign may take off the ripple of the currents.

    Parameters
    ----------
    states : sequence of State
        Of the campaign.

    Yields
    ------
    Nuisance
        Averages over the time for which a value stands, and filters of the battery's sensor.
    """
    stated = [state.setting.alignments for state in states]
    averages = ((MOTOR_CURRENT.name, _motor, before_average), (BATTERY_CURRENT.name, _battery, average))
    for channel, signature, of in averages:
        period_s = max((one[channel].latency_s for one in stated if channel in one), default=0.0)
        if period_s:
            yield _nuisance(f"average of {channel}", _AVERAGED_STD, partial(signature, transfer=of(period_s)))
    for period_s in _MEAN_S:
        name = f"mean of {BATTERY_CURRENT.name} over {1e3 * period_s:g} ms"
        yield _nuisance(name, _MEAN_STD, partial(_battery, transfer=average(period_s)))
    for tau_s in () if is_battery_ahead(states) else _BATTERY_S:
        name = f"filter of {BATTERY_CURRENT.name}, {1e3 * tau_s:g} ms"
        yield _nuisance(name, _BATTERY_STD, partial(_battery, transfer=low_pass(tau_s)))


def is_battery_ahead(states: Sequence[State]) -> bool:
    """Whether the battery's current is ahead of what the converter draws, over the ripple of the running strokes.

    Parameters
    ----------
    states : sequence of State
        Those without either current, and those of starts, do not count.
    """
    ahead = []
    for state in states:
        current_a, rate_a_s, battery_a = state.current_a, state.current_rate_a_s, state.battery_current_a
        if state.kind == "running" and current_a is not None and rate_a_s is not None and battery_a is not None:
            missed_a = battery_a - state.setting.duty * current_a
            ahead.append(float(np.sum(rate_a_s * (missed_a - missed_a.mean(axis=-1, keepdims=True)))))
    return len(ahead) > 1 and exceeds_its_error(np.array(ahead))


def _nuisance(name: str, std: float, signature: partial[Signature]) -> Nuisance:
    return Nuisance(name=name, std=std, signature=signature, is_shared=True)


def _motor(baseline: Baseline, state: State, *, transfer: TransferFunction) -> Signature:
    """By the reading, and what was there before the average: `transfer` undoes that."""
    if state.current_a is None:
        return {}
    error = state.current_a - Spectrum(state.current_a, state).through(transfer)
    return current_reading(baseline, state, error, time_derivative(error, state))


def _battery(baseline: Baseline, state: State, *, transfer: TransferFunction) -> Signature:
    """By the current that the converter draws; the voltage over the internal resistance goes with it."""
    if state.battery_current_a is None or state.current_a is None:
        return {}
    drawn = state.setting.duty * state.current_a
    error = Spectrum(drawn, state).through(transfer) - drawn
    if state.battery_voltage_v is None or baseline.battery is None:
        return {"converter": error}
    drop = baseline.battery.internal_resistance_ohm * error
    return {"converter": error, "electrical": -state.setting.duty * drop}
