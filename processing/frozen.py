"""An instrument that stopped and goes on sending its last value while the machine runs."""

from __future__ import annotations

from typing import Final

import numpy as np
from sawbench.bench.plain_digits import plain
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Floats
from sawbench.bench.runs import run_ends
from sawbench.processing.binning import TWO_PI
from sawbench.processing.stretches import Stretches

# A stroke that is shorter than the resolution of time may be level; several turns of the crank are in no signal.
LEAST_TURNS: Final = 3
# Coarse converters, values held between updates and a force without noise repeat values everywhere.
_MOST_EQUAL: Final = 0.1


def longest_stop(time_s: Floats, values: Floats) -> tuple[float, float] | None:
    """Find the longest stretch of equal values in a channel that changes at nearly every sample else.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)

    Returns
    -------
    (start_s, end_s) or None
        None where there is no such stretch, or all values are equal. Whether the machine rests then is not asked.

    Examples
    --------
    >>> longest_stop(np.arange(8.0), np.array([0.3, 0.1, 0.2, 0.2, 0.2, 0.2, 0.4, 0.1]))
    (2.0, 5.0)
    """
    is_equal = np.diff(values) == 0.0
    if is_equal.all() or not is_equal.any():
        return None
    first, last = run_ends(is_equal)
    longest = int(np.argmax(last - first))
    n_longest = int(last[longest] - first[longest])
    if np.count_nonzero(is_equal) - n_longest > _MOST_EQUAL * (len(is_equal) - n_longest):
        return None
    return float(time_s[first[longest]]), float(time_s[last[longest]])


def stop_words(time_s: Floats, values: Floats, unit: str, stop: tuple[float, float]) -> str:
    """Say at which value a channel stands, and when."""
    held = values[np.searchsorted(time_s, stop[0])]
    since, until = (plain(one, "s", digits=3) for one in stop)
    return f"at {held + 0.0:.6g} {unit} from {since} to {until} while the crank turns"


def frozen_words(
    time_s: Floats, values: Floats, unit: str, angle: CrankAngle | None, running: Stretches
) -> tuple[str, ...]:
    """Say that a channel stands at one value while the saw runs, and when; nothing where it does not.

    A saw that coasts draws no current: only the stretches in which it runs, in the wood or in air, count.
    """
    stop = None if angle is None else longest_stop(time_s, values)
    if angle is None or stop is None:
        return ()
    inside_s = np.clip(np.array(running).reshape(-1, 2), *stop)
    turned_rad = np.diff(np.interp(inside_s, angle.time_s, angle.angle_rad), axis=1).max(initial=0.0)
    if turned_rad < LEAST_TURNS * TWO_PI:
        return ()
    where = stop_words(time_s, values, unit, stop)
    return (f"stands {where}: its instrument stopped sending; record again, or import the part before",)
