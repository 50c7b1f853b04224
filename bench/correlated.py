"""Standard uncertainty of the mean of values whose neighbours may be correlated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from sawbench.bench.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# Fewer values do not show whether neighbours are correlated.
_FEWEST: Final = 4


def autocorrelation_time(series: ArrayLike, *, may_alternate: bool = False) -> float:
    """Values that count as one independent value: 1 + 2 * sum of the autocorrelations.

    The sum is cut where the sum of two neighbouring autocorrelations stops being positive (Geyer's initial
    monotone sequence: Geyer 1992, "Practical Markov chain Monte Carlo", Statistical Science 7, 473, section 3.3), so
    no model of the correlation is assumed. The bias from subtracting the sample mean is corrected to first order.
    Biased low for fewer than about 20 correlation times.

    Parameters
    ----------
    series : array_like, shape (n,)
        Fewer than four are taken as independent.
    may_alternate : bool
        Whether it may be below 1, as for differences of successive errors, where neighbours differ beyond chance.

    Returns
    -------
    float
        1 for white noise, (1 + a)/(1 - a) for a first-order process with coefficient a.

    Examples
    --------
    >>> import numpy as np
    >>> noise = np.random.default_rng(1).normal(size=4000)
    >>> autocorrelation_time(noise) < 1.15
    True
    >>> 3.5 < autocorrelation_time(np.convolve(noise, np.ones(4))) < 4.6
    True
    """
    values = np.asarray(series, dtype=np.float64)
    n = len(values)
    centred = values - values.mean()
    if n < _FEWEST or not centred.any():
        return 1.0
    covariance = np.fft.irfft(np.abs(np.fft.rfft(centred, 2 * n)) ** 2, 2 * n)
    n_pairs = max(2, n // 3) // 2
    pairs = covariance[: 2 * n_pairs].reshape(-1, 2).sum(axis=1) / covariance[0]
    stop = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else n_pairs
    alternates = may_alternate and covariance[1] < -2.0 / np.sqrt(n) * covariance[0]
    time = max(1.0 / n if alternates else 1.0, 2.0 * float(np.minimum.accumulate(pairs[:stop]).sum()) - 1.0)
    return time / (1.0 - min(time / n, 0.5))


def student_factor(degrees: float) -> float:
    """Factor on a standard deviation that comes from few residuals, with which +-1.96 of it covers 95 %.

    Parameters
    ----------
    degrees : float
        Degrees of freedom it comes from, above 0.

    Returns
    -------
    float
        Ratio of Student's to Gauss's 97.5 % point.

    Examples
    --------
    >>> round(student_factor(1), 2), round(student_factor(1000), 2)
    (6.48, 1.0)
    """
    from scipy.special import ndtri, stdtrit

    return float(stdtrit(degrees, 0.975) / ndtri(0.975))


def std_of_mean(series: ArrayLike, *, may_alternate: bool = False) -> tuple[float, float]:
    """Return the standard uncertainty of the mean of an autocorrelated series, and its effective length.

    The standard deviation is widened by `student_factor` at the effective number of values. A trend leaves hardly any
    independent values, yet the mean is within them: at most the standard deviation of a value anywhere in their range
    (a rectangular distribution), or of the mean of independent values where that is larger.

    Parameters
    ----------
    series : array_like, shape (n,)
        At least two values.
    may_alternate : bool
        As in `autocorrelation_time`.

    Returns
    -------
    std, n_effective : float

    Raises
    ------
    InputError
        For a single value: the scatter cannot be told.

    Examples
    --------
    >>> std, n_effective = std_of_mean([1.0, -1.0] * 50)
    >>> round(std, 3), n_effective > 97
    (0.102, True)
    """
    values = np.asarray(series, dtype=np.float64)
    if len(values) < 2:
        raise InputError(
            f"{len(values)} strokes are not enough to estimate the scatter, 2 are needed", remedy="record longer"
        )
    n_effective = max(len(values) / autocorrelation_time(values, may_alternate=may_alternate), 2.0)

    def widened(n: float) -> float:
        return float(values.std(ddof=1) / np.sqrt(n)) * student_factor(n - 1.0)

    within_range = float(np.ptp(values)) / np.sqrt(12.0)
    return min(widened(n_effective), max(widened(len(values)), within_range)), n_effective


def covariance_of_means(series: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the covariance of the means of several autocorrelated series that were measured together.

    The standard uncertainty of each mean is that of `std_of_mean`; their correlation is that of the values. A sum of
    them need not be autocorrelated as they are, so its uncertainty comes from its own series.

    Parameters
    ----------
    series : ndarray, shape (n, p)

    Returns
    -------
    ndarray, shape (p, p)
    """
    std = np.array([std_of_mean(column)[0] for column in series.T])
    raw = series.std(axis=0, ddof=1)
    scale = np.divide(std, raw, out=np.zeros_like(std), where=raw > 0)
    return np.atleast_2d(np.cov(series, rowvar=False)) * np.outer(scale, scale)
