"""The averaged converter with a constant efficiency: the battery pays, the motor voltage stays.

    U = d V_b,   i_b = d i / eta

Assumptions: loss in proportion to the power. Range: 0 < eta <= 1, typically 0.9 to 0.98.
Source: Erickson, Maksimovic, Fundamentals of Power Electronics, chapter 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from modeling import slots
from modeling.validation import fraction

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True)
class LossyConverter:
    """Constant efficiency.

    Attributes
    ----------
    efficiency : float
        (0, 1].
    """

    efficiency: float

    def __post_init__(self) -> None:
        fraction("efficiency", self.efficiency)

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the converter's slots into a parameter vector, in place."""
        vector[slots.EFFICIENCY] = self.efficiency
        vector[slots.DIODE] = 0.0
