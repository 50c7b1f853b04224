"""From what an instrument sends to what it means: scale, offset, zero, with where the numbers come from."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator


class Calibration(BaseModel):
    """value = offset + scale * (raw - zero_raw), or a polynomial of (raw - zero_raw).

    Attributes
    ----------
    scale : float
        Channel unit per raw unit.
    offset : float
        In the channel unit.
    zero_raw : float
        Raw reading of the unloaded sensor (tare), in the raw unit.
    polynomial : tuple of float, optional
        Coefficients in rising powers, in place of scale and offset.
    raw_unit : str
        Unit of what the instrument sends, such as "mV/V".
    rel_std : float
        Relative standard uncertainty of the scale.
    source : str
        Certificate, date, who: kept in every recording.

    Examples
    --------
    >>> Calibration(scale=250.0, zero_raw=0.1, raw_unit="mV/V").apply([0.1, 2.1])
    array([  0., 500.])
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    scale: float = 1.0
    offset: float = 0.0
    zero_raw: float = 0.0
    polynomial: tuple[float, ...] | None = Field(default=None, min_length=1, max_length=8)
    raw_unit: str = ""
    rel_std: float = Field(default=0.0, ge=0, le=1)
    source: str = ""

    @model_validator(mode="after")
    def _one_kind(self) -> Calibration:
        if self.scale == 0.0:
            raise ValueError("scale must not be 0: every reading would become the offset")
        if self.polynomial is not None and (self.scale != 1.0 or self.offset != 0.0):
            raise ValueError("give either polynomial, or scale and offset, not both")
        return self

    def apply(self, raw: Any) -> NDArray[np.float64]:
        """Return calibrated values.

        Parameters
        ----------
        raw : array_like, shape (n,), in `raw_unit`

        Returns
        -------
        ndarray, shape (n,), in the channel's unit
        """
        x = np.asarray(raw, dtype=np.float64) - self.zero_raw
        if self.polynomial is not None:
            return np.asarray(np.polynomial.polynomial.polyval(x, np.array(self.polynomial)), dtype=np.float64)
        return np.asarray(self.offset + self.scale * x, dtype=np.float64)

    def slope_at(self, raw: float) -> float:
        """Change of the value with the raw reading at `raw`, channel unit per raw unit.

        Examples
        --------
        >>> Calibration(polynomial=(0.0, 2.0, 3.0), zero_raw=1.0).slope_at(2.0)
        8.0
        """
        if self.polynomial is None:
            return self.scale
        derivative = np.polynomial.polynomial.polyder(self.polynomial)
        return float(np.polynomial.polynomial.polyval(raw - self.zero_raw, derivative))

    def is_same_formula(self, other: Calibration) -> bool:
        """Whether both turn every raw reading into the same value; who says so may differ."""
        ignored = {"rel_std", "source"}
        return self.model_dump(exclude=ignored) == other.model_dump(exclude=ignored)

    def statement(self, channel: str, unit: str) -> str:
        """Say the calibration in words, for the recording."""
        zero = f"(raw - {self.zero_raw:g})" if self.zero_raw else "raw"
        if self.polynomial is not None:
            formula = " + ".join(f"{c:g} {zero}^{k}" for k, c in enumerate(self.polynomial))
        else:
            formula = f"{self.scale:g} {zero}" + (f" {self.offset:+g}" if self.offset else "")
        said = f"{channel} [{unit}] = {formula}, raw in {self.raw_unit or 'the unit the instrument sends'}"
        spread = f"; relative standard uncertainty {self.rel_std:g}" if self.rel_std else ""
        return f"{said}{spread}; source: {self.source or 'not stated'}"
