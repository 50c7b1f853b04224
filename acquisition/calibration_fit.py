"""Known loads and what the instrument sent -> gain and offset with their covariance, nonlinearity, hysteresis."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.calibration import Calibration
from sawbench.bench.correlated import student_factor
from sawbench.bench.errors import InputError, UntrustedResult
from sawbench.storage.output import write_whole

Floats = NDArray[np.float64]
_MIN_LOADS: Final = 3
_MAX_ITERATIONS: Final = 100
_SAME: Final = 1e-9
_LARGEST_GAIN_CHANGE: Final = 0.2
_LARGEST_GAIN_REL_STD: Final = 0.1
_COLUMNS: Final = ("reference", "raw", "raw_std", "reference_std")


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrationPoint:
    """One known load.

    Attributes
    ----------
    reference : float
        Known value, in the channel's unit.
    raw : float
        Mean reading, in the raw unit.
    raw_std, reference_std : float
        Standard uncertainties, independent from point to point; 0 where not known.
    """

    reference: float
    raw: float
    raw_std: float = 0.0
    reference_std: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class StraightLine:
    """value = offset + gain * raw.

    Attributes
    ----------
    gain, offset : float
        Channel unit per raw unit; channel unit.
    gain_std, offset_std, covariance : float
        Standard uncertainties from the points, and the covariance of the two.
    gain_rel_std : float
        With the common relative uncertainty of the references, which every point shares.
    residuals : ndarray, shape (n,), channel unit
        Known minus fitted.
    chi2_per_degree : float or None
        Scatter over the stated uncertainties; None where none were stated. Above 1 the uncertainties are widened by
        its root.
    nonlinearity : float
        Largest mean deviation from the line at any load, share of the range of loads.
    hysteresis : float or None
        Largest difference between loading and unloading at the same load, share of the range; None where no load
        was taken in both directions.
    """

    gain: float
    offset: float
    gain_std: float
    offset_std: float
    covariance: float
    gain_rel_std: float
    residuals: Floats
    chi2_per_degree: float | None
    nonlinearity: float
    hysteresis: float | None

    @property
    def zero_raw(self) -> float:
        """Raw reading without a load."""
        return -self.offset / self.gain

    @property
    def zero_std_raw(self) -> float:
        """Standard uncertainty of `zero_raw`, covariance included."""
        zero = self.zero_raw
        variance = self.offset_std**2 + 2.0 * zero * self.covariance + (zero * self.gain_std) ** 2
        return float(np.sqrt(max(variance, 0.0))) / abs(self.gain)


def fit_line(points: Sequence[CalibrationPoint], *, common_rel_std: float = 0.0) -> StraightLine:
    """Fit the straight line with errors in both variables.

    Parameters
    ----------
    points : sequence of CalibrationPoint
        In the order they were taken: that tells loading from unloading.
    common_rel_std : float
        Relative standard uncertainty that all references share (the set of weights, gravity).

    Raises
    ------
    InputError
        If the points cannot tell a line: fewer than three loads, the same load twice in a row, all readings equal,
        readings that do not follow the loads.

    Notes
    -----
    Weighted total least squares, iterated on the weights 1 / (u_reference**2 + gain**2 u_raw**2), with the covariance
    of York, Evensen, Martinez, Delgado 2004, "Unified equations for the slope, intercept, and standard errors of the
    best straight line", Am. J. Phys. 72, 367, eqs. 13a to 13d, r = 0. Where no uncertainty is stated the points weigh
    the same and the covariance comes from their scatter, widened by `student_factor` at n - 2 degrees of freedom.
    Bias: none to first order in the uncertainties. Fails: curvature is not fitted, only stated as `nonlinearity`.

    Examples
    --------
    >>> line = fit_line([CalibrationPoint(reference=f, raw=0.1 + f / 250.0) for f in (0.0, 100.0, 200.0)])
    >>> round(line.gain, 6), round(line.zero_raw, 6)
    (250.0, 0.1)
    """
    _refuse_nonsense(points)
    x = np.array([p.raw for p in points])
    y = np.array([p.reference for p in points])
    ux = np.array([p.raw_std for p in points])
    uy = np.array([p.reference_std for p in points])
    is_stated = bool(np.all((ux > 0) | (uy > 0)))
    if not is_stated:
        ux, uy = np.zeros(len(x)), np.ones(len(x))
    gain, offset, weights, adjusted = _york(x, y, ux, uy)
    residuals = y - offset - gain * x
    chi2 = float(weights @ residuals**2) / (len(points) - 2)
    mean = float(weights @ adjusted / weights.sum())
    gain_variance = 1.0 / float(weights @ (adjusted - mean) ** 2)
    widening = max(1.0, chi2) if is_stated else chi2 * student_factor(len(points) - 2) ** 2
    gain_variance *= widening
    offset_variance = widening / float(weights.sum()) + mean**2 * gain_variance
    span = float(np.ptp(y))
    return StraightLine(
        gain=gain,
        offset=offset,
        gain_std=gain_variance**0.5,
        offset_std=offset_variance**0.5,
        covariance=-mean * gain_variance,
        gain_rel_std=float(np.hypot(gain_variance**0.5 / abs(gain), common_rel_std)),
        residuals=residuals,
        chi2_per_degree=chi2 if is_stated else None,
        nonlinearity=_nonlinearity(y, residuals) / span,
        hysteresis=_hysteresis(y, residuals, span),
    )


def judge_line(line: StraightLine, former: Calibration, *, largest_deviation: float) -> list[str]:
    """Say what speaks against a fit; empty where nothing does.

    Parameters
    ----------
    line : StraightLine
    former : Calibration
        What was in force before; a polynomial is compared by its slope at the zero.
    largest_deviation : float
        Of nonlinearity and hysteresis, share of the range.
    """
    said = []
    former_gain = former.slope_at(former.zero_raw)
    if line.gain_rel_std > _LARGEST_GAIN_REL_STD:
        said.append(f"the reading depends too weakly on the load: the gain is only known to {line.gain_rel_std:.0%}")
    elif line.gain * former_gain < 0:
        said.append(
            f"the gain is {line.gain:.6g}, the previous one {former_gain:.6g}: the sign has changed (sensor or wires"
            " swapped, "
            "or loads pushed instead of pulled)"
        )
    elif former_gain and abs(line.gain / former_gain - 1.0) > _LARGEST_GAIN_CHANGE:
        said.append(
            f"the gain is {line.gain:.6g}, {line.gain / former_gain:.3g} times the previous one (a factor of 9.8 or"
            " 0.10 "
            "means that kilograms were entered as newtons)"
        )
    if line.nonlinearity > largest_deviation:
        said.append(f"the points deviate from a straight line by up to {line.nonlinearity:.2%} of the range")
    if line.hysteresis is not None and line.hysteresis > largest_deviation:
        said.append(f"loading and unloading differ by up to {line.hysteresis:.2%} of the range")
    return said


def require_gain(line: StraightLine, *, where: str) -> None:
    """Raise where not even the sign of the gain is known: no reading means anything then, so nothing can be stored.

    Raises
    ------
    UntrustedResult
    """
    if line.gain_rel_std > 1.0:
        raise UntrustedResult(
            f"the calibration was not stored: the gain is only known to {line.gain_rel_std:.0%}, not even its sign",
            where=where,
            remedy="check that the loads act on the sensor of this channel, and that each reading belongs to its load",
        )


def require_sound(complaints: Sequence[str], *, where: str, force: bool) -> None:
    """Raise where something speaks against a fit and `force` is not set.

    Raises
    ------
    UntrustedResult
    """
    if complaints and not force:
        raise UntrustedResult(
            "the calibration was not stored: " + "; ".join(complaints),
            where=where,
            remedy="check the loads and repeat it, or store it with --force",
        )


def read_points(path: Path) -> tuple[CalibrationPoint, ...]:
    """Read a table of points: columns `reference,raw` and, where known, `raw_std,reference_std`.

    Parameters
    ----------
    path : Path
        CSV with a header; rows in the order they were taken.

    Raises
    ------
    InputError
        If it is missing, has other columns, or holds what is not a number; names the line.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            columns = [name.strip() for name in reader.fieldnames or []]
            reader.fieldnames = columns
            rows = [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read: {error}", where=path) from error
    missing, unknown = set(_COLUMNS[:2]) - set(columns), set(columns) - set(_COLUMNS)
    if missing or unknown:
        raise InputError(
            f"columns are {', '.join(columns) or 'none'}",
            where=path,
            remedy="name them reference,raw and, where known, raw_std,reference_std",
        )
    return tuple(_point(row, f"{path} line {number}") for number, row in rows)


def write_points(path: Path, points: Sequence[CalibrationPoint]) -> None:
    """Write a table that `read_points` reads back as it is."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(_COLUMNS)
    writer.writerows([repr(float(getattr(point, name))) for name in _COLUMNS] for point in points)
    write_whole(path, text.getvalue())


def _point(row: dict[str, str | None], where: str) -> CalibrationPoint:
    values = {}
    for name in _COLUMNS:
        text = (row.get(name) or "").strip()
        if not text and name.endswith("_std"):
            continue
        try:
            values[name] = float(text)
        except ValueError:
            values[name] = float("nan")
        if not np.isfinite(values[name]) or (name.endswith("_std") and values[name] < 0):
            raise InputError(f"{name} is {text!r}, expected a number", where=where)
    return CalibrationPoint(**values)


def require_loads(references: Sequence[float]) -> None:
    """Refuse known loads that cannot tell a line, whatever is read at them.

    Parameters
    ----------
    references : sequence of float
        In the order they are taken.

    Raises
    ------
    InputError
        If one is not a finite number, there are fewer than three different loads, or the same one twice in a row.
    """
    for reference in references:
        if not np.isfinite(reference):
            raise InputError(f"the load {reference:g} is not a finite number", remedy="give the load as a number")
    span = max(references) - min(references) if references else 0.0
    n_loads = len({round(r / (span or 1.0), 9) for r in references})
    if n_loads < _MIN_LOADS:
        raise InputError(
            f"{len(references)} points at {n_loads} different loads are too few for a calibration, "
            f"{_MIN_LOADS} are needed",
            remedy="measure zero, the largest load, and at least one between",
        )
    for before, after in pairwise(references):
        if abs(after - before) <= _SAME * span:
            raise InputError(
                f"the load {after:g} appears twice in a row, which adds no information",
                remedy="with loading and unloading, measure the largest load once; otherwise change the load in"
                " between",
            )


def _refuse_nonsense(points: Sequence[CalibrationPoint]) -> None:
    require_loads([p.reference for p in points])
    remedy = "check that the loads act on the sensor of this channel"
    if float(np.ptp([p.raw for p in points])) == 0.0:
        raise InputError("the reading was the same at every load", remedy=remedy)
    raw, references = (values - values.mean() for values in np.array([[p.raw, p.reference] for p in points]).T)
    if abs(raw @ references) <= _SAME * np.linalg.norm(raw) * np.linalg.norm(references):
        raise InputError("the readings do not follow the loads, neither rising nor falling with them", remedy=remedy)


def _york(x: Floats, y: Floats, ux: Floats, uy: Floats) -> tuple[float, float, Floats, Floats]:
    gain = float(np.polyfit(x, y, 1)[0])
    weights = adjusted = np.ones_like(x)
    for _ in range(_MAX_ITERATIONS):
        weights = 1.0 / (uy**2 + gain**2 * ux**2)
        dx = x - weights @ x / weights.sum()
        dy = y - weights @ y / weights.sum()
        beta = weights * (dx * uy**2 + gain * dy * ux**2)
        before, gain = gain, float((weights * beta) @ dy / ((weights * beta) @ dx))
        adjusted = weights @ x / weights.sum() + beta
        if abs(gain - before) <= 1e-14 * abs(gain):
            break
    offset = float(weights @ (y - gain * x) / weights.sum())
    return gain, offset, weights, adjusted


def _nonlinearity(references: Floats, residuals: Floats) -> float:
    _, which = np.unique(references, return_inverse=True)
    return float(max(abs(residuals[which == k].mean()) for k in range(which.max() + 1)))


def _hysteresis(references: Floats, residuals: Floats, span: float) -> float | None:
    """Largest difference of the same load reached from below and from above, share of the span."""
    step = np.diff(references)
    # The first point is reached from where the second one leads away.
    from_below = np.concatenate(([step[0] > 0], step > 0))
    found = []
    for load in np.unique(references):
        here = np.abs(references - load) <= _SAME * span
        up, down = residuals[here & from_below], residuals[here & ~from_below]
        if len(up) and len(down):
            found.append(abs(float(up.mean() - down.mean())) / span)
    return max(found) if found else None
