"""Which strokes of a cutting trial cut: a saw is started in air, pushed into the wood, and taken out before it stops.

The force of a stroke in the wood follows the turn, in air it does not. Its first harmonic divided by the stroke rate
hardly depends on the speed, so that strokes of the spin-up count as well.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.processed import CrankAngle, Cut, Phase
from sawbench.bench.recording import Floats
from sawbench.processing.binning import TWO_PI, AngleGrid
from sawbench.processing.phases import runs, without_short_breaks

# Of the strokes that cut most, a tenth of all: less is air. Fewer strokes in a row are a hole or a crack of the wood.
_LEAST_SHARE, _STRONG_PERCENTILE, _FEWEST_STROKES = 0.25, 90.0, 3
# Of the usual stroke in the wood: the blade has gone in wholly.
_WHOLLY_SHARE = 0.7
# It comes out where more strokes than one at the end, at the usual rate, are less than that of those in the last part
# of the cut: the recording may end before a stroke is in air.
_LEAVING_STROKES, _LAST_PART, _SLOW = 2, 0.25, 1.4
_LEAST_OVER_SCATTER = 10.0


def find_cut(angle: CrankAngle, time_s: Floats, force_n: Floats) -> Cut | None:
    """Longest stretch of strokes that cut, in a trial that is to cut.

    Parameters
    ----------
    angle : CrankAngle
    time_s, force_n : ndarray, shape (n,)

    Returns
    -------
    Cut or None
        None where every stroke cuts, where the force does not follow the stroke, or where it is too short to tell.

    Examples
    --------
    >>> t = np.arange(0, 6, 1e-3)
    >>> turning = CrankAngle(time_s=t, angle_rad=TWO_PI * 10.0 * t, speed_rad_s=np.full(6000, 62.8),
    ...     angle_std_rad=np.zeros(6000), radius_m=0.01, source="displacement_mm", is_absolute=True)
    >>> force_n = np.where((t > 2.0) & (t < 5.0), 100.0 * np.maximum(np.sin(TWO_PI * 10.0 * t), 0.0), 0.0)
    >>> cut = find_cut(turning, t, force_n)
    >>> round(cut.start_s, 2), round(cut.end_s, 2)
    (2.1, 4.9)
    """
    first, last = int(np.ceil(angle.angle_rad[0] / TWO_PI)), int(np.floor(angle.angle_rad[-1] / TWO_PI))
    if last - first < 4 * _FEWEST_STROKES:
        return None
    begins_s = np.interp(TWO_PI * np.arange(first, last + 1), angle.angle_rad, angle.time_s)
    quarters = AngleGrid(first_turn=first, n_rows=last - first, n_bins=4)
    means = quarters.means(quarters.place(np.interp(time_s, angle.time_s, angle.angle_rad)), force_n)
    period_s = np.diff(begins_s)
    hardness = np.hypot(means[:, 0] - means[:, 2], means[:, 1] - means[:, 3]) * period_s
    known = hardness[~np.isnan(hardness)]
    if len(known) < 4 * _FEWEST_STROKES:
        return None
    strong, scatter = float(np.percentile(known, _STRONG_PERCENTILE)), float(np.median(np.abs(np.diff(known))))
    if strong <= _LEAST_OVER_SCATTER * scatter:
        return None
    begin, end = _longest(np.isnan(hardness) | (hardness > _LEAST_SHARE * strong))
    wholly = begin + np.flatnonzero(hardness[begin:end] >= _WHOLLY_SHARE * np.nanmedian(hardness[begin:end]))
    if not len(wholly):
        return None
    late = hardness[wholly[-max(int(_LAST_PART * len(wholly)), 1) :]]
    is_weak = (hardness < _WHOLLY_SHARE * np.median(late)) & (period_s < _SLOW * np.median(period_s))
    is_out = len(hardness) - end >= _FEWEST_STROKES or bool(is_weak[-_LEAVING_STROKES:].all())
    # On its way in and out the blade takes as long from there to the usual force as it took before, about.
    inside, leaving = wholly[0] + 1 + (wholly[0] - begin), wholly[-1] - (end - 1 - wholly[-1])
    if leaving - inside < 2 * _FEWEST_STROKES:
        return None
    start_s = float(begins_s[inside]) if begin >= _FEWEST_STROKES else None
    end_s = float(begins_s[leaving]) if is_out else None
    return None if start_s is None and end_s is None else Cut(start_s=start_s, end_s=end_s)


def _longest(cuts: NDArray[np.bool_]) -> tuple[int, int]:
    """First stroke, and one past the last, of the longest run that no row of strokes in air interrupts."""
    bridged = without_short_breaks(np.arange(len(cuts), dtype=np.float64), cuts, _FEWEST_STROKES)
    return max(runs(bridged), key=lambda run: run[1] - run[0])


def with_air(phases: tuple[Phase, ...], cut: Cut | None) -> tuple[Phase, ...]:
    """Call the running strokes before and behind a cut what they are.

    Parameters
    ----------
    phases : tuple of Phase
    cut : Cut or None

    Returns
    -------
    tuple of Phase
        In order, covering the same time.
    """
    if cut is None:
        return phases
    start_s = -np.inf if cut.start_s is None else cut.start_s
    end_s = np.inf if cut.end_s is None else cut.end_s
    found = []
    for phase in phases:
        if phase.kind != "running":
            found.append(phase)
            continue
        edges = np.clip([phase.start_s, start_s, end_s, phase.end_s], phase.start_s, phase.end_s).tolist()
        parts = zip(("in_air", "running", "in_air"), pairwise(edges), strict=True)
        found += [Phase(kind=kind, start_s=a, end_s=b) for kind, (a, b) in parts if b > a]
    return tuple(found)
