"""What the timing of a stream gives: blocks with times, losses between them, and times that may be wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True)
class TimedBlock:
    """Samples with times on the monotonic clock.

    Attributes
    ----------
    first_index : int
    time_s : ndarray, shape (n,), s
    period_s : float, optional
        Spacing, where it is constant.
    raw : ndarray, shape (n, n_channels)
    """

    first_index: int
    time_s: NDArray[np.float64]
    period_s: float | None
    raw: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class Loss:
    """Samples that never came.

    Attributes
    ----------
    start_s, end_s : float
        Last sample before and first one after, monotonic clock, s.
    n_missing : int
    reason : str
    """

    start_s: float
    end_s: float
    n_missing: int
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Doubt:
    """Times that may be wrong.

    Attributes
    ----------
    start_s, end_s : float
        Monotonic clock, s.
    text : str
    n_taken_back : int
        Samples called lost before that were not.
    is_decided : bool
        False: samples are late and wait; whether any were lost is about to be decided.
    """

    start_s: float
    end_s: float
    text: str
    n_taken_back: int = 0
    is_decided: bool = True


Timed = TimedBlock | Loss | Doubt
