"""Channels that are dead or out of range, trial by trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from sawbench.bench.converter import clipped_levels
from sawbench.bench.recording import Recording, Signal
from sawbench.bench.second_core import on_two_cores
from sawbench.bench.units import BATTERY_CURRENT, BATTERY_VOLTAGE, CHANNEL_BY_NAME, DISPLACEMENT, FORCE, MOTOR_CURRENT
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.trial_names import some
from sawbench.diagnosis.trial_reading import bulk_of, stroke_starts
from sawbench.processing.frozen import LEAST_TURNS, longest_stop, stop_words
from sawbench.processing.interpolated_rows import own_samples
from sawbench.processing.spikes import find_spikes

# A rest at the end that is longer than a quarter of the record is no rest: the channel has died.
_LONG_END: Final = 4
# Share of its stroke, or current, that a machine at rest has.
_RESTS: Final = 0.1
# In air these may hold one level of a coarse converter for long.
_MAY_HOLD: Final = frozenset({FORCE.name, BATTERY_CURRENT.name, BATTERY_VOLTAGE.name})


def without_defects(recordings: Sequence[Recording], warnings: list[str]) -> list[Recording]:
    """Drop channels that are constant or stuck at an end of their range; one warning a channel and defect."""
    out = []
    found: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for recording, defects in zip(recordings, on_two_cores(_defects_of, recordings), strict=True):
        for name, (seen, meaning) in defects.items():
            found.setdefault((name, meaning), []).append((recording.trial.trial_id, seen))
        intact = {name: signal for name, signal in recording.signals.items() if name not in defects}
        out.append(replace(recording, signals=intact))
    for (name, meaning), trials in found.items():
        labels = some([trial for trial, _ in trials])
        warnings.append(f"{labels}: {name} left out: {trials[0][1]}: {meaning}")
    return out


def _defects_of(recording: Recording) -> dict[str, tuple[str, str]]:
    """`defect_of` every channel that has one, by its name."""
    known = {name: signal for name, signal in recording.signals.items() if name in CHANNEL_BY_NAME}
    found = {}
    for name, signal in known.items():
        defect = defect_of(signal, [other for other_name, other in known.items() if other_name != name])
        if defect is not None:
            found[name] = defect
    return found


def defect_of(signal: Signal, others: Sequence[Signal] = ()) -> tuple[str, str] | None:
    """What is wrong with a channel.

    Parameters
    ----------
    signal : Signal
    others : sequence of Signal
        Of the same trial: where the machine rests, a sensor that does not change is no dead one.

    Returns
    -------
    (str, str) or None
        What is seen, and what it means.
    """
    time_s, values = own_samples(signal.time_s, signal.values)
    if len(values) < 16:
        return f"it has {len(values)} samples", "too few samples"
    if values.min() == values.max():
        return f"it is constant at {values[0] + 0.0:.6g} {signal.unit}", "dead sensor or missing cable"
    at_end = len(values) - 1 - int(np.flatnonzero(values != values[-1])[-1])
    is_long = at_end > len(values) / _LONG_END and (values[-1] == 0.0 or signal.channel not in _MAY_HOLD)
    # In the second half of that time: a blade runs on for a while without current.
    if is_long and not _stands_still([signal, *others], since_s=0.5 * float(time_s[-at_end] + time_s[-1])):
        return f"it stays at {values[-1] + 0.0:.6g} {signal.unit} to the end", "dead sensor or missing cable"
    stop = longest_stop(time_s, values)
    # A saw that coasts to the end draws no current.
    coasts = at_end > 0 and values[-1] == 0.0
    if stop is not None and not coasts and _has_strokes(others, stop):
        return f"it stays {stop_words(time_s, values, signal.unit, stop)}", "its instrument stopped sending"
    for level, n_there in clipped_levels(values[~find_spikes(values)]).items():
        if n_there >= SETTINGS.screening.saturated_share * len(values):
            seen = f"{n_there / len(values):.1%} of its samples are at {level:.6g} {signal.unit}".replace("%", " %")
            return seen, "range of the sensor exceeded"
    return None


def _has_strokes(others: Sequence[Signal], during_s: tuple[float, float]) -> bool:
    """Whether the displacement, where there is one, goes up and down several times."""
    for signal in others:
        if signal.channel == DISPLACEMENT.name and len(signal.values):
            starts_s = stroke_starts(signal.time_s, signal.values, bulk_of(signal.values))
            return bool(np.sum((starts_s >= during_s[0]) & (starts_s <= during_s[1])) > LEAST_TURNS)
    return False


def _stands_still(signals: Sequence[Signal], since_s: float) -> bool:
    """Whether the machine rests from then on, by all that tells: stroke and current, both of them."""
    telling = [signal for signal in signals if signal.channel in (DISPLACEMENT.name, MOTOR_CURRENT.name)]
    return len(telling) > 1 and all(_rests(signal, since_s) for signal in telling)


def _rests(signal: Signal, since_s: float) -> bool:
    late = signal.time_s >= since_s
    if late.all() or not late.any():
        return False
    # The blade rests anywhere, a motor at rest draws nothing.
    size = np.ptp if signal.channel == DISPLACEMENT.name else lambda values: abs(values.mean())
    return bool(size(signal.values[late]) < _RESTS * size(signal.values[~late]))
