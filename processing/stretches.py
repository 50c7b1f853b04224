"""Where a channel has samples, and where it has none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sawbench.bench.recording import Floats, Gap

_GAP_PERIODS = 2.5

Stretches = tuple[tuple[float, float], ...]


def longest_step(step_s: Floats) -> float:
    """Longest time between neighbouring samples that is no hole, s; 0 without samples.

    Parameters
    ----------
    step_s : ndarray, shape (n,), s
    """
    if not len(step_s):
        return 0.0
    return max(_GAP_PERIODS * float(np.median(step_s)), 1.5 * float(np.percentile(step_s, 98.0)))


def holes_of(time_s: Floats, gaps: Sequence[Gap], longest_s: float) -> Stretches:
    """Where no sample is: the gaps that a recording states, and those that a table says nothing of.

    A stated gap that is no longer than a usual step may be is none: a sample is interpolated over it.

    Parameters
    ----------
    time_s : ndarray, shape (n,), s
    gaps : sequence of Gap
    longest_s : float
        By `longest_step`.

    Returns
    -------
    tuple of (start_s, end_s)
        In order.

    Examples
    --------
    >>> holes_of(np.array([0.0, 1.0, 2.0, 8.0, 9.0]), (), 2.5)
    ((2.0, 8.0),)
    """
    found = {(float(time_s[k]), float(time_s[k + 1])) for k in np.flatnonzero(np.diff(time_s) > longest_s)}
    return tuple(sorted(found | {(gap.start_s, gap.end_s) for gap in gaps if gap.end_s - gap.start_s > longest_s}))


def without_holes(stretches: Stretches, holes: Stretches) -> Stretches:
    """Cut the holes out of the stretches.

    Parameters
    ----------
    stretches, holes : tuple of (start_s, end_s)

    Examples
    --------
    >>> without_holes(((0.0, 5.0), (6.0, 9.0)), ((1.0, 2.0), (4.0, 7.0)))
    ((0.0, 1.0), (2.0, 4.0), (7.0, 9.0))
    """
    left = list(stretches)
    for low, high in holes:
        cut = []
        for start, end in left:
            if end <= low or start >= high:
                cut.append((start, end))
                continue
            cut += [part for part in ((start, low), (high, end)) if part[1] > part[0]]
        left = cut
    return tuple(left)
