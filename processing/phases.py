"""What the saw was doing when: at rest, spinning up, running, spinning down, stalled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.processed import CrankAngle, Phase, PhaseKind
from sawbench.bench.recording import Floats
from sawbench.bench.runs import run_ends
from sawbench.bench.spread import robust_std

_STILL_SHARE = 0.05
_MOVES_SHARE = 0.12
_RUNS_SHARE = 0.6
_SETTLED = (0.005, 0.03)
_ENOUGH_STROKES = 3
_MAX_STD_RAD = 0.1
_STALL_MIN_S = 0.1
_STALL_SHARE = 1.3


def find_phases(
    angle: CrankAngle,
    *,
    current_time_s: Floats | None = None,
    current_a: Floats | None = None,
) -> tuple[Phase, ...]:
    """Split a trial by the crank's speed, and by the motor current where the crank stands still.

    Parameters
    ----------
    angle : CrankAngle
    current_time_s, current_a : ndarray, shape (m,), optional
        Motor current; without it a stall is called rest.

    Returns
    -------
    tuple of Phase
        Without overlap, in order, covering the whole trial.

    Notes
    -----
    Still: below 5 % of the typical speed for half a stroke (it counts as moving again above 12 %). Running
    begins where the speed over a stroke is that of the strokes that follow, within three times their scatter
    (0.5 to 3 %; always 3 % where less than three strokes would be left), and ends likewise; an angle
    uncertain by over 0.1 rad (a stroke that changes its length) is not running. Stalled: still for over 0.1 s
    at 1.3 times the running current or more.

    Examples
    --------
    >>> t = np.arange(0, 2, 1e-3)
    >>> turning = CrankAngle(time_s=t, angle_rad=100 * t, speed_rad_s=np.full(2000, 100.0),
    ...     angle_std_rad=np.zeros(2000), radius_m=0.01, source="displacement_mm", is_absolute=True)
    >>> [phase.kind for phase in find_phases(turning)]
    ['running']
    """
    time = angle.time_s
    mean_speed = stroke_mean_speed(angle)
    fast = mean_speed[mean_speed > 0.2 * np.percentile(mean_speed, 95)]
    reference = float(np.median(fast)) if len(fast) else 0.0
    if reference <= 0:
        return (Phase(kind="rest", start_s=float(time[0]), end_s=float(time[-1])),)
    knows = angle.angle_std_rad < _MAX_STD_RAD
    is_moving = _with_hysteresis(angle.speed_rad_s, _STILL_SHARE * reference, _MOVES_SHARE * reference)
    is_moving = without_short_breaks(time, is_moving, np.pi / reference)
    speed = np.where(knows, mean_speed, 0.0)
    phases: tuple[Phase, ...] = ()
    for tolerance in _SETTLED:
        kinds = np.full(len(time), "rest", dtype="<U9")
        for first, last in runs(is_moving):
            kinds[first:last] = _moving_kinds(time, speed, reference, first, last, tolerance)
        phases = _as_phases(time, kinds)
        running_s = sum(phase.end_s - phase.start_s for phase in phases if phase.kind == "running")
        if running_s * reference > 2 * np.pi * _ENOUGH_STROKES:
            break
    if current_time_s is None or current_a is None:
        return phases
    return tuple(_stalled(phase, phases, current_time_s, current_a) for phase in phases)


def stroke_mean_speed(angle: CrankAngle) -> Floats:
    """Speed averaged over the turn around each sample, so that the ripple within a stroke drops out.

    Returns
    -------
    ndarray, shape (n,), rad/s
        Within half a turn of the ends of the trial that of the first and the last whole turn.
    """
    phi, time = angle.angle_rad, angle.time_s
    strictly = phi + np.linspace(0.0, 1e-9, len(phi))
    half = min(np.pi, 0.5 * float(strictly[-1] - strictly[0]))
    middle = np.clip(strictly, strictly[0] + half, strictly[-1] - half)
    low, high = middle - half, middle + half
    width = np.interp(high, strictly, time) - np.interp(low, strictly, time)
    return (high - low) / np.maximum(width, 1e-12)


def _with_hysteresis(speed: Floats, off: float, on: float) -> NDArray[np.bool_]:
    """Give True from where `speed` rises above `on` until it falls below `off`."""
    state = np.where(speed > on, 1, np.where(speed < off, 0, -1))
    known = np.flatnonzero(state >= 0)
    if not len(known):
        return np.zeros(len(speed), dtype=bool)
    latest = known[np.maximum(np.searchsorted(known, np.arange(len(speed)), side="right") - 1, 0)]
    return state[latest] == 1


def without_short_breaks(at: Floats, mask: NDArray[np.bool_], shortest: float) -> NDArray[np.bool_]:
    """Bridge what lies between two stretches of a mask and is shorter than `shortest`, in the unit of `at`."""
    bridged = mask.copy()
    for first, last in runs(~mask):
        if first > 0 and last < len(at) and at[last] - at[first] < shortest:
            bridged[first:last] = True
    return bridged


def runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First element, and one past the last, of every stretch in which a mask holds.

    Examples
    --------
    >>> runs(np.array([True, True, False, True]))
    [(0, 2), (3, 4)]
    """
    first, end = run_ends(mask)
    return list(zip(first.tolist(), end.tolist(), strict=True))


