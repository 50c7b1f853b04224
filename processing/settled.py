"""Where the strokes of a trial are settled: the one rule for all that compares them with settled strokes of a model.

The `running` phase of `phases` is wider: it begins as soon as the speed is that of the strokes that follow, which
is enough for a period, a mean or a fit of k_Fc, and leaves strokes in a trial of two seconds. What weighs small
residuals of the equations waits longer, until the start has faded.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from sawbench.bench.processed import CrankAngle, Cut, SteadyPart
from sawbench.bench.recording import Floats
from sawbench.bench.spread import robust_std

TWO_PI = 2.0 * np.pi
# From the first motion, or the last stop, to strokes that are settled.
SETTLE_S: Final = 0.8
# From the first stroke that is wholly in the wood to a speed that is that of the load.
LOADED_S: Final = 0.4
# A crank that is slower stands.
MOVING_RAD_S: Final = 2.0
# Before the first quarter turn is done for longer than that it stands; its speed is noise then, and motion is so many
# standard deviations of it.
_QUARTER_TURN_S: Final = 0.1
_SURELY: Final = 4.0
# Turns this much longer than usual are no running strokes.
_SLOW_TURN = 1.5
# Nor are the last turns of a record or before a stop where each is longer than the one before, and all of them together
# gain so many times what as many turns gain or lose elsewhere; nor two more, in which the trigger was let go.
_RUN_DOWN = 4.0
_STOPPING_TURNS = 2
# A motor whose current stays below that share of what it reaches in a usual turn is not driven any more.
_LEAST_CURRENT_SHARE = 0.25


def find_steady_part(
    angle: CrankAngle, cut: Cut | None = None, motor_current: tuple[Floats, Floats] | None = None
) -> SteadyPart:
    """Longest stretch in which the blade neither stands nor spins down, and cuts where it is to cut.

    Parameters
    ----------
    angle : CrankAngle
    cut : Cut, optional
    motor_current : (time_s, values), optional
        Says exactly when the trigger was let go; without it, only turns that grow longer do.

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
    moving_s, last_s = _first_motion_s(angle), float(angle.time_s[-1])
    start_s, end_s = _longest_run(angle, moving_s, last_s)
    if motor_current is not None:
        end_s = min(end_s, max(_driven_until_s(angle, *motor_current), start_s))
    settled_s = start_s + SETTLE_S
    if cut is not None:
        settled_s = settled_s if cut.start_s is None else max(settled_s, cut.start_s + LOADED_S)
        end_s = end_s if cut.end_s is None else min(end_s, cut.end_s)
    return SteadyPart(first_motion_s=moving_s, start_s=start_s, settled_s=settled_s, end_s=end_s, cut=cut)


def _first_motion_s(angle: CrankAngle) -> float:
    """When the crank last stood before its first quarter turn; the noise of a crank at rest turns nothing."""
    turned = int(np.argmax(angle.angle_rad > angle.angle_rad[0] + 0.25 * TWO_PI))
    at_rest = np.abs(angle.speed_rad_s[: np.searchsorted(angle.time_s, angle.time_s[turned] - _QUARTER_TURN_S)])
    noise_rad_s = robust_std(at_rest) if len(at_rest) else 0.0
    moving_rad_s = max(MOVING_RAD_S, _SURELY * noise_rad_s)
    standing = np.flatnonzero(angle.speed_rad_s[:turned] <= moving_rad_s)
    return float(angle.time_s[standing[-1] + 1 if len(standing) else 0])


def _turn_ends_s(angle: CrankAngle) -> Floats:
    """Times at which a turn ends and the next one begins."""
    turns = np.arange(np.ceil(angle.angle_rad[0] / TWO_PI), np.floor(angle.angle_rad[-1] / TWO_PI) + 1)
    return np.interp(TWO_PI * turns, angle.angle_rad, angle.time_s)


def _driven_until_s(angle: CrankAngle, time_s: Floats, current_a: Floats) -> float:
    """Begin of the turn in which the current goes away for good; infinite where it is there in the last turn."""
    ends_s = _turn_ends_s(angle)
    ends_s = ends_s[(ends_s > time_s[0]) & (ends_s < time_s[-1])]
    if len(ends_s) < 3:
        return np.inf
    driving_a = np.sign(np.median(current_a)) * current_a
    tops_a = np.maximum.reduceat(driving_a, np.searchsorted(time_s, ends_s))
    is_driven = driving_a > _LEAST_CURRENT_SHARE * float(np.median(tops_a))
    if not is_driven.any():
        return np.inf
    last_s = float(time_s[np.flatnonzero(is_driven)[-1]])
    if time_s[-1] - last_s < float(np.median(np.diff(ends_s))):
        return np.inf
    return float(ends_s[max(int(np.searchsorted(ends_s, last_s)) - 1, 0)])


def _longest_run(angle: CrankAngle, moving_s: float, last_s: float) -> tuple[float, float]:
    ends_s = _turn_ends_s(angle)
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
    settled = max(first, int(np.searchsorted(edges_s, edges_s[first] + SETTLE_S)))
    run_down = _first_of_run_down(np.diff(edges_s), settled, last)
    if run_down < len(slow):
        last = max(run_down - _STOPPING_TURNS, first)
    return float(edges_s[first]), float(edges_s[last])


def _first_of_run_down(turns_s: Floats, first: int, last: int) -> int:
    """First turn after the drive was switched off, of the turns from `first` to before `last`; `last` where it was not.

    Without drive each turn takes longer than the one before. A record may end before the blade has slowed down much.
    """
    settled = turns_s[first : min(last, len(turns_s) - 1)]  # what ends the record is no whole turn
    is_longer = np.r_[False, np.diff(settled) > 0.0]
    n_before = len(settled) - int(np.argmin(is_longer[::-1])) if len(settled) else 0
    n_longer = len(settled) - n_before
    if not 0 < 2 * n_longer <= n_before:
        return last
    elsewhere = np.abs(settled[n_longer:n_before] - settled[: n_before - n_longer])
    gained = settled[-1] - settled[n_before - 1]
    return first + n_before if gained > _RUN_DOWN * float(elsewhere.max()) else last
