"""Where the strokes of a trial are settled: the one rule for all that compares them with settled strokes of a model.

The `running` phase of `phases` is wider: it begins as soon as the speed is that of the strokes that follow, which
is enough for a period, a mean or a fit of k_Fc, and leaves strokes in a trial of two seconds. What weighs small
residuals of the equations waits longer, until the start has faded.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from sawbench.bench.processed import CrankAngle, SteadyPart

TWO_PI = 2.0 * np.pi
# From the first motion, or the last stop, to strokes that are settled.
SETTLE_S: Final = 0.8
# A crank that is slower stands.
MOVING_RAD_S: Final = 2.0
# Turns this much longer than usual are no running strokes; two more before them belong to the stop.
_SLOW_TURN = 1.5
_STOPPING_TURNS = 2


def find_steady_part(angle: CrankAngle) -> SteadyPart:
    """Longest stretch in which the blade neither stands nor spins down.

    Examples
    --------
    >>> t = np.arange(0, 4, 1e-3)
    >>> speed = np.where(t < 0.5, 0.0, 75.0)
    >>> turning = CrankAngle(time_s=t, angle_rad=np.cumsum(speed) * 1e-3, speed_rad_s=speed,
    ...     angle_std_rad=np.zeros(4000), radius_m=0.01, source="displacement_mm", is_absolute=True)
    >>> part = find_steady_part(turning)
    >>> part.first_motion_s, round(part.settled_s, 3), part.end_s
    (0.5, 1.3, 3.999)
    """
    moving_s, last_s = float(angle.time_s[np.argmax(angle.speed_rad_s > MOVING_RAD_S)]), float(angle.time_s[-1])
    start_s, end_s = _longest_run(angle, moving_s, last_s)
    return SteadyPart(first_motion_s=moving_s, start_s=start_s, settled_s=start_s + SETTLE_S, end_s=end_s)


def _longest_run(angle: CrankAngle, moving_s: float, last_s: float) -> tuple[float, float]:
    turns = np.arange(np.ceil(angle.angle_rad[0] / TWO_PI), np.floor(angle.angle_rad[-1] / TWO_PI) + 1)
    ends_s = np.interp(TWO_PI * turns, angle.angle_rad, angle.time_s)
    ends_s = ends_s[ends_s >= moving_s]
    if len(ends_s) < 3:
        return moving_s, last_s
    usual_s = float(np.median(np.diff(ends_s)))
    # The spin-up is no stop; a record may end within a turn.
    edges_s = np.concatenate([[moving_s], ends_s, [last_s]])
    slow = np.diff(edges_s) > _SLOW_TURN * usual_s
    slow &= edges_s[1:] > moving_s + SETTLE_S
    best, start, length = (0, len(slow)), 0, -1
    for stop in [*np.flatnonzero(slow).tolist(), len(slow)]:
        if stop - start > length:
            length, best = stop - start, (start, stop)
        start = stop + 1
    first, last = best
    if last < len(slow):
        last = max(last - _STOPPING_TURNS, first)
    return float(edges_s[first]), float(edges_s[last])
