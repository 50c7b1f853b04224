"""The averaged converter whose current freewheels through a diode while the switch is off.

    U = d V_b - (1 - d) V_f,   i_b = d i

Assumptions: continuous current, constant forward voltage. Range: V_f 0 to 1.2 V.
Source: Erickson, Maksimovic, Fundamentals of Power Electronics, chapter 3.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from modeling import slots
from modeling.validation import not_negative

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True)
class DiodeDropConverter:
    """Freewheeling diode.

    Attributes
    ----------
    forward_voltage_v : float
        V.
    """

    forward_voltage_v: float

    def __post_init__(self) -> None:
        not_negative("forward_voltage_v", self.forward_voltage_v, "V")

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the converter's slots into a parameter vector, in place."""
        vector[slots.EFFICIENCY] = 1.0
        vector[slots.DIODE] = self.forward_voltage_v
