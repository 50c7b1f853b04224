"""Fit batteries to measured discharges, and predict how long another discharge lasts.

    eq16:            V = V_nom s / (1 - beta (1 - s)),  s = 1 - q / Q, Q the charge the stated cell holds
    eq16_free:       the same with Q fitted
    eq16_free_r:     the same with Q fitted and - R i
    ocv_r:           V = E(q) - R i, E a table of the slowest discharge freed of its own drop

Assumptions: no temperature (a cell that heats itself at a high rate has less resistance than these fits say),
no relaxation: at constant current an RC pair has settled and is part of R. Source: Eq. 16 of the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sawbench.bench.errors import InputError
from sawbench.modeling.parts.eq16 import voltage

Floats = NDArray[np.float64]
BatteryModel = Literal["eq16", "eq16_free", "eq16_free_r", "ocv_r"]
PredictionStatus = Literal["ok", "never_reached", "below_at_start"]
_A_S_PER_AH: Final = 3600.0
_TABLE_POINTS: Final = 201


@dataclass(frozen=True, kw_only=True, slots=True)
class MeasuredDischarge:
    """One discharge from full charge.

    Attributes
    ----------
    time_s, current_a, voltage_v : ndarray, shape (n,)
        Current positive when the battery delivers.
    label : str

    Examples
    --------
    >>> discharge = MeasuredDischarge(time_s=[0, 3600], current_a=[2, 2], voltage_v=[4.0, 3.0], label="cell")
    >>> discharge.charge_a_s.tolist(), discharge.mean_current_a
    ([0.0, 7200.0], 2.0)
    """

    time_s: Floats
    current_a: Floats
    voltage_v: Floats
    label: str = "discharge"

    def __post_init__(self) -> None:
        for name in ("time_s", "current_a", "voltage_v"):
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.ndim != 1 or len(array) < 2 or array.shape != np.shape(self.time_s):
                raise InputError(f"{name} has shape {array.shape}, expected two values or more", where=self.label)
            if not np.isfinite(array).all():
                raise InputError(f"{name} holds values that are not finite", where=self.label)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if np.diff(self.time_s).min() < 0:
            raise InputError("time_s decreases", where=self.label)
        if not self.charge_a_s[-1] > 0:
            raise InputError(
                "delivers no charge",
                where=self.label,
                remedy="give the current positive when the battery delivers",
            )

    @property
    def charge_a_s(self) -> Floats:
        """Charge delivered until each sample, A*s, shape (n,)."""
        mean_a = 0.5 * (self.current_a[1:] + self.current_a[:-1])
        return np.concatenate([[0.0], np.cumsum(np.diff(self.time_s) * mean_a)])

    @property
    def duration_s(self) -> float:
        """From the first to the last sample, s."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def mean_current_a(self) -> float:
        """Charge over duration, A."""
        return float(self.charge_a_s[-1] / self.duration_s)


@dataclass(frozen=True, kw_only=True, slots=True)
class BatteryFit:
    """A battery that was fitted.

    Attributes
    ----------
    model : str
        One of `BatteryModel`.
    nominal_voltage_v, beta : float or None
        Of Eq. 16; None for a table.
    capacity_ah : float
        The charge that shapes the curve, Ah.
    internal_resistance_ohm : float
    rmse_v : float
        Over the samples it was fitted to, V.
    rmse_by_discharge_v : tuple of float
    table_charge_a_s, table_voltage_v : ndarray or None
        Open-circuit voltage over the charge taken.
    note : str
    """

    model: BatteryModel
    nominal_voltage_v: float | None
    beta: float | None
    capacity_ah: float
    internal_resistance_ohm: float
    rmse_v: float
    rmse_by_discharge_v: tuple[float, ...]
    table_charge_a_s: Floats | None = None
    table_voltage_v: Floats | None = None
    note: str = ""

    def voltage_v(self, charge_a_s: ArrayLike, current_a: ArrayLike) -> Floats:
        """Terminal voltage after `charge_a_s` was taken, at `current_a`, V."""
        charge, current = np.asarray(charge_a_s, float), np.asarray(current_a, float)
        drop_v = self.internal_resistance_ohm * current
        if self.table_charge_a_s is not None and self.table_voltage_v is not None:
            return np.interp(charge, self.table_charge_a_s, self.table_voltage_v, right=0.0) - drop_v
        assert self.nominal_voltage_v is not None and self.beta is not None
        return _eq16(charge, self.nominal_voltage_v, self.beta, self.capacity_ah * _A_S_PER_AH) - drop_v


