"""The ripple of a commutator: lines of currents and voltages at whole multiples of the motor's turns.

Every brushed motor has it. As its bars pass the brushes the back-EMF ripples by a few per cent, as many times a turn as
it has bars or twice as often, and as no armature is wound quite evenly there is a smaller line at each turn and half
turn. A shorted coil or a broken bar leaves a large one there. A converter's switching leaves a line as well, at one
frequency in Hz, which sampling may place anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from sawbench.bench.units import ELECTRICAL
from sawbench.diagnosis.inference.off_stroke import OffStroke
from sawbench.diagnosis.inference.peaks import Peak
from sawbench.diagnosis.inference.settings import SETTINGS

# Of a motor with a commutator.
_FEWEST_BARS: Final = 3
_NUMBERS: Final = SETTINGS.off_stroke


def is_commutation(
    trials: Sequence[OffStroke], name: str, line: Sequence[tuple[OffStroke, Peak]], *, is_over_time: bool,
    turns_a_stroke: float | None,
) -> bool:  # fmt: skip
    """Whether a line is the ordinary ripple of a commutator.

    Parameters
    ----------
    trials : sequence of OffStroke
        Of the campaign: the largest mean of the channel is what the ripple is compared with.
    name : str
        Channel of the line.
    line : sequence of (OffStroke, Peak)
        Its peaks, with their trials.
    is_over_time : bool
        Places are in Hz, else in cycles a stroke.
    turns_a_stroke : float or None
        Of the motor; None for a machine whose motor is not modelled.
    """
    if name not in ELECTRICAL or turns_a_stroke is None:
        return False
    strokes_a_unit = np.array([1.0 / trial.rate_hz if is_over_time else 1.0 for trial, _ in line])
    orders = strokes_a_unit * np.array([peak.place for _, peak in line])
    widths = strokes_a_unit * np.array([peak.width for _, peak in line])
    times_a_turn = round(float(np.median(orders)) / turns_a_stroke)
    off = np.abs(orders - times_a_turn * turns_a_stroke)
    if times_a_turn < 1 or np.any(off > np.maximum(_NUMBERS.same_place * orders, 1.5 * widths)):
        return False
    most = _NUMBERS.ripple_of_bars if times_a_turn >= _FEWEST_BARS else _NUMBERS.ripple_of_armature
    return _is_below(most, trials, name, line)


def is_switching(trials: Sequence[OffStroke], name: str, line: Sequence[tuple[OffStroke, Peak]]) -> bool:
    """Whether a line at a fixed frequency is what a converter's switching leaves, which sampling may place anywhere.

    Parameters
    ----------
    trials, name, line
        As for `is_commutation`.
    """
    return name in ELECTRICAL and _is_below(_NUMBERS.ripple_of_converter, trials, name, line)


def _is_below(share: float, trials: Sequence[OffStroke], name: str, line: Sequence[tuple[OffStroke, Peak]]) -> bool:
    """Whether the amplitude of a line is less than a share of the largest mean of its channel."""
    largest = max(trial.level.get(name, 0.0) for trial in trials)
    return float(np.median([peak.amplitude for _, peak in line])) < share * largest
