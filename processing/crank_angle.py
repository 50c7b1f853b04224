"""Crank angle and speed over time, from the plunger's displacement.

1. The displacement is unfolded at its turning points: y = c + x(angle), angle always forward.
2. Offset and radius come from the dead centres themselves, so a wrong nominal radius or a sensor centred on
   zero does no harm.
3. An iterated Kalman smoother (`angle_smoother`) finds the most probable smooth trajectory through all
   samples; the strength of the jerk is chosen by likelihood, the noise by the residuals, outliers are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Floats
from sawbench.bench.spread import robust_std
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.processing.angle_smoother import linearise, smooth
from sawbench.processing.noise import robust_range, white_noise_std
from sawbench.processing.sliding import median_of_five
from sawbench.processing.stroke_extremes import (
    LONGEST_STEP,
    Travel,
    Turns,
    estimate_travel,
    find_rest,
    find_turns,
    moving_mean,
)

_KNOTS_A_STROKE = 128
_CHUNK = 1 << 17
_OVERLAP_STROKES = 4
_RIPPLES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
_OUTLIER_STDS = 6.0
_FIRST_PASS_SLOPE = 0.3
_VARYING_STROKE = 0.01
_REST_SPEED_SHARE = 1e-3


@dataclass(frozen=True, kw_only=True, slots=True)
class _Unfolded:
    """Displacement with the crude angle that belongs to it."""

    time_s: Floats
    displacement_m: Floats
    angle_rad: Floats
    is_rest: NDArray[np.bool_]
    is_averaged: NDArray[np.bool_]  # crude angle precise enough to linearise about near a dead centre
    travel: Travel
    mechanism: Mechanism  # of the measured radius
    speed_scale_rad_s: float
    noise_std_m: float


def track_crank_angle(
    time_s: Floats,
    displacement_m: Floats,
    *,
    mechanism: Mechanism | None = None,
    source: str = "displacement_mm",
) -> CrankAngle | None:
    """Crank angle, speed and their uncertainty from the displacement of the plunger.

    Parameters
    ----------
    time_s : ndarray, shape (n,), s
        Strictly increasing; may jitter and have gaps.
    displacement_m : ndarray, shape (n,), m
        c + r (1 - cos angle), any c; noise, drift of c and r, and outliers allowed.
    mechanism : Mechanism, optional
        Nominal; its radius is used only where the trial has no complete stroke. A Scotch yoke without it.
    source : str
        Channel name for the result.

    Returns
    -------
    CrankAngle or None
        None where the plunger does not travel. Where there are more than 256 samples a stroke the angle is
        given at block means, 128 or more a stroke.

    Notes
    -----
    The crank is taken to turn forward only. Bias: none seen above 0.1 mrad with white noise; errors of the
    displacement that repeat with the stroke (a bent sensor curve, play) show up as a speed ripple of their
    size over the radius. `docs/processing.md` holds the measured errors.

    Examples
    --------
    >>> t = np.arange(0, 1, 1e-3)
    >>> track = track_crank_angle(t, 0.01 * (1 - np.cos(2 * np.pi * 15 * t)))
    >>> bool(np.allclose(np.interp(0.5, track.time_s, track.angle_rad), 15 * np.pi, atol=1e-3))
    True
    """
    if len(time_s) < 16:
        return None
    unfolded = _unfold(np.asarray(time_s, float), np.asarray(displacement_m, float), mechanism)
    if unfolded is None:
        return None
    jerk_density, unfolded = _choose_settings(unfolded)
    for at_end in (False, True):
        unfolded = _choose_branch(unfolded, jerk_density, at_end=at_end)
    smoothed = _smooth_in_chunks(unfolded, jerk_density)
    angle = np.maximum.accumulate(smoothed[:, 0])
    return CrankAngle(
        time_s=unfolded.time_s,
        angle_rad=angle,
        speed_rad_s=smoothed[:, 1],
        angle_std_rad=np.hypot(np.sqrt(smoothed[:, 2]), _doubt_of_stroke(unfolded.travel)),
        radius_m=float(np.percentile(unfolded.travel.radius_m, 75.0)),
        source=source,
        is_absolute=True,
        rod_length_m=unfolded.mechanism.rod_length_m,
    )


def _doubt_of_stroke(travel: Travel) -> Floats:
    """Uncertainty of the angle where the stroke is not the usual one: no crank does that, rad."""
    radius = travel.radius_m
    usual = np.percentile(radius, 75.0)
    deviation = np.abs(radius / usual - 1.0)
    return np.where(deviation > _VARYING_STROKE, 4.0 * deviation, 0.0)


def _unfold(time: Floats, y: Floats, nominal: Mechanism | None) -> _Unfolded | None:
    noise = white_noise_std(y, time)
    turns = _turns_of(y, noise, width=1, drop_spikes=True)
    if turns is None or np.median(np.diff(turns.index)) <= 24:  # a median of five would eat such short strokes
        turns = _turns_of(y, noise, width=1, drop_spikes=False)
    if turns is None:
        return None
    half_turn_s = float(np.median(np.diff(time[turns.index])))
    step = float(np.median(np.diff(time)))
    if half_turn_s > 24 * step:
        time, y = _without_spikes(time, y, noise)
    block = int(2 * half_turn_s / step) // _KNOTS_A_STROKE
    if block >= 2:
        time, y = _block_means(time, y, block, step)
        noise, step = max(white_noise_std(y, time), noise / np.sqrt(block)), step * block
    width = max(int(half_turn_s / step / 24), 1)
    speed = np.pi / half_turn_s
    edges = _edges(time, max(LONGEST_STEP * step, 0.5 / speed))
    turns = _turns_of(y, noise, width, drop_spikes=half_turn_s > 24 * step, edges=edges)
    if turns is None:
        return None
    travel = estimate_travel(time, y, turns, None if nominal is None else float(nominal.radius_m))
    mechanism = Mechanism(radius_m=travel.radius_m, rod_length_m=None if nominal is None else nominal.rod_length_m)
    calm_width = max(int(half_turn_s / step / 8), 1)
    tolerance = max(8.0 * noise / np.sqrt(calm_width), 4e-3 * float(np.mean(travel.radius_m)))
    is_rest = find_rest(moving_mean(y, calm_width), int(half_turn_s / step), tolerance)
    angle = _angle_between_turns(y - travel.offset_m, turns, mechanism, edges, is_rest)
    return _Unfolded(
        time_s=time,
        displacement_m=y,
        angle_rad=_bridge_gaps(time, angle, speed, edges),
        is_rest=is_rest,
        is_averaged=np.zeros(len(y), dtype=bool),
        travel=travel,
        mechanism=mechanism,
        speed_scale_rad_s=speed,
        noise_std_m=noise,
    )


def _without_spikes(time: Floats, y: Floats, noise: float) -> tuple[Floats, Floats]:
    """Drop samples far from the median of the five around them: they would bend the first pass."""
    low, high = robust_range(y, 1.0)
    good = np.abs(y - median_of_five(y)) < max(8.0 * noise, 0.05 * (high - low))
    return time[good], y[good]


def _turns_of(
    y: Floats, noise: float, width: int, *, drop_spikes: bool, edges: Sequence[int] | None = None
) -> Turns | None:
    """Find the turning points, or None where the plunger does not travel or never turns twice.

    Travel is 20 noise standard deviations; less where the turns come as regularly as noise never does,
    because at few samples a stroke the noise is overestimated. `edges` are those of the stretches between gaps.
    """
    stretches = [y] if edges is None else [y[first:last] for first, last in pairwise(edges)]
    calm = np.concatenate([moving_mean(median_of_five(one) if drop_spikes else one, width) for one in stretches])
    low, high = robust_range(calm, 1.0)
    if high - low <= 0:
        return None
    turns = find_turns(calm, noise / np.sqrt(width), edges)
    if len(turns.index) < 2:
        return None
    strokes = (turns.index[2:] - turns.index[:-2])[1:-1]
    regular = len(strokes) > 4 and np.std(strokes) < 0.2 * np.mean(strokes) and np.mean(strokes) >= 4
    return turns if high - low > 20.0 * noise or regular else None


def _edges(time: Floats, longest_s: float) -> list[int]:
    """First sample of each stretch without a gap that is longer, and the number of samples."""
    return [0, *(np.flatnonzero(np.diff(time) > longest_s) + 1).tolist(), len(time)]


def _block_means(time: Floats, y: Floats, block: int, step: float) -> tuple[Floats, Floats]:
    """Means of `block` samples each, never across a gap."""
    stretches = pairwise(_edges(time, LONGEST_STEP * step))
    starts = np.concatenate([np.arange(first, last, block) for first, last in stretches])
    counts = np.diff(np.r_[starts, len(time)])
    return np.add.reduceat(time, starts) / counts, np.add.reduceat(y, starts) / counts


def _angle_between_turns(
    above_m: Floats, turns: Turns, mechanism: Mechanism, edges: Sequence[int], is_rest: np.ndarray
) -> Floats:
    """Angle by inverting the mechanism between neighbouring dead centres, unwrapped within each stretch."""
    within = mechanism.half_turn(above_m)
    angle = np.empty_like(above_m)
    of_stretches = [slice(*np.searchsorted(turns.index, pair)) for pair in pairwise(edges)]
    rising = _begin_rising(above_m, [turns.is_top[of_stretch] for of_stretch in of_stretches], edges, is_rest)
    for (first, last), of_stretch, begins_rising in zip(pairwise(edges), of_stretches, rising, strict=True):
        passed = np.searchsorted(turns.index[of_stretch], np.arange(first, last), side="right")
        half_turns = passed + (0 if begins_rising else 1)  # rising in even, falling in odd half turns
        part = within[first:last]
        angle[first:last] = np.where(half_turns % 2 == 0, part, 2 * np.pi - part) + 2 * np.pi * (half_turns // 2)
    return angle


def _begin_rising(above_m: Floats, tops: Sequence[np.ndarray], edges: Sequence[int], is_rest: np.ndarray) -> list[bool]:
    """Whether the plunger rises at the begin of each stretch; `tops`: which of its turning points are the upper ones.

    A stretch at rest does not tell: the plunger stands where the next one begins, or the one before has ended.
    """
    found: list[bool | None] = []
    for (first, last), is_top in zip(pairwise(edges), tops, strict=True):
        if len(is_top):
            found.append(bool(is_top[0]))
        else:
            found.append(None if is_rest[first:last].all() else bool(above_m[last - 1] >= above_m[first]))
    rising: list[bool] = []
    for k, known in enumerate(found):
        after = next((one for one in found[k:] if one is not None), None)
        before = rising[-1] ^ bool(len(tops[k - 1]) % 2) if rising else True
        rising.append(known if known is not None else before if after is None else after)
    return rising


def _bridge_gaps(time: Floats, angle: Floats, speed: float, edges: Sequence[int]) -> Floats:
    """Add the whole turns that went by before each stretch and unseen in its gap, from the typical speed."""
    angle = angle.copy()
    for first in edges[1:-1]:
        k = first - 1
        near = slice(max(k - 400, 0), k)
        local = np.median(np.diff(angle[near]) / np.diff(time[near])) if k > 20 else speed
        ahead = max(local, 0.0) * (time[first] - time[k]) - (angle[first] - angle[k])
        angle[first:] += 2 * np.pi * round(float(ahead) / (2 * np.pi))
    return angle


def _choose_settings(u: _Unfolded) -> tuple[float, _Unfolded]:
    """Jerk density by likelihood and noise by residuals, from up to 8192 samples after the first motion."""
    moving = np.flatnonzero(~u.is_rest)
    first = max(int(moving[0]) - 64, 0) if len(moving) else 0
    part = slice(first, first + 8192)
    sample = _part(u, part)
    density = [ripple**2 * u.speed_scale_rad_s**5 for ripple in _RIPPLES]
    noise = u.noise_std_m
    best = density[3]
    for _ in range(2):
        sample = replace(sample, noise_std_m=noise)
        scored = [(_run(sample, q, n_passes=3)[1], q) for q in density]
        best = max(scored)[1]
        out, _ = _run(sample, best, n_passes=4)
        residual = _residual(sample, out[:, 0])[~sample.is_rest]
        noise = max(u.noise_std_m, robust_std(residual)) if len(residual) > 32 else noise
    return best, replace(u, noise_std_m=noise)


def _part(u: _Unfolded, part: slice) -> _Unfolded:
    travel = replace(u.travel, offset_m=u.travel.offset_m[part], radius_m=u.travel.radius_m[part])
    return replace(
        u,
        time_s=u.time_s[part],
        displacement_m=u.displacement_m[part],
        angle_rad=u.angle_rad[part],
        is_rest=u.is_rest[part],
        is_averaged=u.is_averaged[part],
        travel=travel,
        mechanism=replace(u.mechanism, radius_m=travel.radius_m),
    )


def _residual(u: _Unfolded, angle: Floats) -> Floats:
    return u.displacement_m - u.travel.offset_m - u.mechanism.displacement(angle)


def _run(u: _Unfolded, jerk_density: float, n_passes: int) -> tuple[Floats, float]:
    """Iterate the smoother; the first pass leaves out what lies near the dead centres."""
    n = len(u.time_s)
    above_m, out = u.displacement_m - u.travel.offset_m, np.empty((n, 3))
    is_usable = u.is_averaged | (np.abs(np.sin(u.angle_rad)) > _FIRST_PASS_SLOPE)
    variance = np.where(is_usable, u.noise_std_m**2, np.inf)
    speed = u.speed_scale_rad_s
    start = np.array([u.angle_rad[0], 0.0 if u.is_rest[0] else speed, 0.0])
    start_std = np.array([0.5, 0.1 * speed if u.is_rest[0] else speed, speed**2])
    angle = u.angle_rad
    likelihood = 0.0
    for step in range(n_passes):
        slope, target = linearise(u.mechanism, angle, above_m, variance)
        likelihood = smooth(
            u.time_s, slope, target, variance, u.is_rest, start, start_std, jerk_density,
            _REST_SPEED_SHARE * speed, out,
        )  # fmt: skip
        angle = out[:, 0].copy()
        if step == 0:
            variance[:] = u.noise_std_m**2
        else:
            is_outlier = np.abs(above_m - u.mechanism.displacement(angle)) > _OUTLIER_STDS * u.noise_std_m
            variance = np.where(is_outlier, np.inf, u.noise_std_m**2)
    n_outliers = int(np.sum(np.isinf(variance)))
    return out, likelihood - 0.5 * n_outliers * (2 * np.log(u.noise_std_m) + _OUTLIER_STDS**2)


def _choose_branch(u: _Unfolded, jerk_density: float, *, at_end: bool) -> _Unfolded:
    """Decide by likelihood on which side of a dead centre the crank started (or stopped).

    Within noise of a dead centre the displacement cannot tell the two sides apart; the motion that follows
    can.
    """
    angle = u.angle_rad[::-1] if at_end else u.angle_rad
    dead_centre = np.pi * round(float(np.median(angle[:16])) / np.pi)
    if abs(float(np.median(angle[:16])) - dead_centre) > 0.6:
        return u
    leaves = np.flatnonzero(np.abs(angle - dead_centre) > 1.0)
    if not len(leaves) or leaves[0] == 0:
        return u
    head = slice(0, int(leaves[0]))
    step = float(np.median(np.diff(u.time_s)))
    width = int(0.25 / (u.speed_scale_rad_s * step)) | 1
    distance = np.arccos(np.clip(moving_mean(np.cos(angle[head] - dead_centre), width), -1.0, 1.0))
    turn = int(np.argmin(distance))
    ahead = -1.0 if at_end else 1.0
    sides = []
    for side in (-1.0, 1.0):
        trial = angle.copy()
        trial[head] = dead_centre + np.where(np.arange(len(distance)) < turn, side, ahead) * distance
        is_averaged = u.is_averaged[::-1].copy() if at_end else u.is_averaged.copy()
        is_averaged[head] = True
        if at_end:
            trial, is_averaged = trial[::-1], is_averaged[::-1]
        candidate = replace(u, angle_rad=trial, is_averaged=is_averaged)
        n_near = min(len(distance) + 512, len(angle))
        near = slice(len(angle) - n_near, None) if at_end else slice(0, n_near)
        sides.append((_run(_part(candidate, near), jerk_density, n_passes=5)[1], side, candidate))
    return max(sides, key=lambda entry: entry[:2])[2]


def _smooth_in_chunks(u: _Unfolded, jerk_density: float) -> Floats:
    """Smooth overlapping chunks, so that memory stays small however long the trial is."""
    n = len(u.time_s)
    step = float(np.median(np.diff(u.time_s)))
    overlap = int(_OVERLAP_STROKES * 2 * np.pi / u.speed_scale_rad_s / step)
    chunk = max(_CHUNK, 4 * overlap)
    out = np.empty((n, 3))
    for first in range(0, n, chunk):
        last = min(first + chunk, n)
        begin, end = max(first - overlap, 0), min(last + overlap, n)
        n_passes = 8 if begin == 0 or end == n else 4  # starting beside a dead centre converges slowly
        part, _ = _run(_part(u, slice(begin, end)), jerk_density, n_passes=n_passes)
        out[first:last] = part[first - begin : last - begin]
    return out
