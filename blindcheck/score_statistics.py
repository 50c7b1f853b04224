"""Intervals and calibration of a score."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Z95 = 1.959963984540054
N_BOOTSTRAP = 1000


@dataclass(frozen=True, kw_only=True, slots=True)
class Proportion:
    """A share of cases with its 95 % interval.

    Attributes
    ----------
    hits, n : int
    share, low, high : float or None
        None where `n` is 0.
    """

    hits: int
    n: int
    share: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Estimate:
    """A mean or median over cases with its 95 % bootstrap interval; None where there is no case."""

    n: int
    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrationBin:
    """Cases of about the same stated probability.

    Attributes
    ----------
    stated : float
        Mean stated probability.
    correct : Proportion
    """

    stated: float
    correct: Proportion


@dataclass(frozen=True, kw_only=True, slots=True)
class Calibration:
    """How far stated probabilities can be taken at their word.

    Attributes
    ----------
    bins : tuple of CalibrationBin
        Of equal numbers of cases, lowest probability first.
    error : Estimate
        Expected calibration error (ECE): mean distance of stated and observed share over the bins. Chance
        alone makes it positive.
    error_by_chance : float or None
        What perfectly calibrated probabilities of this size would give on average.
    stated : tuple of float
        By case: with `is_correct` what several sets are compared by together.
    is_correct : tuple of bool
    """

    bins: tuple[CalibrationBin, ...]
    error: Estimate
    error_by_chance: float | None
    stated: tuple[float, ...]
    is_correct: tuple[bool, ...]


def wilson(hits: int, n: int) -> Proportion:
    """Return a share and its 95 % Wilson score interval.

    (p + z^2/2n +- z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2/n); Wilson, J. Am. Stat. Assoc. 22, 209 (1927).

    Examples
    --------
    >>> found = wilson(81, 263)
    >>> round(found.low, 4), round(found.high, 4)
    (0.2553, 0.3662)
    """
    if n == 0:
        return Proportion(hits=0, n=0, share=None, low=None, high=None)
    p = hits / n
    centre = p + Z95**2 / (2 * n)
    half = Z95 * np.sqrt(p * (1 - p) / n + Z95**2 / (4 * n**2))
    scale = 1 + Z95**2 / n
    # The interval of no hit begins at 0, and of nothing but hits ends at 1, which rounding may miss.
    low = 0.0 if hits == 0 else float((centre - half) / scale)
    high = 1.0 if hits == n else float((centre + half) / scale)
    return Proportion(hits=hits, n=n, share=p, low=low, high=high)


def mean_of(values: Floats, *, seed: int = 0) -> Estimate:
    """Return the mean of one value per case with its 95 % percentile bootstrap interval.

    Parameters
    ----------
    values : ndarray, shape (n,)
    seed : int
        Of the bootstrap.
    """
    return _bootstrap(values, lambda drawn: drawn.mean(axis=-1), seed)


def median_of(values: Floats, *, seed: int = 0) -> Estimate:
    """Return the median of one value per case with its 95 % percentile bootstrap interval.

    Parameters
    ----------
    values : ndarray, shape (n,)
    seed : int
        Of the bootstrap.
    """
    return _bootstrap(values, lambda drawn: np.median(drawn, axis=-1), seed)


def ratio_of_medians(over: Floats, under: Floats, *, seed: int = 0) -> Estimate:
    """Return the median of one value per case over that of another, with its 95 % percentile bootstrap interval.

    Parameters
    ----------
    over, under : ndarray, shape (n,)
        Of the same cases; the median of `under` is above 0.
    seed : int
        Of the bootstrap.
    """
    both = np.stack([over, under])
    return _bootstrap(both, lambda drawn: np.median(drawn[0], axis=-1) / np.median(drawn[1], axis=-1), seed)


def _bootstrap(values: Floats, statistic: Callable[[Floats], Floats], seed: int) -> Estimate:
    """Draw cases, the last axis of `values`, with replacement."""
    n = values.shape[-1]
    if n == 0:
        return Estimate(n=0, value=None, low=None, high=None)
    drawn = np.random.default_rng(seed).integers(0, n, size=(N_BOOTSTRAP, n))
    low, high = np.quantile(statistic(values[..., drawn]), [0.025, 0.975])
    return Estimate(n=n, value=float(statistic(values)), low=float(low), high=float(high))


def calibration_of(stated: Floats, is_correct: npt.NDArray[np.bool_], *, seed: int = 0) -> Calibration:
    """Compare stated probabilities with how often they were right.

    Parameters
    ----------
    stated : ndarray, shape (n,)
        Probability of the most probable hypothesis.
    is_correct : ndarray, shape (n,)
        Whether that was the truth.
    seed : int
        Of the bootstrap.

    Returns
    -------
    Calibration
        With ten bins from 100 cases on, fewer below, at least ten cases a bin.
    """
    n = len(stated)
    if n == 0:
        none = Estimate(n=0, value=None, low=None, high=None)
        return Calibration(bins=(), error=none, error_by_chance=None, stated=(), is_correct=())
    n_bins = int(np.clip(n // 10, 1, 10))
    rng = np.random.default_rng(seed)
    right = is_correct.astype(np.float64)
    again, by_chance = np.empty(N_BOOTSTRAP), np.empty(N_BOOTSTRAP)
    for k in range(N_BOOTSTRAP):
        chosen = rng.integers(0, n, n)
        again[k] = calibration_error(stated[chosen], right[chosen], n_bins)
        by_chance[k] = calibration_error(stated, (rng.random(n) < stated).astype(np.float64), n_bins)
    low, high = np.quantile(again, [0.025, 0.975])
    return Calibration(
        bins=tuple(
            CalibrationBin(stated=float(stated[part].mean()), correct=wilson(int(right[part].sum()), len(part)))
            for part in _parts(stated, n_bins)
        ),
        error=Estimate(n=n, value=calibration_error(stated, right, n_bins), low=float(low), high=float(high)),
        error_by_chance=float(by_chance.mean()),
        stated=tuple(stated.tolist()),
        is_correct=tuple(is_correct.tolist()),
    )


def calibration_error(stated: Floats, right: Floats, n_bins: int) -> float:
    """Return the expected calibration error over bins of equal numbers of cases.

    Examples
    --------
    >>> calibration_error(np.array([0.5, 0.5, 0.9, 0.9]), np.array([1.0, 0.0, 1.0, 1.0]), 2)
    0.05
    """
    total = sum(abs(float(np.sum(stated[part] - right[part]))) for part in _parts(stated, n_bins))
    return round(total / len(stated), 12)


def _parts(stated: Floats, n_bins: int) -> list[npt.NDArray[np.intp]]:
    return list(np.array_split(np.argsort(stated, kind="stable"), n_bins))
