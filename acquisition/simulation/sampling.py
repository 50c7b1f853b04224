"""When an emulated instrument takes its samples: by its own quartz, from its start on."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


class Sampler:
    """Sample times of one instrument.

    Parameters
    ----------
    rate_hz : float
    clock_error_ppm : float
        How much faster than nominal its quartz runs.

    Examples
    --------
    >>> sampler = Sampler(100.0)
    >>> sampler.begin(1.0)
    >>> sampler.due(1.02).tolist(), sampler.due(1.021).tolist(), sampler.n_taken
    ([1.0, 1.01, 1.02], [], 3)
    """

    def __init__(self, rate_hz: float, clock_error_ppm: float = 0.0) -> None:
        self.rate_hz = rate_hz * (1.0 + clock_error_ppm * 1e-6)
        self.begun_s: float | None = None
        self.n_taken = 0

    @property
    def is_running(self) -> bool:
        """Whether it takes samples."""
        return self.begun_s is not None

    def begin(self, now_s: float) -> None:
        """Take the first sample at `now_s`; going on already, restart."""
        self.begun_s, self.n_taken = now_s, 0

    def end(self) -> None:
        """Take no more."""
        self.begun_s = None

    def due(self, now_s: float) -> NDArray[np.float64]:
        """Times of the samples up to `now_s` that were not returned before, s."""
        if self.begun_s is None:
            return np.empty(0)
        # A whole number of periods may come out a rounding error short.
        n_due = math.floor((now_s - self.begun_s) * self.rate_hz + 1e-9) + 1
        index = np.arange(self.n_taken, n_due)
        self.n_taken = max(self.n_taken, n_due)
        return self.begun_s + index / self.rate_hz
