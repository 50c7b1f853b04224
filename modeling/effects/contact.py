"""The voltage of a contact or a junction against its current: flat, as the logarithm of the current, or in between."""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats

_UNIT_A = 10.0


def contact_voltage(current_a: Floats, knee_a: float, rise: float) -> Floats:
    """Voltage of a contact, 1 at 10 A, odd in the current.

    Parameters
    ----------
    current_a : ndarray
        A.
    knee_a : float
        Current below which the contact is ohmic.
    rise : float
        Share of the voltage that grows with the logarithm of the current, the rest is flat: 0 to 1, below 0 where it
        falls.

    Returns
    -------
    ndarray
        (1 - rise) tanh(i / knee) + rise ln(1 + i / knee), each over its value at 10 A.
    """
    share, unit = current_a / knee_a, _UNIT_A / knee_a
    flat, rising = np.tanh(share) / np.tanh(unit), np.sign(share) * np.log1p(np.abs(share)) / np.log1p(unit)
    return (1.0 - rise) * flat + rise * rising
