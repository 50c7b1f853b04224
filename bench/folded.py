"""The folded cycle: every stroke laid over one turn of the crank."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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

    def on(self, angle_rad: Floats) -> FoldedCycle:
        """Interpolate onto other bin centres, shape (m,)."""
        if np.array_equal(angle_rad, self.angle_rad):
            return self
        mean, std, count = (
            np.interp(angle_rad, self.angle_rad, values, period=2.0 * np.pi)
            for values in (self.mean, self.std, self.count)
        )
        return replace(self, angle_rad=angle_rad, mean=mean, std=std, count=np.rint(count).astype(np.int64))


def pooled(cycles: Sequence[FoldedCycle]) -> FoldedCycle:
    """Mean and spread of the strokes of several cycles of one channel, as if all had been folded together.

    Parameters
    ----------
    cycles : sequence of FoldedCycle
        At least one; those with other bin centres than the first are interpolated onto these.

    Returns
    -------
    FoldedCycle
        Its spread holds the scatter within the cycles and between them; NaN in bins without any value.

    Examples
    --------
    >>> one, two = (np.array([1.0, 3.0]), np.array([2.0, 4.0, 5.0]))
    >>> def folded(values):
    ...     return FoldedCycle(
    ...         channel="force_n", unit="N", angle_rad=np.zeros(1), mean=np.array([values.mean()]),
    ...         std=np.array([values.std(ddof=1)]), count=np.array([len(values)]), n_cycles=len(values),
    ...     )  # fmt: skip
    >>> both = pooled([folded(one), folded(two)])
    >>> bool(both.mean == 3.0 and np.isclose(both.std, np.std([1.0, 3.0, 2.0, 4.0, 5.0], ddof=1)))
    True
    """
    first = cycles[0]
    cycles = [cycle.on(first.angle_rad) for cycle in cycles]
    is_known = np.array([np.isfinite(cycle.mean) for cycle in cycles])
    n = np.where(is_known, [cycle.count for cycle in cycles], 0)
    means = np.where(is_known, [cycle.mean for cycle in cycles], 0.0)
    within = np.maximum(n - 1.0, 0.0) * np.where(is_known, np.nan_to_num([cycle.std for cycle in cycles]), 0.0) ** 2
    total = np.where(n.sum(axis=0) > 0, n.sum(axis=0), np.nan)
    mean = (n * means).sum(axis=0) / total
    squares = (within + n * (means - mean) ** 2).sum(axis=0)
    return replace(
        first,
        mean=mean,
        std=np.sqrt(squares / np.maximum(total - 1.0, 1.0)),
        count=n.sum(axis=0),
        n_cycles=sum(cycle.n_cycles for cycle in cycles),
    )
