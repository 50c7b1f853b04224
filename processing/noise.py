"""White noise and range of a signal, neither of them moved by a few spikes."""

from __future__ import annotations

from math import comb

import numpy as np
from sawbench.bench.recording import Floats

# A signal leaks into low differences where it is sampled coarsely, white noise is the same in all of them, and that of
# steps nearly so.
_ORDERS = (3, 5)
_SURELY_LESS = 0.7
_MEDIAN_OF_NORMAL = 0.674490
# Steps that differ by more than this share of the usual one, for half of the samples, make the weights differ.
_JITTER_SHARE = 0.01
_JITTERED_WINDOWS = 8192


def white_noise_std(values: Floats, time_s: Floats | None = None) -> float:
    """Estimate the standard deviation of the white noise from differences of third and of fifth order.

    Parameters
    ----------
    values : ndarray, shape (n,)
    time_s : ndarray, shape (n,), optional
        Of the samples; without it they are equally spaced.

    Returns
    -------
    float
        In the unit of `values`; 0 for fewer than 8 samples.

    Notes
    -----
    Differences of a smooth signal vanish with that power of the sample period; their median absolute value ignores
    spikes. Where the times jitter, jitter times slope would pass for noise: of divided differences, if the samples
    were taken at those times, of plain ones, if only the stated times jitter; the smaller estimate is taken. At fewer
    than about 20 samples a stroke the signal itself leaks in and the estimate is high. Of a quantised signal without
    noise it gives the quantisation step over sqrt(12).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> round(white_noise_std(np.linspace(0, 1, 10_000) + 0.1 * rng.standard_normal(10_000)), 3)
    0.1
    >>> t = np.arange(0, 10, 1e-3) + 1e-4 * rng.standard_normal(10_000)
    >>> round(white_noise_std(10 * np.cos(200 * t) + 0.01 * rng.standard_normal(10_000), t), 3)
    0.01
    """
    if len(values) < 8:
        return 0.0
    first = max(len(values) // 2 - 200_000, 0)
    part, at_s = values[first : first + 400_000], None if time_s is None else time_s[first : first + 400_000]
    spread = _spread([np.diff(part, order) / np.sqrt(comb(2 * order, order)) for order in _ORDERS])
    if at_s is not None and _jitters(steps_s := np.diff(at_s), usual_s := float(np.median(steps_s))):
        spread = min(spread, _spread([_divided_differences(part, at_s / usual_s, order) for order in _ORDERS]))
    step = np.abs(np.diff(part))
    quantum = float(step[step > 0].min()) if (step > 0).any() else 0.0
    is_quantised = float(np.mean(step == 0)) > 0.05
    return float(max(spread, quantum / np.sqrt(12.0) if is_quantised else 0.0))


def _spread(differences: list[Floats]) -> float:
    low, high = (float(np.median(np.abs(each))) / _MEDIAN_OF_NORMAL for each in differences)
    return high if high < _SURELY_LESS * low else low


def _jitters(steps_s: Floats, usual_s: float) -> bool:
    return float(np.median(np.abs(steps_s - usual_s))) > _JITTER_SHARE * usual_s


def _divided_differences(values: Floats, times: Floats, order: int) -> Floats:
    """Divided differences of some windows spread over a signal, each for white noise of 1 a standard deviation of 1.

    `times` are those of the samples in units of their usual step.
    """
    n_windows = len(values) - order
    starts = np.linspace(0, n_windows - 1, min(n_windows, _JITTERED_WINDOWS)).astype(np.int64)
    at = np.arange(order + 1)[:, None] + starts
    since = times[at] - times[starts]
    weights = 1.0 / np.array([np.prod(since[k] - np.delete(since, k, axis=0), axis=0) for k in range(order + 1)])
    return np.asarray(np.sum(weights * values[at], axis=0) / np.linalg.norm(weights, axis=0))


def robust_range(values: Floats, share_percent: float = 0.5) -> tuple[float, float]:
    """Range of a signal without its `share_percent` lowest and highest samples.

    Parameters
    ----------
    values : ndarray, shape (n,)
        At least one.
    share_percent : float

    Returns
    -------
    low, high : float
        From at most about 200 000 samples spread over the signal.

    Examples
    --------
    >>> robust_range(np.r_[np.arange(1001.0), 1e9], 1.0)
    (10.01, 990.99)
    """
    low, high = np.percentile(values[:: max(len(values) // 200_003, 1)], [share_percent, 100.0 - share_percent])
    return float(low), float(high)
