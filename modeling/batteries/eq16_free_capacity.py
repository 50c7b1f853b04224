r"""Equation 16 with the charge that shapes it free of the rated capacity.

    x = 1 - (1 - s) Q / Q_shape,   E = V_nom x / (1 - beta (1 - x))

Eq. 16 falls to 0 V exactly when the rated charge is gone. Real cells are cut off well before; with Q_shape
fitted beside beta the curve follows measured discharges several times closer. Range: Q_shape > 0, 0 <= beta
< 1. State of charge and cut-off keep the rated capacity. Source: Eq. 16 of the paper with one more parameter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from modeling import slots
from modeling.batteries.eq16 import voltage
from modeling.validation import below_one, not_negative, positive

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True)
class FreeCapacityBattery:
    """Eq. 16 with free capacity.

    Attributes
    ----------
    nominal_voltage_v : float
        Open-circuit voltage when full, V.
    capacity_ah : float
        Rated capacity: what the state of charge counts, Ah.
    shape_capacity_ah : float
        Charge at which the equation would reach 0 V, Ah.
    beta : float
        Shape, [0, 1).
    internal_resistance_ohm : float

    Examples
    --------
    >>> battery = FreeCapacityBattery(nominal_voltage_v=4.2, capacity_ah=5.0, shape_capacity_ah=6.0, beta=0.9)
    >>> battery.open_circuit_voltage_v(0.0) > 0
    True
    """

    nominal_voltage_v: float
    capacity_ah: float
    shape_capacity_ah: float
    beta: float
    internal_resistance_ohm: float = 0.0

    def __post_init__(self) -> None:
        positive("nominal_voltage_v", self.nominal_voltage_v, "V")
        positive("capacity_ah", self.capacity_ah, "Ah")
        positive("shape_capacity_ah", self.shape_capacity_ah, "Ah")
        below_one("beta", self.beta)
        not_negative("internal_resistance_ohm", self.internal_resistance_ohm, "Ohm")

    def open_circuit_voltage_v(self, soc: float) -> float:
        """Open-circuit voltage at a state of charge (0..1), V."""
        taken = (1.0 - soc) * self.capacity_ah / self.shape_capacity_ah
        return float(voltage(self.nominal_voltage_v, self.beta, 1.0 - taken)[0])

    def ocv_table(self) -> NDArray[np.float64] | None:
        """No table: the equation is used itself."""
        return None

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the battery's slots into a parameter vector, in place."""
        vector[slots.NOMINAL_VOLTAGE] = self.nominal_voltage_v
        vector[slots.CAPACITY] = 3600.0 * self.capacity_ah
        vector[slots.BETA] = self.beta
        vector[slots.BATTERY_RESISTANCE] = self.internal_resistance_ohm
        vector[slots.CAPACITY_RATIO] = self.capacity_ah / self.shape_capacity_ah
        vector[slots.RC_RESISTANCE] = 0.0
        vector[slots.RC_TIME] = 1.0
