"""The thinned signal that plotting programs show: lowest, mean and highest value of each interval."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from sawbench.bench.recording import Floats


class PreviewBuilder:
    """Collects samples of one channel into intervals of equal length.

    Parameters
    ----------
    rate_hz : float
        Intervals a second, Hz. Slower signals give one interval a sample.

    Examples
    --------
    >>> builder = PreviewBuilder(rate_hz=10.0)
    >>> list(builder.add(np.array([0.0, 0.05, 0.1]), np.array([1.0, 3.0, 7.0])))
    [(0.05, 1.0, 2.0, 3.0)]
    >>> builder.finish()
    [(0.15, 7.0, 7.0, 7.0)]
    """

    def __init__(self, *, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._bin = 0
        self._count = 0
        self._sum = 0.0
        self._lowest = math.inf
        self._highest = -math.inf

    def add(self, time_s: Floats, values: Floats) -> Iterator[tuple[float, float, float, float]]:
        """Take samples and yield the intervals they complete.

        Parameters
        ----------
        time_s : ndarray, shape (n,), s
        values : ndarray, shape (n,), in the channel's unit

        Yields
        ------
        tuple of float
            Middle of the interval in s, lowest, mean and highest value.
        """
        # The small shift keeps samples that sit on an edge, up to rounding, in the later interval.
        bins = np.floor(time_s * self._rate_hz + 1e-6)
        starts = np.concatenate(([0], np.flatnonzero(np.diff(bins)) + 1))
        counts = np.diff(np.append(starts, len(bins)))
        sums = np.add.reduceat(values, starts)
        lows = np.minimum.reduceat(values, starts)
        highs = np.maximum.reduceat(values, starts)
        for k, start in enumerate(starts):
            if self._count and bins[start] != self._bin:
                yield self._take()
            self._bin = bins[start]
            self._count += int(counts[k])
            self._sum += float(sums[k])
            self._lowest = min(self._lowest, float(lows[k]))
            self._highest = max(self._highest, float(highs[k]))

    def finish(self) -> list[tuple[float, float, float, float]]:
        """Return the interval that was not complete yet, if there is one."""
        return [self._take()] if self._count else []

    def _take(self) -> tuple[float, float, float, float]:
        middle_s = float((self._bin + 0.5) / self._rate_hz)
        taken = (middle_s, self._lowest, self._sum / self._count, self._highest)
        self._count, self._sum, self._lowest, self._highest = 0, 0.0, math.inf, -math.inf
        return taken
