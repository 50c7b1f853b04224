"""One rate of each instrument in all trials of a campaign: where one trial hides it, the others tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from sawbench.bench.processed import TrackedTrial
from sawbench.bench.recording import Floats, Recording, Signal
from sawbench.bench.second_core import on_two_cores
from sawbench.processing.held_values import BUSY_BUS, alignment_of_rows, without_repeats
from sawbench.processing.hidden_samples import hidden_period, is_hidden_by, samples_at_period
from sawbench.processing.interpolated_rows import last_digit

# A table has more rows than an instrument has samples by at least this factor where they are no samples.
_SLOWER: Final = 1.4
# Trials in which a period is looked for, from the slowest to the fastest; those that show the same one, at the least.
_LOOKED_AT, _LEAST_TRIALS = 5, 2
# By how much the periods of one clock may differ, and stroke rates of one operating point.
_ALIKE: Final = 0.01


def with_samples(recordings: Sequence[Recording], tracked: Sequence[TrackedTrial]) -> dict[int, Recording]:
    """Keep the samples of instruments that are slower than a table's rows, also where one trial does not show it.

    Parameters
    ----------
    recordings : sequence of Recording
    tracked : sequence of TrackedTrial
        Of each recording, without the rows between the samples that it shows by itself.

    Returns
    -------
    dict of int to Recording
        Those that change, by their place.
    """
    seen = _seen(recordings, tracked)
    periods_s = {name: _common(of_trials) for name, of_trials in seen.items()}
    known = {name: period_s for name, period_s in periods_s.items() if period_s is not None}
    asked = [(at, name, period_s) for name, period_s in known.items() for at in seen[name].without]
    sampled = on_two_cores(lambda one: _sampled(recordings[one[0]].signals[one[1]], one[2]), asked)
    changed: dict[int, Recording] = {}
    for (at, name, _), signal in zip(asked, sampled, strict=True):
        if signal is not None:
            recording = changed.get(at, recordings[at])
            changed[at] = replace(recording, signals={**recording.signals, name: signal})
    return changed


@dataclass(frozen=True, kw_only=True, slots=True)
class _Seen:
    """One channel in all trials.

    Attributes
    ----------
    shown : tuple of (period_s, rate_hz)
        Sample period of the instrument, of trials that show it, and their stroke rate.
    without : tuple of int
        Places of the trials in which every row may be a sample.
    n_looked_at : int
    """

    shown: tuple[tuple[float, float], ...]
    without: tuple[int, ...]
    n_looked_at: int


def _seen(recordings: Sequence[Recording], tracked: Sequence[TrackedTrial]) -> dict[str, _Seen]:
    """What the trials show of every channel that is slower than its rows, or may be."""
    rates_hz = [_stroke_rate_hz(trial) for trial in tracked]
    shown: dict[str, list[tuple[float, float]]] = {}
    without: dict[str, list[int]] = {}
    for at, (recording, trial) in enumerate(zip(recordings, tracked, strict=True)):
        for quality in trial.quality:
            if len(recording.signals[quality.channel].values) <= _SLOWER * quality.n_samples:
                without.setdefault(quality.channel, []).append(at)
            elif quality.rate_hz > 0.0:
                shown.setdefault(quality.channel, []).append((1.0 / quality.rate_hz, rates_hz[at]))
    asked = []
    for name, places in without.items():
        if len(shown.get(name, ())) < _LEAST_TRIALS:
            by_rate = sorted(places, key=lambda at: rates_hz[at])
            some = np.unique(np.linspace(0, len(by_rate) - 1, _LOOKED_AT).astype(int))
            asked += [(name, by_rate[k]) for k in some]
    hidden = on_two_cores(lambda one: _hidden_period(recordings[one[1]].signals[one[0]]), asked)
    looked_at = {name: len(of_trials) for name, of_trials in shown.items()}
    for (name, at), (is_hidden, period_s) in zip(asked, hidden, strict=True):
        looked_at[name] = looked_at.get(name, 0) + is_hidden
        if period_s is not None:
            shown.setdefault(name, []).append((period_s, rates_hz[at]))
    return {
        name: _Seen(shown=tuple(of_trials), without=tuple(without.get(name, ())), n_looked_at=looked_at[name])
        for name, of_trials in shown.items()
    }  # fmt: skip


def _stroke_rate_hz(trial: TrackedTrial) -> float:
    """0 where there is no angle."""
    return 0.0 if trial.angle is None else float(np.median(trial.angle.speed_rad_s)) / (2.0 * np.pi)


def _hidden_period(signal: Signal) -> tuple[bool, float | None]:
    """Whether a busy bus or the last digit may hide samples, and the period that they show all the same."""
    own_s, _ = without_repeats(signal.time_s, signal.values, BUSY_BUS)
    if len(own_s) < len(signal.values):
        return True, float(np.median(np.diff(own_s)))
    digit = last_digit(signal.values) if len(signal.values) > 1 else 0.0
    is_hidden = is_hidden_by(signal.values, digit)
    return is_hidden, hidden_period(signal.time_s, signal.values, digit) if is_hidden else None


def _common(seen: _Seen) -> float | None:
    """Period that most trials show, of different stroke rates: what the machine does has another one at each, s."""
    periods_s, rates_hz = np.array(seen.shown).T
    middle_s = float(np.median(periods_s))
    is_alike = np.abs(periods_s / middle_s - 1.0) < _ALIKE
    alike_hz = rates_hz[is_alike]
    if 2 * len(alike_hz) <= seen.n_looked_at or len(alike_hz) < _LEAST_TRIALS:
        return None
    return middle_s if np.ptp(alike_hz) > _ALIKE * alike_hz.max() else None


def _sampled(signal: Signal, period_s: float) -> Signal | None:
    """Signal of the samples alone, of an instrument of that period; None where its rows were not made of them."""
    found = _at_period(signal, period_s) if signal.rate_hz * period_s > _SLOWER else None
    if found is None:
        return None
    time_s, values = found
    alignment = alignment_of_rows(signal.time_s, time_s)
    return replace(signal, time_s=time_s, values=values, raw=None, alignment=alignment)


def _at_period(signal: Signal, period_s: float) -> tuple[Floats, Floats] | None:
    """Samples of an instrument of that period that a table holds or draws lines between; None where it does neither."""
    own_s, own = without_repeats(signal.time_s, signal.values, BUSY_BUS)
    if abs(float(np.median(np.diff(own_s))) / period_s - 1.0) < _ALIKE:
        return own_s, own
    digit = last_digit(signal.values)
    return samples_at_period(signal.time_s, signal.values, period_s, digit) if digit > 0.0 else None
