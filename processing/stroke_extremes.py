"""Dead centres in a displacement signal: where it turns, how far it goes, where it stands still."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray
from sawbench.bench.recording import Floats
from sawbench.bench.runs import run_ends
from sawbench.processing.noise import robust_range
from sawbench.processing.sliding import sliding_maximum

_FIT_HALF_WIDTH = 0.11  # of a period: 0.7 rad each side of the dead centre
# At few samples a stroke as wide as eight samples ask for, but no wider than 1.2 rad: a cosine is no polynomial there.
_LEAST_FITTED, _WIDEST_HALF = 8, 0.19
_FITTED_TURNS = 400
_BLOCK = 64
_VARYING_SHARE = 0.02
_OUTLIER_MADS = 6.0
LONGEST_STEP = 2.5  # of the usual one: what is longer is a gap


@dataclass(frozen=True, kw_only=True, slots=True)
class Turns:
    """Turning points of a displacement.

    Attributes
    ----------
    index : ndarray of int, shape (m,)
        Sample of each turn, increasing.
    is_top : ndarray of bool, shape (m,)
        Largest displacement (crank angle pi) or smallest (0); they alternate where no gap lies between.
    """

    index: NDArray[np.int64]
    is_top: NDArray[np.bool_]


@njit(cache=True, nogil=True)
def _zigzag(y, threshold, index, is_top):
    """Alternating extremes that differ by `threshold`; returns their number."""
    count = 0
    low, high = 0, 0
    direction = 0
    for k in range(1, len(y)):
        if y[k] > y[high]:
            high = k
        if y[k] < y[low]:
            low = k
        if direction >= 0 and y[high] - y[k] > threshold:
            index[count], is_top[count] = high, True
            count += 1
            direction, low = -1, k
        elif direction <= 0 and y[k] - y[low] > threshold:
            index[count], is_top[count] = low, False
            count += 1
            direction, high = 1, k
        if direction == 1:
            low = k
        elif direction == -1:
            high = k
    return count


def moving_mean(values: Floats, width: int) -> Floats:
    """Centred moving mean of `width` samples (made odd); shorter at the ends.

    Parameters
    ----------
    values : ndarray, shape (n,)
    width : int

    Returns
    -------
    ndarray, shape (n,)

    Examples
    --------
    >>> moving_mean(np.array([0.0, 3.0, 0.0]), 3).tolist()
    [1.5, 1.0, 1.5]
    """
    half = min(max(int(width) // 2, 0), len(values) // 2)
    if half == 0:
        return values
    total = np.concatenate(([0.0], np.cumsum(values - values[0])))
    first = np.maximum(np.arange(len(values)) - half, 0)
    last = np.minimum(np.arange(len(values)) + half + 1, len(values))
    return (total[last] - total[first]) / (last - first) + values[0]


def find_turns(displacement_m: Floats, noise_std_m: float, edges: Sequence[int] | None = None) -> Turns:
    """Find the dead centres the plunger passed.

    A turn must differ by 30 % of the travel, except the first and the last one of a stretch, where the crank may have
    been beside a dead centre: there 6 noise standard deviations suffice.

    Parameters
    ----------
    displacement_m : ndarray, shape (n,), m
        Smoothed well below the stroke rate.
    noise_std_m : float
        Of the smoothed signal, m.
    edges : sequence of int, optional
        First sample of each stretch without a gap, and n: what a gap hides is no turn. Default: one stretch.

    Returns
    -------
    Turns
        Empty where the plunger does not travel.
    """
    low, high = robust_range(displacement_m, 1.0)
    travel = high - low
    stretches = list(pairwise([0, len(displacement_m)] if edges is None else edges))
    rough = [_rough_turns(displacement_m[first:last], travel) for first, last in stretches]
    found = _joined(rough, stretches)
    if len(np.unique(found.is_top)) < 2:
        return found
    level = {is_top: float(np.median(displacement_m[found.index[found.is_top == is_top]])) for is_top in (True, False)}
    fine = max(6.0 * noise_std_m, 1e-4 * travel)
    fitted = [
        _with_ends(displacement_m[first:last], turns, level, travel, fine)
        for turns, (first, last) in zip(rough, stretches, strict=True)
    ]
    return _joined(fitted, stretches)


def _rough_turns(y: Floats, travel: float) -> Turns:
    index, is_top = np.empty(len(y) + 1, np.int64), np.empty(len(y) + 1, np.bool_)
    count = _zigzag(y, 0.3 * travel, index, is_top) if travel > 0 else 0
    return Turns(index=index[:count], is_top=is_top[:count])


def _joined(found: Sequence[Turns], stretches: Sequence[tuple[int, int]]) -> Turns:
    index = [turns.index + first for turns, (first, _) in zip(found, stretches, strict=True)]
    return Turns(index=np.concatenate(index), is_top=np.concatenate([turns.is_top for turns in found]))


def _with_ends(y: Floats, turns: Turns, level: Mapping[bool, float], travel: float, fine: float) -> Turns:
    """Turns of one stretch without a first one that was not passed, and with a last one that was."""
    index, is_top = turns.index, turns.is_top
    if len(index) and not _passes(y[: index[0] + 1], level[bool(is_top[0])], bool(is_top[0]), travel, fine):
        index, is_top = index[1:], is_top[1:]
    if not len(index):
        return Turns(index=index, is_top=is_top)
    tail_top = not bool(is_top[-1])
    tail = y[index[-1] :]
    turn = int(np.argmax(tail) if tail_top else np.argmin(tail))
    if turn > 0 and _passes(tail[turn:][::-1], level[tail_top], tail_top, travel, fine):
        index, is_top = np.append(index, index[-1] + turn), np.append(is_top, tail_top)
    return Turns(index=index, is_top=is_top)


def _passes(stretch: Floats, level: float, is_top: bool, travel: float, fine: float) -> bool:
    """Whether the end of `stretch` is a dead centre that the crank passed, coming from its beginning."""
    sign = 1.0 if is_top else -1.0
    extreme = sign * stretch[-1]
    begin = sign * float(np.median(stretch[: max(len(stretch) // 4, 1)]))
    return abs(extreme - sign * level) < 0.1 * travel and extreme - begin > fine


@dataclass(frozen=True, kw_only=True, slots=True)
class Travel:
    """How far the plunger goes.

    Attributes
    ----------
    offset_m, radius_m : ndarray, shape (n,), m
        Displacement at crank angle 0 and half the travel, for every sample (they may drift slowly).
    radius_std_m : float
        Standard uncertainty of the mean radius, m.
    n_turns : int
        Dead centres it rests on.
    """

    offset_m: Floats
    radius_m: Floats
    radius_std_m: float
    n_turns: int


def estimate_travel(time_s: Floats, displacement_m: Floats, turns: Turns, nominal_radius_m: float | None) -> Travel:
    """Offset and radius from polynomials of 4th order through the dead centres.

    Parameters
    ----------
    time_s, displacement_m : ndarray, shape (n,)
    turns : Turns
    nominal_radius_m : float or None
        Used where fewer than two complete dead centres of either kind were passed.

    Notes
    -----
    Where the stroke itself changes by over 2 % of the radius (not a crank: a hydraulic actuator, say) the
    strokes of the usual length set the values, elsewhere the turning points are followed one by one. Unbiased
    by noise, unlike the largest and smallest sample. Where the speed changes by more than about 20 % within
    the fit's 1.4 rad the value moves by less than 1e-4 of the travel.
    """
    n = len(displacement_m)
    is_seen = _is_seen(time_s, turns)
    where, value, is_top = _fit_turns(time_s, displacement_m, turns, is_seen)
    tops, bottoms = value[is_top], value[~is_top]
    if len(tops) and len(bottoms):
        radius = 0.5 * (np.median(tops) - np.median(bottoms))
        spread = [np.std(part, ddof=1) / np.sqrt(len(part)) if len(part) > 1 else np.nan for part in (tops, bottoms)]
        std = 0.5 * float(np.hypot(spread[0], spread[1]))
        offset = float(np.median(bottoms))
        if max(float(np.ptp(tops)), float(np.ptp(bottoms))) > _VARYING_SHARE * radius:
            seen = Turns(index=turns.index[is_seen], is_top=turns.is_top[is_seen])
            return _follow_turns(displacement_m, seen, radius_std_m=std)
        if min(len(tops), len(bottoms)) < 2 * _BLOCK:
            return Travel(
                offset_m=np.full(n, offset), radius_m=np.full(n, radius), radius_std_m=std, n_turns=len(value)
            )
        low = _drift(where[~is_top], bottoms, n)
        high = _drift(where[is_top], tops, n)
        return Travel(offset_m=low, radius_m=0.5 * (high - low), radius_std_m=std, n_turns=len(value))
    low, high = robust_range(displacement_m)
    if nominal_radius_m is None:
        radius, offset = 0.5 * float(high - low), float(low)
    else:
        radius = nominal_radius_m
        is_top_known = bool(len(turns.index)) and bool(turns.is_top[0])
        offset = float(high) - 2 * radius if is_top_known else float(low)
    return Travel(offset_m=np.full(n, offset), radius_m=np.full(n, radius), radius_std_m=0.05 * radius, n_turns=0)


def _is_seen(time_s: Floats, turns: Turns) -> NDArray[np.bool_]:
    """Whether a dead centre was sampled: beside a gap the outermost sample may not be that of the dead centre."""
    if len(turns.index) < 2:
        return np.ones(len(turns.index), dtype=bool)
    step_s = np.diff(time_s)
    gaps = np.flatnonzero(step_s > LONGEST_STEP * np.median(step_s))
    at_s = time_s[turns.index]
    near_s = _FIT_HALF_WIDTH * float(np.median(np.diff(at_s)))
    began = np.searchsorted(time_s[gaps], at_s + near_s)  # gaps that begin before the dead centre is over
    ended = np.searchsorted(time_s[gaps + 1], at_s - near_s)
    return began == ended


def _fit_turns(
    time_s: Floats, y: Floats, turns: Turns, is_seen: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], Floats, NDArray[np.bool_]]:
    """Value at complete dead centres that were sampled, at most `_FITTED_TURNS` of them spread over the trial."""
    index, is_top = turns.index, turns.is_top
    if len(index) < 2:
        return index[:0], np.empty(0), is_top[:0]
    half_turns = np.diff(time_s[index])
    typical = float(np.median(half_turns))
    steady = np.abs(half_turns / typical - 1.0) < 0.5
    enough = 0.5 * (_LEAST_FITTED + 1) * float(np.median(np.diff(time_s)))
    width = float(np.clip(enough, 2.0 * _FIT_HALF_WIDTH * typical, 2.0 * _WIDEST_HALF * typical))
    first, last = (
        np.searchsorted(time_s, time_s[index] - width),
        np.searchsorted(time_s, time_s[index] + width),
    )
    left, right = np.r_[True, steady], np.r_[steady, True]
    inside = (time_s[index] - width >= time_s[0]) & (time_s[index] + width <= time_s[-1])
    usable = np.flatnonzero(is_seen & left & right & inside & (last - first >= _LEAST_FITTED))
    if len(usable) > _FITTED_TURNS:
        # Neighbours in pairs, one top and one bottom: every k-th turn could be all of one kind.
        pairs = np.linspace(0, len(usable) // 2 - 1, _FITTED_TURNS // 2).astype(np.int64)
        usable = usable[np.stack([2 * pairs, 2 * pairs + 1], axis=1).ravel()]
    index, is_top = index[usable], is_top[usable]
    if not len(usable):
        return index, np.empty(0), is_top
    at = first[usable, None] + np.arange((last - first)[usable].max())
    is_within = at < last[usable, None]
    at = np.minimum(at, len(y) - 1)
    u = (time_s[at] - time_s[index, None]) / width
    curves = _robust_quartics(u, y[at], is_within)
    dense = curves @ np.vander(np.linspace(-0.5, 0.5, 201), 5, increasing=True).T
    return index, np.where(is_top, dense.max(axis=1), dense.min(axis=1)), is_top


def _robust_quartics(u: Floats, values: Floats, is_within: NDArray[np.bool_]) -> Floats:
    """Coefficients of a polynomial of 4th order a row, once more without outliers; all of shape (n_rows, ...)."""
    powers = u[:, :, None] ** np.arange(5)

    def fit(rows: NDArray[np.int64], is_used: NDArray[np.bool_]) -> Floats:
        weighted = np.swapaxes(powers[rows] * is_used[:, :, None], 1, 2)
        solved = np.linalg.solve(weighted @ powers[rows], weighted @ values[rows, :, None])
        return np.asarray(solved[:, :, 0], dtype=np.float64)

    curves = fit(np.arange(len(u)), is_within)
    off = np.where(is_within, np.abs(values - (powers @ curves[:, :, None])[:, :, 0]), np.inf)
    n, row = is_within.sum(axis=1), np.arange(len(u))
    ordered = np.sort(off, axis=1)
    median = 0.5 * (ordered[row, (n - 1) // 2] + ordered[row, n // 2])
    is_good = off <= _OUTLIER_MADS * median[:, None]
    again = np.flatnonzero((is_good.sum(axis=1) < n) & (is_good.sum(axis=1) >= _LEAST_FITTED))
    if len(again):
        curves[again] = fit(again, is_good[again])
    return curves


def _follow_turns(y: Floats, turns: Turns, *, radius_std_m: float) -> Travel:
    """Offset and radius for a drive whose stroke changes while it runs.

    Constant over the longest run of strokes of the usual length, from dead centre to dead centre elsewhere.
    """
    n, value = len(y), y[turns.index]
    level = np.where(turns.is_top, np.percentile(value[turns.is_top], 75.0), np.percentile(value[~turns.is_top], 25.0))
    off = np.abs(value - level)
    is_usual = off <= max(_VARYING_SHARE * 0.5 * (np.ptp(level) or 1.0), off.min())  # where all differ, the nearest
    first, end = run_ends(is_usual)
    longest = int(np.argmax(end - first))
    usual = slice(first[longest], end[longest])
    plateau = turns.index[usual][[0, -1]]
    ends = []
    for is_top in (True, False):
        of_kind = turns.is_top == is_top
        constant = float(np.median(value[usual][of_kind[usual]])) if of_kind[usual].any() else np.nan
        constant = float(np.median(value[of_kind])) if np.isnan(constant) else constant
        outside = of_kind & ((turns.index < plateau[0]) | (turns.index > plateau[1]))
        at = np.r_[turns.index[outside], plateau]
        level_at = np.r_[value[outside], constant, constant]
        order = np.argsort(at, kind="stable")
        ends.append(np.interp(np.arange(n), at[order], level_at[order]))
    high, low = ends
    radius = np.maximum(0.5 * (high - low), 1e-9)
    return Travel(offset_m=low, radius_m=radius, radius_std_m=radius_std_m, n_turns=len(turns.index))


def _drift(where: NDArray[np.int64], value: Floats, n: int) -> Floats:
    """Block medians joined by straight lines: a level that drifts slowly."""
    blocks = np.array_split(np.arange(len(where)), len(where) // _BLOCK)
    at = [float(np.mean(where[block])) for block in blocks]
    return np.interp(np.arange(n), at, [float(np.median(value[block])) for block in blocks])


def find_rest(displacement_m: Floats, width: int, tolerance_m: float) -> NDArray[np.bool_]:
    """Mark samples around which the plunger stands still.

    Parameters
    ----------
    displacement_m : ndarray, shape (n,), m
    width : int
        Samples (centred) over which nothing may move; about half a stroke.
    tolerance_m : float
        Largest range that still counts as standing still, m.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    size = max(int(width), 3)
    range_m = sliding_maximum(displacement_m, size) + sliding_maximum(-displacement_m, size)
    return range_m < tolerance_m
