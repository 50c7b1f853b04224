"""A line in one channel whose frequency is another one in every trial: a ripple beyond half the sample rate, or pickup.

`asynchronous` asks what all trials have in common; of this they have in common that it is there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sawbench.diagnosis.inference.asynchronous import common_line, enough_trials
from sawbench.diagnosis.inference.off_stroke import OffStroke
from sawbench.diagnosis.inference.peaks import Peak
from sawbench.diagnosis.inference.settings import SETTINGS

_NUMBERS = SETTINGS.off_stroke


@dataclass(frozen=True, kw_only=True, slots=True)
class WanderingLine:
    """A line of a channel, at a frequency of its own in every trial.

    Attributes
    ----------
    channel : str
    lowest_hz, highest_hz : float
        Over the trials.
    amplitude : float
        Median over the trials, in the unit of the channel.
    """

    channel: str
    lowest_hz: float
    highest_hz: float
    amplitude: float


def wandering_lines(trials: Sequence[OffStroke]) -> list[WanderingLine]:
    """Lines that are most of what does not follow the stroke in most trials, in air as well: no wood makes them.

    Parameters
    ----------
    trials : sequence of OffStroke

    Returns
    -------
    list of WanderingLine
        By channel; without those that stand at one frequency, or at one number of cycles a stroke.
    """
    found = []
    for channel in sorted({name for t in trials for _, name in t.peaks}):
        firsts = [(t, _first(t, channel)) for t in trials if ("time", channel) in t.peaks]
        shown = [peak for _, peak in firsts if peak is not None]
        in_air = [peak for t, peak in firsts if t.is_idle]
        if len(shown) < enough_trials(len(firsts)) or not in_air or None in in_air:
            continue
        if common_line(trials, "time", channel) or common_line(trials, "stroke", channel):
            continue
        places_hz = [peak.place for peak in shown]
        amplitude = float(np.median([peak.amplitude for peak in shown]))
        found.append(
            WanderingLine(channel=channel, lowest_hz=min(places_hz), highest_hz=max(places_hz), amplitude=amplitude)
        )
    return found


def _first(trial: OffStroke, channel: str) -> Peak | None:
    """The strongest line, where it is beyond scatter and most of what does not follow the stroke."""
    peaks = trial.peaks["time", channel]
    first = max(peaks, key=lambda peak: peak.power, default=None)
    is_main = first is not None and first.power > _NUMBERS.least_power and first.share > _NUMBERS.most_of_it
    return first if is_main else None
