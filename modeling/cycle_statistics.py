"""Statistics of quantities that come once a stroke: scatter, autocorrelation, features of a cycle."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sawbench.bench.errors import InputError

Floats = NDArray[np.float64]
FEWEST_STROKES = 4


def fourier_basis(angle_rad: Floats, n_harmonics: int) -> Floats:
    """Orthonormal rows 1, cos(h a), sin(h a) over equally spaced bins.

    Parameters
    ----------
    angle_rad : ndarray, shape (n_bins,), rad
    n_harmonics : int
        Highest harmonic h, below n_bins / 2.

    Returns
    -------
    ndarray, shape (1 + 2 * n_harmonics, n_bins)
        `basis @ basis.T` is the identity.
    """
    rows = [np.full(len(angle_rad), 1.0 / np.sqrt(len(angle_rad)))]
    for harmonic in range(1, n_harmonics + 1):
        scale = np.sqrt(2.0 / len(angle_rad))
        rows += [scale * np.cos(harmonic * angle_rad), scale * np.sin(harmonic * angle_rad)]
    return np.array(rows)


def autocorrelation_time(series: ArrayLike) -> float:
    """Strokes that count as one independent stroke: 1 + 2 * sum of the autocorrelations, at least 1.

    The sum is cut where the sum of two neighbouring autocorrelations stops being positive (Geyer's initial
    monotone sequence), so no model of the correlation is assumed. The bias from subtracting the sample mean
    is corrected to first order. Biased low for fewer than about 20 correlation times.

    Parameters
    ----------
    series : array_like, shape (n_strokes,)

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
    variance = float(centred @ centred) / n
    if n < FEWEST_STROKES or variance == 0.0:
        return 1.0
    n_lags = max(2, n // 3)
    correlation = np.array([centred[: n - lag] @ centred[lag:] for lag in range(n_lags)]) / (n * variance)
    pairs = correlation[: 2 * (n_lags // 2)].reshape(-1, 2).sum(axis=1)
    stop = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
    total = float(np.minimum.accumulate(pairs[: max(stop, 1)]).sum())
    time = max(1.0, 2.0 * total - 1.0)
    return time / (1.0 - min(time / n, 0.5))


def std_of_mean(series: ArrayLike) -> tuple[float, float]:
    """Return the standard uncertainty of the mean of an autocorrelated series, and its effective length.

    The standard deviation is widened by the ratio of Student's to Gauss's 97.5 % point at the effective
    number of strokes, so that +-1.96 of it covers 95 % for short series too.

    Parameters
    ----------
    series : array_like, shape (n_strokes,)
        At least four values.

    Returns
    -------
    std, n_effective : float

    Raises
    ------
    InputError
        For fewer than four strokes: the scatter cannot be told.

    Examples
    --------
    >>> std, n_effective = std_of_mean([1.0, -1.0] * 50)
    >>> round(std, 3), n_effective > 97
    (0.102, True)
    """
    from scipy.special import stdtrit

    values = np.asarray(series, dtype=np.float64)
    if len(values) < FEWEST_STROKES:
        raise InputError(
            f"{len(values)} strokes are not enough to estimate the scatter, {FEWEST_STROKES} are needed",
            remedy="record longer",
        )
    time = autocorrelation_time(values)
    n_effective = max(len(values) / time, 2.0)
    student = float(stdtrit(n_effective - 1.0, 0.975)) / 1.959964
    return float(values.std(ddof=1) / np.sqrt(n_effective)) * student, n_effective