def _eq16(charge_a_s: Floats, nominal_voltage_v: float, beta: float, capacity_a_s: float) -> Floats:
    return voltage.py_func(nominal_voltage_v, beta, np.minimum(1.0 - charge_a_s / capacity_a_s, 1.0))[0]


def fit_battery(
    discharges: Sequence[MeasuredDischarge],
    *,
    model: BatteryModel = "eq16_free",
    stated_capacity_ah: float | None = None,
) -> BatteryFit:
    """Least squares over all samples, every discharge counting the same whatever its number of samples.

    Samples count as they were logged; a tester that logs steps of voltage puts weight on the knee, which
    decides the end of a discharge.

    Parameters
    ----------
    discharges : sequence of MeasuredDischarge
        From full charge. Telling the resistance needs two currents at least.
    model : {"eq16", "eq16_free", "eq16_free_r", "ocv_r"}
    stated_capacity_ah : float, optional
        Capacity for "eq16"; the largest charge delivered if not given.

    Returns
    -------
    BatteryFit

    Raises
    ------
    InputError
        If there is no discharge, the model is unknown, or one current cannot tell the resistance.

    Examples
    --------
    >>> import numpy as np
    >>> charge = np.linspace(0.0, 5000.0, 400)
    >>> voltage = 4.0 * (1 - charge / 5400) / (1 - 0.9 * charge / 5400)
    >>> cell = MeasuredDischarge(time_s=charge / 2.0, current_a=np.full(400, 2.0), voltage_v=voltage)
    >>> fit = fit_battery([cell])
    >>> round(fit.capacity_ah, 4), round(fit.beta, 4), fit.rmse_v < 1e-6
    (1.5, 0.9, True)
    """
    if not discharges:
        raise InputError("there is no discharge to fit")
    if model not in get_args(BatteryModel):
        raise InputError(f"unknown battery model {model!r}", remedy=f"one of {', '.join(get_args(BatteryModel))}")
    if model in ("eq16_free_r", "ocv_r"):
        currents = [discharge.mean_current_a for discharge in discharges]
        if max(currents) < 1.2 * min(currents):
            raise InputError(
                f"model {model} needs discharges at two different currents, got {min(currents):.4g} to "
                f"{max(currents):.4g} A",
                remedy="add a slower or faster discharge, or use model eq16_free",
            )
    if model == "ocv_r":
        return _fit_table(discharges)
    return _fit_eq16(discharges, model, stated_capacity_ah)


def _fit_eq16(
    discharges: Sequence[MeasuredDischarge], model: BatteryModel, stated_capacity_ah: float | None
) -> BatteryFit:
    from scipy.optimize import least_squares

    most_ah = max(d.charge_a_s[-1] for d in discharges) / _A_S_PER_AH
    stated_ah = most_ah if stated_capacity_ah is None else stated_capacity_ah
    if not stated_ah > 0:
        raise InputError(f"stated_capacity_ah is {stated_ah!r}, allowed is a number above 0")
    charges = [d.charge_a_s for d in discharges]
    highest_v = max(float(d.voltage_v.max()) for d in discharges)

    def unpack(x: Floats) -> tuple[float, float, float, float]:
        capacity_ah = stated_ah if model == "eq16" else x[2]
        return x[0], x[1], capacity_ah * _A_S_PER_AH, x[3] if model == "eq16_free_r" else 0.0

    def residuals(x: Floats) -> Floats:
        voltage_v, beta, capacity_a_s, resistance_ohm = unpack(x)
        parts = [
            (_eq16(q, voltage_v, beta, capacity_a_s) - resistance_ohm * d.current_a - d.voltage_v) / np.sqrt(len(q))
            for q, d in zip(charges, discharges, strict=True)
        ]
        return np.concatenate(parts)

    found = least_squares(
        residuals,
        [highest_v, 0.9, 1.1 * most_ah, 0.01 * highest_v / max(d.mean_current_a for d in discharges)],
        bounds=([0.0, 0.0, most_ah, 0.0], [3.0 * highest_v, 1.0 - 1e-9, 5.0 * most_ah, np.inf]),
        x_scale=[highest_v, 0.1, most_ah, 0.01],
        xtol=1e-12,
        ftol=1e-12,
    )
    voltage_v, beta, capacity_a_s, resistance_ohm = unpack(found.x)
    ends = np.cumsum([len(q) for q in charges])[:-1]
    by_discharge = tuple(float(np.sqrt(np.sum(part**2))) for part in np.split(found.fun, ends))
    note = "" if model == "eq16_free_r" else "the resistance is part of V_nom: it holds near the fitted currents"
    return BatteryFit(
        model=model,
        nominal_voltage_v=float(voltage_v),
        beta=float(beta),
        capacity_ah=float(capacity_a_s) / _A_S_PER_AH,
        internal_resistance_ohm=float(resistance_ohm),
        rmse_v=float(np.sqrt(np.mean(np.square(by_discharge)))),
        rmse_by_discharge_v=by_discharge,
        note=note,
    )


