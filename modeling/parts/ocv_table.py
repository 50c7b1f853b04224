"""A battery whose open-circuit voltage is a measured table over the state of charge, behind a resistance.

    V = OCV(s) - R i,   ds/dt = -i / Q

Assumptions: no relaxation, no temperature, discharge only (no hysteresis). Range: the table rises with the charge and
spans 0 to 1; between its points a monotone cubic (Fritsch-Carlson), sampled on 200 equal pieces.
Source: the equivalent circuit of Plett, Battery Management Systems I, section 2.2.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.modeling import slots
from sawbench.modeling.compilation import kernel
from sawbench.modeling.validation import not_negative, positive

if TYPE_CHECKING:
    from numpy.typing import NDArray

N_PIECES = 200


@kernel()
def voltage(pieces, soc):
    """Open-circuit voltage, its first and half its second derivative over the charge, V.

    `pieces`, shape (n, 4), holds c0 + c1 u + c2 u^2 + c3 u^3 on equal parts of [0, 1].
    """
    place = np.maximum(np.minimum(np.int64(soc * len(pieces)), len(pieces) - 1), 0)
    u = soc - place / len(pieces)
    second = pieces[place, 2] + 3.0 * u * pieces[place, 3]
    first = pieces[place, 1] + u * (pieces[place, 2] + second)
    return (
        pieces[place, 0] + u * (pieces[place, 1] + u * (pieces[place, 2] + u * pieces[place, 3])),
        first,
        second,
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class TableBattery:
    """Table of the open-circuit voltage, and a resistance.

    Attributes
    ----------
    soc : ndarray, shape (n,)
        Increasing from 0 to 1, at least 3 points.
    ocv_v : ndarray, shape (n,)
        Open-circuit voltage at those, increasing, V.
    capacity_ah : float
    internal_resistance_ohm : float

    Examples
    --------
    >>> battery = TableBattery(soc=[0.0, 0.5, 1.0], ocv_v=[15.0, 18.0, 21.0], capacity_ah=1.5)
    >>> round(battery.open_circuit_voltage_v(0.5), 6)
    18.0
    """

    soc: NDArray[np.float64]
    ocv_v: NDArray[np.float64]
    capacity_ah: float
    internal_resistance_ohm: float = 0.0
    _pieces: NDArray[np.float64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        soc = np.array(self.soc, dtype=np.float64)
        ocv = np.array(self.ocv_v, dtype=np.float64)
        if soc.ndim != 1 or len(soc) < 3 or soc.shape != ocv.shape:
            raise InputError(f"soc and ocv_v need one equal length of at least 3, got {soc.shape} and {ocv.shape}")
        if not (np.isfinite(soc).all() and np.isfinite(ocv).all()):
            raise InputError("soc and ocv_v must be finite")
        if soc[0] != 0.0 or soc[-1] != 1.0 or (np.diff(soc) <= 0).any():
            raise InputError("soc must increase from 0 to 1")
        if (np.diff(ocv) <= 0).any() or ocv[0] < 0:
            raise InputError("ocv_v must increase with the charge and not be negative")
        positive("capacity_ah", self.capacity_ah, "Ah")
        not_negative("internal_resistance_ohm", self.internal_resistance_ohm, "Ohm")
        for name, value in (("soc", soc), ("ocv_v", ocv), ("_pieces", _pieces(soc, ocv))):
            if name != "_pieces":
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    def open_circuit_voltage_v(self, soc: float) -> float:
        """Open-circuit voltage at a state of charge (0..1), V."""
        return float(voltage.py_func(self._pieces, soc)[0])

    def ocv_table(self) -> NDArray[np.float64]:
        """Cubic pieces on equal parts of [0, 1], shape (200, 4)."""
        return self._pieces

    def fill(self, vector: NDArray[np.float64]) -> None:
        """Write the battery's slots into a parameter vector, in place."""
        vector[slots.NOMINAL_VOLTAGE] = self.ocv_v[-1]
        vector[slots.CAPACITY] = 3600.0 * self.capacity_ah
        vector[slots.BETA] = 0.0
        vector[slots.CAPACITY_RATIO] = 1.0
        vector[slots.BATTERY_RESISTANCE] = self.internal_resistance_ohm


def _pieces(soc: NDArray[np.float64], ocv: NDArray[np.float64]) -> NDArray[np.float64]:
    """Monotone cubic through the table, written on equal pieces: c0 + c1 u + c2 u^2 + c3 u^3."""
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

    curve = PchipInterpolator(soc, ocv)
    grid = np.linspace(0.0, 1.0, N_PIECES + 1)
    even = CubicHermiteSpline(grid, curve(grid), curve(grid, 1))
    return np.ascontiguousarray(even.c[::-1].T)
