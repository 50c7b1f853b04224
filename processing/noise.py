"""White noise and range of a signal, neither of them moved by a few spikes."""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats


def white_noise_std(values: Floats) -> float:
    """Estimate the standard deviation of the white noise from third differences.

    Parameters
    ----------
    values : ndarray, shape (n,)

    Returns
    -------
    float
        In the unit of `values`; 0 for fewer than 8 samples.

    Notes
    -----
    Third differences of a smooth signal vanish with the third power of the sample period; their median
    absolute value ignores spikes. At fewer than about 60 samples a stroke the signal itself leaks in and the
    estimate is high. Of a quantised signal without noise it gives the quantisation step over sqrt(12).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> round(white_noise_std(np.linspace(0, 1, 10_000) + 0.1 * rng.standard_normal(10_000)), 3)
    0.1
    """
    if len(values) < 8:
        return 0.0
    part = values if len(values) <= 400_000 else values[len(values) // 2 - 200_000 : len(values) // 2 + 200_000]
    difference = np.diff(part, 3)
    spread = float(np.median(np.abs(difference))) / (0.674490 * np.sqrt(20.0))
    step = np.abs(np.diff(part))
    quantum = float(step[step > 0].min()) if (step > 0).any() else 0.0
    is_quantised = float(np.mean(step == 0)) > 0.05
    return float(max(spread, quantum / np.sqrt(12.0) if is_quantised else 0.0))


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
