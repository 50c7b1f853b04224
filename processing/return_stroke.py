"""Zero the force on the return stroke, and say what that took away."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, Literal

import numpy as np
from sawbench.bench.folded import FoldedCycle
from sawbench.bench.processed import RemovedForce

# Of the peak: what a blade that rubs leaves on the return stroke is less, and follows its motion.
_LEVEL_SHARE: Final = 0.1
# Scatter of a level over the level.
_LEVEL_SCATTER: Final = 0.5

CuttingHalf = Literal["zero_to_pi", "pi_to_2pi"]


def zero_return_stroke(force: FoldedCycle, cutting_half: CuttingHalf) -> tuple[FoldedCycle, RemovedForce]:
    """Set the half of the cycle that does not cut to zero.

    Parameters
    ----------
    force : FoldedCycle
        N over the crank angle.
    cutting_half : {"zero_to_pi", "pi_to_2pi"}

    Returns
    -------
    cutting_force : FoldedCycle
        Mean and standard deviation are 0 on the return half.
    removed : RemovedForce

    Examples
    --------
    >>> angle = (np.arange(64) + 0.5) * 2 * np.pi / 64
    >>> mean = np.maximum(-np.sin(angle), 0.0)
    >>> force = FoldedCycle(channel="force_n", unit="N", angle_rad=angle, mean=mean,
    ...     std=np.zeros(64), count=np.ones(64, int), n_cycles=1)
    >>> zero_return_stroke(force, "pi_to_2pi")[1].share_of_impulse
    0.0
    >>> zero_return_stroke(force, "zero_to_pi")[1].looks_swapped
    True
    """
    is_first_half = force.angle_rad < np.pi
    is_return = ~is_first_half if cutting_half == "zero_to_pi" else is_first_half
    gone, kept = force.mean[is_return], force.mean[~is_return]
    total = float(np.abs(force.mean).sum())
    removed = RemovedForce(
        mean_n=float(gone.mean()),
        rms_n=float(np.sqrt(np.mean(gone**2))),
        peak_n=float(gone[np.argmax(np.abs(gone))]),
        share_of_impulse=float(np.abs(gone).sum() / total) if total > 0 else 0.0,
        half="pi_to_2pi" if cutting_half == "zero_to_pi" else "zero_to_pi",
        looks_swapped=bool(np.abs(gone).sum() > np.abs(kept).sum()),
    )
    cutting = replace(
        force,
        mean=np.where(is_return, 0.0, force.mean),
        std=np.where(is_return, 0.0, force.std),
    )
    return cutting, removed


def stands_at_a_level(removed: RemovedForce, peak_n: float) -> bool:
    """Whether the force of the return stroke is one level throughout, as that of a load cell that was not tared.

    Parameters
    ----------
    removed : RemovedForce
    peak_n : float
        Peak of the cutting force, N.

    Examples
    --------
    >>> angle = (np.arange(64) + 0.5) * 2 * np.pi / 64
    >>> force = FoldedCycle(channel="force_n", unit="N", angle_rad=angle, mean=300.0 * np.maximum(-np.sin(angle), 0.0),
    ...     std=np.zeros(64), count=np.ones(64, int), n_cycles=1)
    >>> untared = replace(force, mean=force.mean + 85.0)
    >>> [stands_at_a_level(zero_return_stroke(one, "pi_to_2pi")[1], one.mean.max()) for one in (force, untared)]
    [False, True]
    """
    scatter_n2 = max(removed.rms_n**2 - removed.mean_n**2, 0.0)
    is_steady = scatter_n2 < (_LEVEL_SCATTER * removed.mean_n) ** 2
    return bool(is_steady and abs(removed.mean_n) > _LEVEL_SHARE * abs(peak_n))
