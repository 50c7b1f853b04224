"""What feeds the motor: an ideal voltage, a fixed duty of a battery, or a held voltage."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from sawbench.modeling import slots
from sawbench.modeling.parts.converter import Converter
from sawbench.modeling.validation import fraction, not_negative, positive


class Battery(Protocol):
    """What a supply needs of a battery."""

    @property
    def capacity_ah(self) -> float:
        """Rated capacity, Ah."""
        ...

    def open_circuit_voltage_v(self, soc: float) -> float:
        """Open-circuit voltage at a state of charge (0..1), V."""
        ...

    def ocv_table(self) -> NDArray[np.float64] | None:
        """Spline of the open-circuit voltage where it comes from a table, shape (n, 4)."""
        ...

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the battery's slots into a parameter vector, in place."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class FixedVoltage:
    """An ideal source straight at the motor: U = voltage_v.

    Attributes
    ----------
    voltage_v : float
        V, not negative.

    Examples
    --------
    >>> FixedVoltage(voltage_v=18.0 * 18.41 / 42.08).battery is None
    True
    """

    voltage_v: float
    battery: None = field(default=None, init=False)

    def __post_init__(self) -> None:
        not_negative("voltage_v", self.voltage_v, "V")

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the supply's slots into a parameter vector, in place."""
        vector[slots.MODE] = slots.FIXED_VOLTAGE
        vector[slots.VOLTAGE] = self.voltage_v


@dataclass(frozen=True, kw_only=True, slots=True)
class FixedDuty:
    """A PWM stage at a fixed duty: U = duty V_b, i_b = duty i (and the converter's losses).

    The battery voltage sags with its own current; V_b = E - R_b duty i is solved in closed form.

    Attributes
    ----------
    duty : float
        (0, 1].
    battery : Battery
    converter : Converter
    """

    duty: float
    battery: Battery
    converter: Converter = field(default_factory=Converter)

    def __post_init__(self) -> None:
        fraction("duty", self.duty)

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the supply's slots into a parameter vector, in place."""
        vector[slots.MODE] = slots.FIXED_DUTY
        vector[slots.DUTY] = self.duty
        self.battery.fill(vector)
        self.converter.fill(vector)


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldVoltage:
    """A converter that trims its duty so that the motor voltage stays: duty = U / V_b, at most 1.

    The reading that reproduces the paper's runtime. V_b = E - R_b i_b with i_b = duty i is a quadratic in
    the duty, solved in closed form.

    Attributes
    ----------
    voltage_v : float
        Motor voltage that is held, V.
    battery : Battery
    converter : Converter
    """

    voltage_v: float
    battery: Battery
    converter: Converter = field(default_factory=Converter)

    def __post_init__(self) -> None:
        positive("voltage_v", self.voltage_v, "V")

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the supply's slots into a parameter vector, in place."""
        vector[slots.MODE] = slots.HELD_VOLTAGE
        vector[slots.VOLTAGE] = self.voltage_v
        self.battery.fill(vector)
        self.converter.fill(vector)


Supply = FixedVoltage | FixedDuty | HeldVoltage
