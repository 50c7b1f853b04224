r"""The battery of Equation 16: a voltage that bends down with the charge taken, behind a resistance.

    E(s) = V_nom s / (1 - beta (1 - s)),   V = E - R_b i_b,   ds/dt = -i_b / Q

Assumptions: no relaxation, no temperature, R_b constant. Range: 0 <= beta < 1; E(1) = V_nom, E(0) = 0.
Source: Apati, Hegedus, Hajdu, MSSP 10.1016/j.ymssp.2025.113229, Eq. 16 (Simscape Battery block).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from modeling import slots
from modeling.compilation import kernel
from modeling.validation import below_one, not_negative, positive

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from bench.config import BatteryConfig


@kernel()
def voltage(nominal_voltage_v, beta, fraction):
    """Open-circuit voltage and its slope over the charge fraction, V (Eq. 16); 0 below an empty battery.

    Examples
    --------
    >>> voltage(18.0, 0.99, 1.0)[0]
    18.0
    """
    fraction = max(fraction, 0.0)
    below = 1.0 / (1.0 - beta * (1.0 - fraction))
    return nominal_voltage_v * fraction * below, nominal_voltage_v * (1.0 - beta) * below * below


@dataclass(frozen=True, kw_only=True, slots=True)
class Eq16Battery:
    """The paper's battery (Eq. 16).

    Attributes
    ----------
    nominal_voltage_v : float
        Open-circuit voltage when full, V.
    capacity_ah : float
        Charge from full to empty, Ah.
    beta : float
        Shape, [0, 1).
    internal_resistance_ohm : float

    Examples
    --------
    >>> battery = Eq16Battery(nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.99)
    >>> round(battery.open_circuit_voltage_v(0.2), 3)
    17.308
    """

    nominal_voltage_v: float
    capacity_ah: float
    beta: float
    internal_resistance_ohm: float = 0.0

    def __post_init__(self) -> None:
        positive("nominal_voltage_v", self.nominal_voltage_v, "V")
        positive("capacity_ah", self.capacity_ah, "Ah")
        below_one("beta", self.beta)
        not_negative("internal_resistance_ohm", self.internal_resistance_ohm, "Ohm")

    @classmethod
    def from_config(cls, config: BatteryConfig) -> Eq16Battery:
        """Take the battery from the `[battery]` table."""
        return cls(
            nominal_voltage_v=config.nominal_voltage_v,
            capacity_ah=config.capacity_ah,
            beta=config.beta,
            internal_resistance_ohm=config.internal_resistance_ohm,
        )

    def open_circuit_voltage_v(self, soc: float) -> float:
        """Open-circuit voltage at a state of charge (0..1), V."""
        return float(voltage(self.nominal_voltage_v, self.beta, soc)[0])

    def ocv_table(self) -> NDArray[np.float64] | None:
        """No table: the equation is used itself."""
        return None

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the battery's slots into a parameter vector, in place."""
        vector[slots.NOMINAL_VOLTAGE] = self.nominal_voltage_v
        vector[slots.CAPACITY] = 3600.0 * self.capacity_ah
        vector[slots.BETA] = self.beta
        vector[slots.BATTERY_RESISTANCE] = self.internal_resistance_ohm
        vector[slots.CAPACITY_RATIO] = 1.0
        vector[slots.RC_RESISTANCE] = 0.0
        vector[slots.RC_TIME] = 1.0
