"""How far the clocks of the instruments may be off by what the recordings state, or by their rows: that is no gap.

Each recording aligns the clock of every stream again, with the uncertainty that it states, and no receiver sees the
smallest latency of a link, which is the same in every recording. Both are delays of a device's channels, and so are
nuisances of the form that the effect `clock_offset` has; what is later than that is a cause. A table states nothing:
its times are known to a row (`processing.held_values.alignment_of_rows`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.units import BATTERY_CURRENT, DISPLACEMENT, FORCE, MOTOR_CURRENT
from sawbench.diagnosis.inference.nuisance import Nuisance
from sawbench.modeling.effects import clock_offset
from sawbench.modeling.effects.transfer import Spectrum, delay, force_error
from sawbench.modeling.residuals import Baseline, Signature, summed
from sawbench.modeling.state import State, TrialSetting

# A force has kinks: at 0.1 ms their second derivative would stay where all devices are late alike, and look like a
# resonance of the carriage.
_STEP_S: Final = 1e-6


def clock_nuisances(settings: Sequence[TrialSetting]) -> Iterator[Nuisance]:
    """List the delays that the recordings of a campaign leave open.

    Parameters
    ----------
    settings : sequence of TrialSetting
        Of every state; trials that state no alignment have none.

    Yields
    ------
    Nuisance
        Of each stream: its latency, which may be anything up to the stated one, and its alignment in each trial.

    Notes
    -----
    A latency is even from 0 to the stated one. Devices that are late alike are late for nobody, so it is counted from
    the middle of the smallest one: of an instrument whose values are held for 2 ms beside one that is read every 0.1 ms
    the middle is 0.95 ms late, whether it averages over that time or sends at its end.
    """
    trials = {setting.label: setting for setting in settings}
    known = {
        channel: {label: trial.alignments[channel] for label, trial in trials.items() if channel in trial.alignments}
        for channel in _LATE
    }
    latency_s = {name: max(one.latency_s for one in stated.values()) for name, stated in known.items() if stated}
    for channel, longest_s in latency_s.items():
        std_s = float(np.hypot(longest_s / np.sqrt(12.0), 0.5 * (longest_s - min(latency_s.values()))))
        yield _delay(f"latency of {channel}", std_s, set(known[channel]), _LATE[channel], is_shared=True)
    for channel, stated in known.items():
        for label, one in stated.items():
            yield _delay(f"clock of {channel} in {label}", one.std_s, {label}, _LATE[channel])


def _delay(
    name: str, std_s: float, labels: set[str], signature: Callable[[Baseline, State], Signature], *,
    is_shared: bool = False,
) -> Nuisance:  # fmt: skip
    return Nuisance(
        name=name, std=std_s, is_shared=is_shared,
        signature=lambda b, s: signature(b, s) if s.setting.label in labels else {},
    )  # fmt: skip


def _late_can(baseline: Baseline, state: State) -> Signature:
    (found,) = clock_offset.EFFECT.signature(baseline, state, device=clock_offset.CAN, tau_s=_STEP_S, drifts=0.0)
    return {name: wave / _STEP_S for name, wave in found.items()}


def _late_force(baseline: Baseline, state: State) -> Signature:
    """Of the measured force: where it is not of the linear law its edges are steeper, whatever the cause."""
    if state.force_n is None:
        return {}
    mean = np.average(state.force_n, axis=0, weights=state.n_strokes)
    return force_error(baseline, state, _late(np.broadcast_to(mean, state.force_n.shape), state))


def _late_displacement(baseline: Baseline, state: State) -> Signature:
    """It sets the crank angle: all others are early."""
    return _early(summed([_late_can(baseline, state), _late_force(baseline, state)]))


def _late_battery(_: Baseline, state: State) -> Signature:
    """Voltage and current of the battery late; the supply equation holds both and stays right."""
    found: Signature = {}
    if state.battery_voltage_v is not None and state.current_a is not None:
        found["electrical"] = _late(state.motor_voltage_v, state)
    if state.battery_current_a is not None:
        found["converter"] = _late(state.battery_current_a, state)
    return found


def _late(wave: Floats, state: State) -> Floats:
    """What a wave changes by where it comes late, per second."""
    return (Spectrum(wave, state).through(delay(_STEP_S)) - wave) / _STEP_S


def _early(late: Signature) -> Signature:
    return {name: -wave for name, wave in late.items()}


def _late_motor(baseline: Baseline, state: State) -> Signature:
    """Motor and battery are read by two nodes: the motor late is all of the bus late less the battery."""
    return summed([_late_can(baseline, state), _early(_late_battery(baseline, state))])


# Channel that stands for the others of its stream -> what happens if it is late, for a second.
_LATE: Final[Mapping[str, Callable[[Baseline, State], Signature]]] = {
    FORCE.name: _late_force,
    DISPLACEMENT.name: _late_displacement,
    MOTOR_CURRENT.name: _late_motor,
    BATTERY_CURRENT.name: _late_battery,
}
