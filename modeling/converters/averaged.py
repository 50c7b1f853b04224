"""The ideal averaged converter: it changes voltage and current, and keeps the power.

    U = d V_b,   i_b = d i

Assumptions: switching far above the motor's corner frequency, no loss. Range: 0 < d <= 1.
Source: the averaged switch model of a buck stage (Erickson, Maksimovic, Fundamentals of Power Electronics,
chapter 7); section 4.3 of the paper describes the block, Appendix B its duty n_ea / n_em.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from modeling import slots

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True)
class AveragedConverter:
    """No loss, no drop."""

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the converter's slots into a parameter vector, in place."""
        vector[slots.EFFICIENCY] = 1.0
        vector[slots.DIODE] = 0.0
