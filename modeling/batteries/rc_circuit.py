r"""Equivalent circuit: an open-circuit voltage over the state of charge, a resistance, one RC element.

    V = OCV(s) - R_0 i - v,   dv/dt = (R_1 i - v) / (R_1 C_1),   ds/dt = -i / Q

Assumptions: one relaxation time, no temperature, discharge only (no hysteresis). Range: the table rises with
the charge and spans 0 to 1; between its points a monotone cubic (Fritsch-Carlson), sampled on 200 equal
pieces. Source: the Thevenin model, Plett, Battery Management Systems I, section 2.4.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from bench.errors import InputError
from modeling import slots
from modeling.validation import not_negative, positive

if TYPE_CHECKING:
    from numpy.typing import NDArray

N_PIECES = 200


@dataclass(frozen=True, kw_only=True, slots=True)
class RcBattery:
    """Thevenin equivalent circuit with a table of the open-circuit voltage.

    Attributes
    ----------
    soc : ndarray, shape (n,)
        Increasing from 0 to 1, at least 3 points.
    ocv_v : ndarray, shape (n,)
        Open-circuit voltage at those, increasing, V.
    capacity_ah : float
    internal_resistance_ohm : float
        R_0.
    rc_resistance_ohm : float
        R_1.
    rc_time_constant_s : float
        R_1 C_1.

    Examples
    --------
    >>> battery = RcBattery(soc=[0.0, 0.5, 1.0], ocv_v=[15.0, 18.0, 21.0], capacity_ah=1.5)
    >>> round(battery.open_circuit_voltage_v(0.5), 6)
    18.0
    """

    soc: NDArray[np.float64]
    ocv_v: NDArray[np.float64]
    capacity_ah: float
    internal_resistance_ohm: float = 0.0
    rc_resistance_ohm: float = 0.0
    rc_time_constant_s: float = 10.0
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
        not_negative("rc_resistance_ohm", self.rc_resistance_ohm, "Ohm")
        positive("rc_time_constant_s", self.rc_time_constant_s, "s")
        for name, value in (("soc", soc), ("ocv_v", ocv), ("_pieces", _pieces(soc, ocv))):
            if name != "_pieces":
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    def open_circuit_voltage_v(self, soc: float) -> float:
        """Open-circuit voltage at a state of charge (0..1), V."""
        place = int(min(max(soc * N_PIECES, 0), N_PIECES - 1))
        u = soc - place / N_PIECES
        c = self._pieces[place]
        return float(c[0] + u * (c[1] + u * (c[2] + u * c[3])))

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
        vector[slots.RC_RESISTANCE] = self.rc_resistance_ohm
        vector[slots.RC_TIME] = self.rc_time_constant_s


def _pieces(soc: NDArray[np.float64], ocv: NDArray[np.float64]) -> NDArray[np.float64]:
    """Monotone cubic through the table, written on equal pieces: c0 + c1 u + c2 u^2 + c3 u^3."""
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

    curve = PchipInterpolator(soc, ocv)
    grid = np.linspace(0.0, 1.0, N_PIECES + 1)
    even = CubicHermiteSpline(grid, curve(grid), curve(grid, 1))
    return np.ascontiguousarray(even.c[::-1].T)
