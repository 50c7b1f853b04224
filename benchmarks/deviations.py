"""How far a model's curve is from the real one: Equations 14 to 18 and the panels of Fig. 12."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sawbench.bench.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class Deviations:
    """Deviation of a linear-model curve from the real one, in the unit of the curves.

    Attributes
    ----------
    unit : str
    time_s : ndarray, shape (n,), s
    deviation, absolute : ndarray, shape (n,)
        real - linear (Eq. 17, first line) and its magnitude.
    relative : ndarray, shape (n,)
        (real - linear) / real, a fraction (Eq. 17, third line); 0 where `is_relative_valid` is false.
    is_relative_valid : ndarray of bool, shape (n,)
        False where |real| is too small to divide by.
    rmse : float
        Root mean square of the deviation.
    ise : float
        Sum of the squared deviations (Eq. 15), unit squared.
    ise_integral : float
        Eq. 14 by the trapezoidal rule, unit squared times second.
    peak_real, peak_linear : float
        Largest values of the two curves.
    max_absolute : float
    frequency_hz : ndarray, shape (m,), Hz
    amplitude_real, amplitude_linear : ndarray, shape (m,)
        Single-sided amplitude spectra (Fig. 12f); the mean stands at 0 Hz.
    """

    unit: str
    time_s: Floats
    deviation: Floats
    absolute: Floats
    relative: Floats
    is_relative_valid: NDArray[np.bool_]
    rmse: float
    ise: float
    ise_integral: float
    peak_real: float
    peak_linear: float
    max_absolute: float
    frequency_hz: Floats
    amplitude_real: Floats
    amplitude_linear: Floats

    @property
    def relative_percent(self) -> Floats:
        """Relative deviation in percent (Eq. 17, fourth line)."""
        return 100.0 * self.relative


def deviations(
    time_s: ArrayLike, real: ArrayLike, linear: ArrayLike, *, unit: str, smallest_divisor: float = 1e-3
) -> Deviations:
    """Compare a real curve with the linear model's, both on one equally spaced time axis.

    Parameters
    ----------
    time_s : array_like, shape (n,), s
        Equally spaced, at least two samples.
    real, linear : array_like, shape (n,)
        Motor current (Eq. 17) or cutting force (Eq. 18).
    unit : str
        Unit of both curves.
    smallest_divisor : float
        Relative deviations are stated where |real| exceeds this share of the largest |real|. On the return
        stroke the force is zero, so Eq. 18 has no relative deviation there.

    Returns
    -------
    Deviations

    Raises
    ------
    InputError
        If the curves differ in length, hold values that are not finite, or the times are not equally spaced.

    Examples
    --------
    >>> result = deviations([0.0, 0.5, 1.0, 1.5], [2.0, 4.0, 2.0, 4.0], [1.0, 4.0, 2.0, 5.0], unit="A")
    >>> result.ise, result.rmse, result.relative_percent.tolist()
    (2.0, 0.7071067811865476, [50.0, 0.0, 0.0, -25.0])
    """
    time, true, model = (np.array(values, dtype=np.float64) for values in (time_s, real, linear))
    for name, values in (("time_s", time), ("real", true), ("linear", model)):
        if values.ndim != 1 or values.shape != time.shape or len(values) < 2:
            raise InputError(f"{name} has shape {values.shape}, expected ({len(time)},) with two values or more")
        if not np.isfinite(values).all():
            raise InputError(f"{name} holds values that are not finite")
    step_s = np.diff(time)
    if step_s.min() <= 0 or np.ptp(step_s) > 1e-6 * step_s.mean():
        raise InputError("time_s must be equally spaced and increasing", remedy="resample both curves first")
    difference = true - model
    is_valid = np.abs(true) > smallest_divisor * np.abs(true).max()
    frequency_hz, amplitude_real = amplitude_spectrum(true, rate_hz=1.0 / float(step_s.mean()))
    _, amplitude_linear = amplitude_spectrum(model, rate_hz=1.0 / float(step_s.mean()))
    return Deviations(
        unit=unit,
        time_s=time,
        deviation=difference,
        absolute=np.abs(difference),
        relative=np.divide(difference, true, out=np.zeros_like(true), where=is_valid),
        is_relative_valid=is_valid,
        rmse=float(np.sqrt(np.mean(difference**2))),
        ise=float(np.sum(difference**2)),
        ise_integral=float(np.trapezoid(difference**2, time)),
        peak_real=float(true.max()),
        peak_linear=float(model.max()),
        max_absolute=float(np.abs(difference).max()),
        frequency_hz=frequency_hz,
        amplitude_real=amplitude_real,
        amplitude_linear=amplitude_linear,
    )


def amplitude_spectrum(values: ArrayLike, *, rate_hz: float) -> tuple[Floats, Floats]:
    """Single-sided amplitude spectrum: a sine of amplitude A on a line of the transform shows as A.

    Parameters
    ----------
    values : array_like, shape (n,)
    rate_hz : float

    Returns
    -------
    frequency_hz, amplitude : ndarray, shape (n // 2 + 1,)

    Examples
    --------
    >>> import numpy as np
    >>> frequency_hz, amplitude = amplitude_spectrum(1 + 3 * np.sin(np.pi * np.arange(8) / 2), rate_hz=8.0)
    >>> frequency_hz[2], [round(float(value), 12) for value in amplitude[:3]]
    (np.float64(2.0), [1.0, 0.0, 3.0])
    """
    array = np.asarray(values, dtype=np.float64)
    amplitude: Floats = 2.0 * np.abs(np.fft.rfft(array)) / len(array)
    amplitude[0] /= 2.0
    if len(array) % 2 == 0:
        amplitude[-1] /= 2.0
    frequency_hz: Floats = np.arange(len(amplitude), dtype=np.float64) * (rate_hz / len(array))
    return frequency_hz, amplitude
