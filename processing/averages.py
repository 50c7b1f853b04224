"""Mean and root mean square over whole strokes, so that a cut-off stroke does not bias them."""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.processing.folding import Cycles


def cycle_averages(time_s: Floats, values: Floats, cycles: Cycles) -> tuple[float, float]:
    """Time mean and rms over the given cycles (trapezoidal rule between the exact ends).

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
    cycles : Cycles
        At least one.

    Returns
    -------
    mean, rms : float
        In the unit of `values`. White noise of variance s^2 adds up to s^2 to the square of the rms.

    Examples
    --------
    >>> t = np.linspace(0, 1, 1001)
    >>> one = Cycles(index=np.array([0]), start_s=np.array([0.1]), end_s=np.array([0.6]))
    >>> mean, rms = cycle_averages(t, np.sin(4 * np.pi * t), one)
    >>> abs(mean) < 1e-9, round(rms, 4)
    (True, 0.7071)
    """
    duration = float(cycles.period_s.sum())
    level = float(values[len(values) // 2])  # sums about a level near the mean keep their digits
    d = values - level
    step = np.diff(time_s)
    # The integral of a straight line squared is exact: (a^2 + a b + b^2) / 3.
    of_value = np.concatenate(([0.0], np.cumsum(0.5 * step * (d[1:] + d[:-1]))))
    of_square = np.concatenate(([0.0], np.cumsum(step * (d[1:] ** 2 + d[1:] * d[:-1] + d[:-1] ** 2) / 3.0)))
    mean = _between(time_s, of_value, cycles) / duration
    square = _between(time_s, of_square, cycles) / duration
    return float(mean + level), float(np.sqrt(max(square + 2 * level * mean + level**2, 0.0)))


def _between(time: Floats, integral: Floats, cycles: Cycles) -> float:
    return float((np.interp(cycles.end_s, time, integral) - np.interp(cycles.start_s, time, integral)).sum())
