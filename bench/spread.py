"""Scatter as most of the values show it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Standard deviation of a normal distribution about zero over the median of its absolute values.
STD_OVER_MEDIAN: Final = 1.4826


def robust_std(deviations: ArrayLike) -> float:
    """Standard deviation of deviations from their middle, which up to half of them may spoil.

    Parameters
    ----------
    deviations : array_like

    Examples
    --------
    >>> robust_std([-1.0, 1.0, -1.0, 50.0])
    1.4826
    """
    return STD_OVER_MEDIAN * float(np.median(np.abs(deviations)))
