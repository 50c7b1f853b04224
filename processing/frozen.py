"""An instrument that stopped and goes on sending its last value while the machine runs."""

from __future__ import annotations

from typing import Final

import numpy as np
from sawbench.bench.plain_digits import plain
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Floats
from sawbench.processing.binning import TWO_PI

# A stroke that is shorter than the resolution of time may be level; several turns of the crank are in no signal.
_LEAST_TURNS: Final = 3.0
# Coarse converters, values held between updates and a force without noise repeat values everywhere.
_MOST_EQUAL: Final = 0.1


def frozen_part(time_s: Floats, values: Floats, angle: CrankAngle) -> tuple[float, float] | None:
    """Find the longest stretch of equal values over several strokes, in a channel that changes at every sample else.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
    angle : CrankAngle

    Returns
    -------
    (start_s, end_s) or None
        None where there is no such stretch, or all values are equal.
    """
    is_equal = np.diff(values) == 0.0
    edges = np.flatnonzero(np.diff(np.r_[False, is_equal, False]))
    if not len(edges) or is_equal.all():
        return None
    starts, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    first, last = int(starts[longest]), int(ends[longest])
    others = len(is_equal) - (last - first)
    if np.count_nonzero(is_equal) - (last - first) > _MOST_EQUAL * others:
        return None
    turned = np.diff(np.interp(time_s[[first, last]], angle.time_s, angle.angle_rad))[0]
    return (float(time_s[first]), float(time_s[last])) if turned >= _LEAST_TURNS * TWO_PI else None


def frozen_words(time_s: Floats, values: Floats, unit: str, angle: CrankAngle | None) -> tuple[str, ...]:
    """Say that a channel stands at one value while the crank turns, and when; nothing where it does not."""
    found = None if angle is None else frozen_part(time_s, values, angle)
    if found is None:
        return ()
    held = values[np.searchsorted(time_s, found[0])]
    return (
        f"stands at {held:.6g} {unit} from {plain(found[0], 's', digits=3)} to {plain(found[1], 's', digits=3)} while"
        " the crank turns: its instrument stopped sending; record again, or import the part before",
    )
