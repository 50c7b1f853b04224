"""From repetitions to statements: group means with their uncertainty, and differences between groups."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

_NORMAL_95: Final = 1.959963984540054


@dataclass(frozen=True, kw_only=True, slots=True)
class Estimate:
    """One trial's value of a quantity.

    Attributes
    ----------
    value : float
    statistical_std : float
        Part of its standard uncertainty that differs from trial to trial, 0 where not known.
    common_std : float
        Part that all trials share (plant constants, sensor gains), 0 where not known.
    """

    value: float
    statistical_std: float = 0.0
    common_std: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupMean:
    """Mean over the repetitions of one material.

    Attributes
    ----------
    n : int
        Repetitions.
    values : tuple of float
    mean : float
    between_std : float or None
        Standard deviation from repetition to repetition; None for a single one.
    std : float
        Combined standard uncertainty of the mean.
    common_std : float
        Its part that all trials share.
    low, high : float or None
        95 % interval of the mean; None where nothing is known of its uncertainty.
    rests_on_repetitions : bool
        False for a single trial: the interval then holds only what is known within that trial.
    """

    n: int
    values: tuple[float, ...]
    mean: float
    between_std: float | None
    std: float
    common_std: float
    low: float | None
    high: float | None
    rests_on_repetitions: bool

    @property
    def common_rel_std(self) -> float:
        """The part that all trials share, over the mean; 0 where that is 0."""
        return self.common_std / abs(self.mean) if self.mean else 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Difference:
    """Comparison of two materials in one quantity.

    Attributes
    ----------
    first, second : str
    difference : float
        Mean of the first less mean of the second.
    low, high : float or None
        Its 95 % interval, not adjusted for the number of pairs; None where it cannot be said.
    p_value, p_holm : float or None
        Two-sided p of Welch's t test, and after Holm's correction over all pairs that could be tested.
    is_significant : bool or None
        At 5 % after the correction; None where it cannot be said.
    reason : str
        Why it cannot be said; empty otherwise.
    """

    first: str
    second: str
    difference: float
    low: float | None
    high: float | None
    p_value: float | None
    p_holm: float | None
    is_significant: bool | None
    reason: str = ""


def group_mean(estimates: Sequence[Estimate]) -> GroupMean:
    r"""Combine the repetitions of one material.

    With n repetitions x_i, their standard deviation s, statistical uncertainties a_i and common ones b_i::

        mean = sum(x_i) / n
        u^2  = max(s^2, mean(a_i^2)) / n + mean(b_i)^2

    The scatter between repetitions already holds the statistical part, so that counts only where the scatter
    came out smaller by chance; the common part does not shrink with n. The 95 % interval is mean +- h with::

        h^2 = t^2 max(s^2, mean(a_i^2)) / n + 1.96^2 mean(b_i)^2

    and Student's t of n - 1 degrees of freedom; it covers 95 % or a little more. (Welch and Satterthwaite's
    effective degrees of freedom would cover 91 % for n = 2 with a common part of half the scatter.) For n = 1
    t is 1.96.

    Parameters
    ----------
    estimates : sequence of Estimate
        At least one, finite.

    Examples
    --------
    >>> found = group_mean([Estimate(value=v) for v in (9.0, 10.0, 11.0)])
    >>> f"{found.mean:.2f} +- {found.std:.3f}, 95 %: {found.low:.2f} to {found.high:.2f}"
    '10.00 +- 0.577, 95 %: 7.52 to 12.48'
    """
    from scipy.special import stdtrit

    n = len(estimates)
    values = np.array([estimate.value for estimate in estimates])
    within = float(np.mean([estimate.statistical_std**2 for estimate in estimates]))
    common = float(np.mean([estimate.common_std for estimate in estimates])) ** 2
    between_std = float(values.std(ddof=1)) if n > 1 else None
    scatter = max(between_std**2 if between_std is not None else 0.0, within) / n
    std = math.sqrt(scatter + common)
    student = float(stdtrit(n - 1, 0.975)) if n > 1 else _NORMAL_95
    half = math.hypot(student * math.sqrt(scatter), _NORMAL_95 * math.sqrt(common))
    mean = float(values.mean())
    return GroupMean(
        n=n,
        values=tuple(values.tolist()),
        mean=mean,
        between_std=between_std,
        std=std,
        common_std=math.sqrt(common),
        low=mean - half if std > 0.0 else None,
        high=mean + half if std > 0.0 else None,
        rests_on_repetitions=n > 1,
    )


def compare_groups(
    groups: Mapping[str, Sequence[float]], *, common_rel_std: float = 0.0, level: float = 0.05
) -> tuple[Difference, ...]:  # fmt: skip
    r"""Compare every pair of materials by Welch's t test with Holm's correction.

    What all trials share (plant constants, gains) is a factor on both means: whether there is a difference does not
    depend on it, how large it is does. With Welch's standard uncertainty u of a difference d and its t, the 95 %
    interval is d +- h with::

        h^2 = t^2 u^2 + 1.96^2 (common_rel_std d)^2

    The test takes repetitions as independent and roughly normal; three a material detect only differences of several
    standard deviations, and "not significant" never means "equal". With two repetitions that scatter five times as
    much as five of the other material, one in ten such pairs without a difference is called significant, not one in
    twenty.

    Parameters
    ----------
    groups : mapping of str to sequence of float
        Values of the repetitions by material.
    common_rel_std : float
        Relative standard uncertainty of the factor that all trials share.
    level : float
        Probability of at least one false difference among all pairs.

    Returns
    -------
    tuple of Difference
        Every pair, in the order of `groups`.

    Examples
    --------
    >>> oak, pine = [240.0, 242.0, 238.0], [120.0, 121.0, 119.5]
    >>> [d.is_significant for d in compare_groups({"oak": oak, "pine": pine})]
    [True]
    """
    found = [_welch(first, second, groups, common_rel_std) for first, second in itertools.combinations(groups, 2)]
    tested = sorted((d for d in found if d.p_value is not None), key=lambda d: d.p_value or 0.0)
    adjusted: dict[tuple[str, str], float] = {}
    largest = 0.0
    for rank, difference in enumerate(tested):
        largest = max(largest, min(1.0, (len(tested) - rank) * (difference.p_value or 0.0)))
        adjusted[difference.first, difference.second] = largest
    return tuple(_with_holm(d, adjusted.get((d.first, d.second)), level) for d in found)


def _with_holm(difference: Difference, p_holm: float | None, level: float) -> Difference:
    if p_holm is None:
        return difference
    return replace(difference, p_holm=p_holm, is_significant=p_holm < level)


def _welch(first: str, second: str, groups: Mapping[str, Sequence[float]], common_rel_std: float) -> Difference:
    from scipy.special import stdtr, stdtrit

    a, b = np.asarray(groups[first], dtype=np.float64), np.asarray(groups[second], dtype=np.float64)
    difference = float(a.mean() - b.mean())
    reason = ""
    short = [f"{name} has {len(values)}" for name, values in ((first, a), (second, b)) if len(values) < 2]
    if short:
        reason = f"two repetitions of each are needed; {' and '.join(short)}"
    elif a.var() == 0.0 and b.var() == 0.0:
        reason = "neither has any scatter between its repetitions"
    if reason:
        return Difference(
            first=first,
            second=second,
            difference=difference,
            low=None,
            high=None,
            p_value=None,
            p_holm=None,
            is_significant=None,
            reason=reason,
        )
    parts = [float(values.var(ddof=1)) / len(values) for values in (a, b)]
    std = math.sqrt(sum(parts))
    freedom = sum(parts) ** 2 / sum(part**2 / (len(values) - 1) for part, values in zip(parts, (a, b), strict=True))
    half = math.hypot(float(stdtrit(freedom, 0.975)) * std, _NORMAL_95 * common_rel_std * difference)
    return Difference(
        first=first,
        second=second,
        difference=difference,
        low=difference - half,
        high=difference + half,
        p_value=2.0 * float(stdtr(freedom, -abs(difference) / std)),
        p_holm=None,
        is_significant=None,
    )