def _fit_table(discharges: Sequence[MeasuredDischarge]) -> BatteryFit:
    """Resistance from the distance between the discharges, the table from the slowest of them."""
    slowest = min(discharges, key=lambda d: d.mean_current_a)
    slow_charge = slowest.charge_a_s
    numerator = denominator = 0.0
    for discharge in discharges:
        if discharge is slowest:
            continue
        end = 0.9 * min(discharge.charge_a_s[-1], slow_charge[-1])
        grid = np.linspace(0.05 * end, end, _TABLE_POINTS)
        drop_v = np.interp(grid, slow_charge, slowest.voltage_v) - np.interp(
            grid, discharge.charge_a_s, discharge.voltage_v
        )
        extra_a = discharge.mean_current_a - slowest.mean_current_a
        numerator += extra_a * float(drop_v.mean())
        denominator += extra_a**2
    resistance_ohm = max(numerator / denominator, 0.0)
    table_charge = np.linspace(0.0, slow_charge[-1], 5 * _TABLE_POINTS)
    open_v = slowest.voltage_v + resistance_ohm * slowest.current_a
    table_v = np.interp(table_charge, slow_charge, open_v)
    by_discharge = tuple(
        float(
            np.sqrt(
                np.mean(
                    (
                        np.interp(d.charge_a_s, table_charge, table_v, right=0.0)
                        - resistance_ohm * d.current_a
                        - d.voltage_v
                    )
                    ** 2
                )
            )
        )
        for d in discharges
    )
    return BatteryFit(
        model="ocv_r",
        nominal_voltage_v=None,
        beta=None,
        capacity_ah=float(slow_charge[-1]) / _A_S_PER_AH,
        internal_resistance_ohm=float(resistance_ohm),
        rmse_v=float(np.sqrt(np.mean(np.square(by_discharge)))),
        rmse_by_discharge_v=by_discharge,
        table_charge_a_s=table_charge,
        table_voltage_v=table_v,
        note="no charge is known beyond the end of the slowest discharge",
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class DischargeTime:
    """How long a battery lasts at constant current.

    Attributes
    ----------
    duration_s : float
        0 where the voltage is below the cut-off from the start.
    delivered_ah : float
    status : {"ok", "never_reached", "below_at_start"}
        "never_reached": the charge ends before the voltage falls to the cut-off; the duration is then the
        charge's.
    """

    duration_s: float
    delivered_ah: float
    status: PredictionStatus


def predict_discharge(fit: BatteryFit, *, current_a: float, cutoff_voltage_v: float) -> DischargeTime:
    """Time until the terminal voltage falls to the cut-off at constant current.

    Parameters
    ----------
    fit : BatteryFit
    current_a : float
        Positive when the battery delivers, A.
    cutoff_voltage_v : float

    Returns
    -------
    DischargeTime

    Raises
    ------
    InputError
        For a current or cut-off that is not a number above 0.
    """
    for name, value in (("current_a", current_a), ("cutoff_voltage_v", cutoff_voltage_v)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value!r}, allowed is a number above 0")
    charge = np.linspace(0.0, fit.capacity_ah * _A_S_PER_AH, 100_001)
    voltage_v = fit.voltage_v(charge, current_a)
    is_below = voltage_v <= cutoff_voltage_v
    status: PredictionStatus = "ok"
    if is_below[0]:
        status, taken = "below_at_start", 0.0
    elif not is_below.any():
        status, taken = "never_reached", float(charge[-1])
    else:
        k = int(np.argmax(is_below))
        share = (voltage_v[k - 1] - cutoff_voltage_v) / (voltage_v[k - 1] - voltage_v[k])
        taken = float(charge[k - 1] + share * (charge[k] - charge[k - 1]))
    return DischargeTime(duration_s=taken / current_a, delivered_ah=taken / _A_S_PER_AH, status=status)
