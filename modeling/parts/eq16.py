r"""The battery of Equation 16: a voltage that bends down with the charge taken, behind a resistance.

    E(x) = V_nom x / (1 - beta (1 - x)),   x = 1 - (1 - s) Q / Q_shape,   V = E - R_b i_b,   ds/dt = -i_b / Q

In the paper Q_shape = Q, so that E falls to 0 V exactly when the rated charge is gone. Real cells are cut off well
before: with Q_shape free beside beta the curve follows measured discharges several times closer. State of charge and
cut-off always count the rated capacity Q.
Assumptions: no relaxation, no temperature, R_b constant. Range: 0 <= beta < 1; E(x = 1) = V_nom, E(x <= 0) = 0.
Source: Apati, Hegedus, Hajdu, MSSP 10.1016/j.ymssp.2025.113229, Eq. 16 (Simscape Battery block).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from sawbench.modeling import slots
from sawbench.modeling.compilation import kernel
from sawbench.modeling.validation import below_one, not_negative, positive

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from sawbench.bench.config import BatteryConfig


@kernel()
def voltage(nominal_voltage_v, beta, fraction):
    """Open-circuit voltage, its first and half its second derivative over the charge fraction, V (Eq. 16).

    0 below an empty battery.

    Examples
    --------
    >>> voltage(18.0, 0.99, 1.0)[0]
    18.0
    """
    fraction = np.maximum(fraction, 0.0)
    below = 1.0 / (1.0 - beta * (1.0 - fraction))
    slope = nominal_voltage_v * (1.0 - beta) * below * below
    return nominal_voltage_v * fraction * below, slope, -slope * beta * below


@dataclass(frozen=True, kw_only=True, slots=True)
class Eq16Battery:
    """The paper's battery (Eq. 16).

    Attributes
    ----------
    nominal_voltage_v : float
        Open-circuit voltage when full, V.
    capacity_ah : float
        Rated charge: what the state of charge counts, Ah.
    beta : float
        Shape, [0, 1).
    internal_resistance_ohm : float
    shape_capacity_ah : float or None
        Charge at which the equation reaches 0 V, Ah; None: the rated charge, as in the paper.

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
    shape_capacity_ah: float | None = None

    def __post_init__(self) -> None:
        positive("nominal_voltage_v", self.nominal_voltage_v, "V")
        positive("capacity_ah", self.capacity_ah, "Ah")
        below_one("beta", self.beta)
        not_negative("internal_resistance_ohm", self.internal_resistance_ohm, "Ohm")
        if self.shape_capacity_ah is not None:
            positive("shape_capacity_ah", self.shape_capacity_ah, "Ah")

    @classmethod
    def from_config(cls, config: BatteryConfig) -> Eq16Battery:
        """Take the battery from the `[battery]` table."""
        return cls(
            nominal_voltage_v=config.nominal_voltage_v,
            capacity_ah=config.capacity_ah,
            beta=config.beta,
            internal_resistance_ohm=config.internal_resistance_ohm,
            shape_capacity_ah=None if config.shape_ratio == 1.0 else config.shape_ratio * config.capacity_ah,
        )

    @property
    def capacity_ratio(self) -> float:
        """Rated charge over the charge that shapes the equation."""
        return 1.0 if self.shape_capacity_ah is None else self.capacity_ah / self.shape_capacity_ah

    def open_circuit_voltage_v(self, soc: float) -> float:
        """Open-circuit voltage at a state of charge (0..1), V."""
        fraction = 1.0 - (1.0 - soc) * self.capacity_ratio
        return float(voltage.py_func(self.nominal_voltage_v, self.beta, fraction)[0])

    def ocv_table(self) -> NDArray[np.float64] | None:
        """No table: the equation is used itself."""
        return None

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the battery's slots into a parameter vector, in place."""
        vector[slots.NOMINAL_VOLTAGE] = self.nominal_voltage_v
        vector[slots.CAPACITY] = 3600.0 * self.capacity_ah
        vector[slots.BETA] = self.beta
        vector[slots.BATTERY_RESISTANCE] = self.internal_resistance_ohm
        vector[slots.CAPACITY_RATIO] = self.capacity_ratio
