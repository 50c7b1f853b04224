"""Crosstalk between channels: of cables side by side, or of a converter that has not settled from one to the next.

Every channel reads a share of every other, both over what they usually reach on the machine. The force, the
displacement and the motor's current have shapes of their own; what is locked to the battery's voltage is a zero, and
the battery's current has the shape of the motor's. A displacement that reads the force shows what a drive that yields
to it does (`plunger_drive`), which is larger.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.units import BATTERY_VOLTAGE, DISPLACEMENT, FORCE, MOTOR_CURRENT
from sawbench.diagnosis.inference.nuisance import Nuisance
from sawbench.diagnosis.inference.nuisances import READINGS, reads_too_much
from sawbench.diagnosis.inference.plunger_drive import SHOWN_HARMONICS
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.yoke_backlash import swing
from sawbench.modeling.residuals import Baseline, Signature, is_angle_known
from sawbench.modeling.state import State
from sawbench.processing.stroke_ripple import wave_seen

# Of baseline and state: what a channel reads over what it usually reaches, of the state's shape; None without it.
_Source = Callable[[Baseline, State], Floats | None]


def _force(baseline: Baseline, state: State) -> Floats | None:
    return None if state.force_n is None else state.force_n / baseline.load.force_n


def _current(baseline: Baseline, state: State) -> Floats | None:
    return None if state.current_a is None else state.current_a / baseline.usual_current_a


def _displacement(baseline: Baseline, state: State) -> Floats | None:
    if not is_angle_known(state):
        return None
    return baseline.mechanism.displacement(state.angle_rad) / (2.0 * baseline.radius_m)


_SOURCES: Final = MappingProxyType({FORCE.name: _force, MOTOR_CURRENT.name: _current, DISPLACEMENT.name: _displacement})


def crosstalk_nuisances() -> Iterator[Nuisance]:
    """List which channel may read which other.

    Yields
    ------
    Nuisance
        Per share of the one over what it usually reaches that the other reads, over what that usually reaches; in the
        displacement by few harmonics of the angle that is told from it, and by more.
    """
    std = SETTINGS.sensors.crosstalk
    for name, source in _SOURCES.items():
        for channel in READINGS:
            if name != channel:
                signature = partial(_read, channel=channel, source=source)
                yield Nuisance(name=f"{name} in {channel}", std=std, signature=signature)
    for n_harmonics in SHOWN_HARMONICS:
        yield Nuisance(
            name=f"{MOTOR_CURRENT.name} in {DISPLACEMENT.name}, {n_harmonics} harmonics",
            std=std / np.sqrt(len(SHOWN_HARMONICS)), signature=partial(_current_tracked, n_harmonics=n_harmonics),
        )  # fmt: skip


def _read(baseline: Baseline, state: State, *, channel: str, source: _Source) -> Signature:
    share = source(baseline, state)
    if share is None or state.kind != "running":
        return {}
    return reads_too_much(baseline, state, channel, _usual(baseline, state, channel) * share)


def _current_tracked(baseline: Baseline, state: State, *, n_harmonics: int) -> Signature:
    """By the angle that is told from a displacement which reads the motor's current."""
    share = _current(baseline, state)
    if share is None or state.kind != "running" or not is_angle_known(state):
        return {}
    off_m = 2.0 * baseline.radius_m * np.mean(share, axis=0)
    off_rad = wave_seen(baseline.mechanism, state.angle_rad[0], off_m, n_harmonics)
    return swing(baseline, state, off_rad, of_sensor=True)


def _usual(baseline: Baseline, state: State, channel: str) -> float:
    """What a channel usually reaches, in its SI unit."""
    if channel == FORCE.name:
        return baseline.load.force_n
    if channel == BATTERY_VOLTAGE.name:
        return 0.0 if state.battery_voltage_v is None else float(state.battery_voltage_v.mean())
    return baseline.usual_current_a
