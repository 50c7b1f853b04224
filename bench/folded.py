"""The folded cycle: every stroke laid over one turn of the crank."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats


@dataclass(frozen=True, kw_only=True, slots=True)
class FoldedCycle:
    """Mean, spread and count of one channel over the crank angle.

    Attributes
    ----------
    channel, unit : str
    angle_rad : ndarray, shape (n_bins,)
        Bin centres, 0..2*pi, equally spaced.
    mean, std : ndarray, shape (n_bins,), in `unit`
        Mean over the cycles and standard deviation from cycle to cycle.
    count : ndarray of int, shape (n_bins,)
        Cycles that contributed to the bin.
    n_cycles : int
    """

    channel: str
    unit: str
    angle_rad: Floats
    mean: Floats
    std: Floats
    count: NDArray[np.int64]
    n_cycles: int

    def __post_init__(self) -> None:
        lengths = {len(self.angle_rad), len(self.mean), len(self.std), len(self.count)}
        if len(lengths) != 1:
            raise InputError(f"folded cycle of {self.channel}: arrays differ in length")
        for name in ("angle_rad", "mean", "std", "count"):
            array = np.asarray(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)
