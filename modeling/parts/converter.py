"""The averaged converter between battery and motor.

    U = d V_b - (1 - d) V_f,   i_b = d i / eta

It changes voltage and current; with the efficiency eta = 1 and without the forward voltage V_f of a freewheeling diode
it keeps the power. Assumptions: switching far above the motor's corner frequency, continuous current, a loss in
proportion to the power. Range: 0 < d <= 1, 0 < eta <= 1 (typically 0.9 to 0.98), V_f 0 to 1.2 V.
Source: Erickson, Maksimovic, Fundamentals of Power Electronics, chapters 3 and 7; section 4.3 of the paper describes
the block, Appendix B its duty n_ea / n_em.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from sawbench.modeling import slots
from sawbench.modeling.compilation import kernel
from sawbench.modeling.validation import fraction, not_negative

if TYPE_CHECKING:
    from numpy.typing import NDArray


@kernel()
def motor_voltage(duty, battery_voltage_v, forward_voltage_v):
    """Voltage at the motor, V.

    Examples
    --------
    >>> motor_voltage(0.5, 18.0, 1.0)
    8.5
    """
    return duty * (battery_voltage_v + forward_voltage_v) - forward_voltage_v


@kernel()
def battery_current(duty, current_a, efficiency):
    """Current from the battery, A."""
    return duty * current_a / efficiency


@kernel()
def holding_duty(open_v, sag_v, held_v, forward_voltage_v):
    """Duty that holds the motor's voltage: d (E + V_f - sag d) = U + V_f; 1 where no duty does.

    Parameters
    ----------
    open_v : float
        Open-circuit voltage E of the battery.
    sag_v : float
        What the battery's resistance would take at a duty of 1: R_b i / eta.
    held_v, forward_voltage_v : float
        U and V_f.

    Examples
    --------
    >>> holding_duty(18.0, 0.0, 9.0, 0.0), holding_duty(18.0, 0.5, 18.0, 0.0)
    (0.5, 1.0)
    """
    wanted, head = held_v + forward_voltage_v, open_v + forward_voltage_v
    square = head * head - 4.0 * sag_v * wanted
    duty = 2.0 * wanted / (head + np.sqrt(np.maximum(square, 0.0)))
    return np.minimum(duty + (square < 0.0) * 1.0, 1.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Converter:
    """Averaged converter.

    Attributes
    ----------
    efficiency : float
        (0, 1].
    forward_voltage_v : float
        Of the diode that the current freewheels through while the switch is off, V.
    """

    efficiency: float = 1.0
    forward_voltage_v: float = 0.0

    def __post_init__(self) -> None:
        fraction("efficiency", self.efficiency)
        not_negative("forward_voltage_v", self.forward_voltage_v, "V")

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the converter's slots into a parameter vector, in place."""
        vector[slots.EFFICIENCY] = self.efficiency
        vector[slots.DIODE] = self.forward_voltage_v