def _moving_kinds(
    time: Floats, mean_speed: Floats, reference: float, first: int, last: int, tolerance: float
) -> NDArray[np.str_]:
    """Split one moving stretch into spin-up, running and spin-down."""
    kinds = np.full(last - first, "spin_up", dtype="<U9")
    begin = first if first == 0 and _is_settled(time, mean_speed, 0, 1, reference, tolerance) else None
    end = last if last == len(time) and _is_settled(time, mean_speed, last - 1, -1, reference, tolerance) else None
    stroke_s = 2 * np.pi / reference
    edges = np.searchsorted(time, np.arange(time[first], time[last - 1], 0.25 * stroke_s))
    if begin is None:
        begin = _first_settled(time, mean_speed, edges, 1, reference, tolerance)
    if begin is None:
        return kinds
    if end is None:
        end = _first_settled(time, mean_speed, edges[::-1], -1, reference, tolerance)
    if end is None or end <= begin:
        end = last
    kinds[begin - first : end - first] = "running"
    kinds[end - first :] = "spin_down"
    return kinds


def _first_settled(
    time: Floats,
    mean_speed: Floats,
    edges: NDArray[np.int64],
    direction: int,
    reference: float,
    tolerance: float,
) -> int | None:
    """First of the edges from which on three in a row are settled."""
    settled = 0
    for position, edge in enumerate(edges):
        is_settled = _is_settled(time, mean_speed, int(edge), direction, reference, tolerance)
        settled = settled + 1 if is_settled else 0
        if settled == 3 or (settled and position == len(edges) - 1):
            return int(edges[position - settled + 1])
    return None


def _is_settled(time: Floats, mean_speed: Floats, k: int, direction: int, reference: float, tolerance: float) -> bool:
    """Whether the speed at sample k is that of the six strokes after it (or before it)."""
    here = mean_speed[k]
    if here < _RUNS_SHARE * reference:
        return False
    stroke_s = 2 * np.pi / reference
    a, b = time[k] + direction * stroke_s, time[k] + direction * 6 * stroke_s
    first, last = np.searchsorted(time, [min(a, b), max(a, b)])
    beyond = mean_speed[first:last]
    beyond = beyond[beyond > _RUNS_SHARE * reference]
    if len(beyond) < 4:
        return abs(here / reference - 1) < _SETTLED[1]
    level = float(np.median(beyond))
    scatter = robust_std(beyond - level) / level
    return abs(here / level - 1) < min(max(3 * scatter, tolerance), _SETTLED[1])


def _as_phases(time: Floats, kinds: NDArray[np.str_]) -> tuple[Phase, ...]:
    starts = np.r_[0, np.flatnonzero(kinds[1:] != kinds[:-1]) + 1]
    ends = np.r_[starts[1:], len(time) - 1]
    phases = []
    for start, end in zip(starts, ends, strict=True):
        known: PhaseKind = str(kinds[start])  # type: ignore[assignment]
        phases.append(Phase(kind=known, start_s=float(time[start]), end_s=float(time[end])))
    return tuple(phases)


def _stalled(phase: Phase, phases: tuple[Phase, ...], time: Floats, current: Floats) -> Phase:
    """Return a rest as a stall where the motor pulls hard against it."""
    if phase.kind != "rest" or phase.end_s - phase.start_s < _STALL_MIN_S:
        return phase
    running = np.zeros(len(time), dtype=bool)
    for other in phases:
        if other.kind == "running":
            running |= (time >= other.start_s) & (time <= other.end_s)
    here = np.abs(current[(time >= phase.start_s) & (time <= phase.end_s)])
    if not running.any() or not len(here):
        return phase
    if float(np.median(here)) > _STALL_SHARE * float(np.mean(np.abs(current[running]))):
        return Phase(kind="stall", start_s=phase.start_s, end_s=phase.end_s)
    return phase


def stalled_from_start(time_s: Floats, current_a: Floats, noise_std_a: float, expected_a: float | None) -> bool:
    """Whether the motor pulls a stall current although nothing moves.

    Parameters
    ----------
    time_s, current_a : ndarray, shape (m,)
    noise_std_a : float
    expected_a : float or None
        Stall current of the plant (voltage over resistance), A.

    Returns
    -------
    bool
        True where the trial lasts over 0.1 s and the median current exceeds a quarter of `expected_a` (2 A
        where unknown) and ten noise standard deviations.
    """
    if not len(current_a) or time_s[-1] - time_s[0] < _STALL_MIN_S:
        return False
    level = float(np.median(np.abs(current_a)))
    return level > max(0.25 * expected_a if expected_a else 2.0, 10 * noise_std_a)
