"""Fit batteries to measured discharges.

    eq16:            V = V_nom s / (1 - beta (1 - s)),  s = 1 - q / Q, Q the largest charge delivered
    eq16_free:       the same with Q fitted
    eq16_free_r:     the same with Q fitted and - R i
    eq16_end:        as eq16_free, fitted to the ends of the discharges beside their curves
    eq16_end_r:      as eq16_free_r, fitted to the ends too
    ocv_r:           V = E(q) - R i, E a table of the slowest discharge freed of its own drop; it ends with it

Assumptions: no temperature (a cell that heats itself at a high rate has less resistance than these fits say),
no relaxation: at constant current an RC pair has settled and is part of R. Without a resistance it hides in V_nom,
which then holds near the fitted currents. Source: Eq. 16 of the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sawbench.bench.errors import InputError
from sawbench.modeling.measured_discharge import MeasuredDischarge
from sawbench.modeling.parts.eq16 import voltage

Floats = NDArray[np.float64]
BatteryModel = Literal["eq16", "eq16_free", "eq16_free_r", "eq16_end", "eq16_end_r", "ocv_r"]
_A_S_PER_AH: Final = 3600.0
_TABLE_POINTS: Final = 201
_NEED_TWO_CURRENTS: Final = ("eq16_free_r", "eq16_end_r", "ocv_r")
# Where the ends count: a curve may miss by this share of the voltage where an end may miss by that share of the charge.
_CURVE_SHARE, _END_SHARE, _CURVE_POINTS = 0.02, 0.005, 200


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
        Over the samples as they were logged, every discharge counting the same, V. The fit counts equal steps of
        charge: a part of the curve that is logged more often counts more here than there.
    table_charge_a_s, table_voltage_v : ndarray or None
        Open-circuit voltage over the charge taken.
    """

    model: BatteryModel
    nominal_voltage_v: float | None
    beta: float | None
    capacity_ah: float
    internal_resistance_ohm: float
    rmse_v: float
    table_charge_a_s: Floats | None = None
    table_voltage_v: Floats | None = None

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
) -> BatteryFit:
    """Least squares, every discharge counting the same whatever its number of samples.

    The curve counts at equal steps of charge, however the tester logs. The models `eq16_end` and `eq16_end_r` take the
    charge at the last voltage of every discharge as a measurement of its own: the curve alone gives the end, a steep
    and short part of it, too little weight to get the runtime right.

    Parameters
    ----------
    discharges : sequence of MeasuredDischarge
        From full charge. Telling the resistance needs two currents at least.
    model : {"eq16", "eq16_free", "eq16_free_r", "eq16_end", "eq16_end_r", "ocv_r"}
        "eq16" takes the largest charge delivered for its own.

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
    >>> round(fit.capacity_ah, 4), round(fit.beta, 4), fit.rmse_v < 1e-4
    (1.5, 0.9, True)
    """
    if not discharges:
        raise InputError("there is no discharge to fit")
    if model not in get_args(BatteryModel):
        raise InputError(f"unknown battery model {model!r}", remedy=f"one of {', '.join(get_args(BatteryModel))}")
    if model in _NEED_TWO_CURRENTS:
        currents = [discharge.mean_current_a for discharge in discharges]
        if max(currents) < 1.2 * min(currents):
            raise InputError(
                f"model {model} needs discharges at two different currents, got {min(currents):.4g} to "
                f"{max(currents):.4g} A",
                remedy="add a slower or faster discharge, or use model eq16_free",
            )
    if model == "ocv_r":
        return _fit_table(discharges)
    return _fit_eq16(discharges, model)


def _fit_eq16(discharges: Sequence[MeasuredDischarge], model: BatteryModel) -> BatteryFit:
    from scipy.optimize import least_squares

    most_ah = max(d.charge_a_s[-1] for d in discharges) / _A_S_PER_AH
    counts_ends, has_resistance = model.startswith("eq16_end"), model.endswith("_r")
    curves = [_even_curve(d) for d in discharges]
    highest_v = max(float(d.voltage_v.max()) for d in discharges)

    start_ohm = 0.01 * highest_v / max(d.mean_current_a for d in discharges)
    # Start, lower and upper bound, scale of V_nom, beta, Q in Ah and R.
    rows = np.array(
        [
            [highest_v, 0.0, 3.0 * highest_v, highest_v],
            [0.9, 0.0, 1.0 - 1e-9, 0.1],
            [1.1 * most_ah, most_ah, 5.0 * most_ah, most_ah],
            [start_ohm, 0.0, np.inf, start_ohm],
        ]
    )
    is_free = np.array([True, True, model != "eq16", has_resistance])

    def unpack(x: Floats) -> tuple[float, float, float, float]:
        full = np.array([0.0, 0.0, most_ah, 0.0])
        full[is_free] = x
        return full[0], full[1], full[2] * _A_S_PER_AH, full[3]

    def residuals(x: Floats) -> Floats:
        voltage_v, beta, capacity_a_s, resistance_ohm = unpack(x)
        scale_v = _CURVE_SHARE * highest_v * np.sqrt(_CURVE_POINTS)
        parts = [(_eq16(q, voltage_v, beta, capacity_a_s) - resistance_ohm * i - v) / scale_v for q, i, v in curves]
        if counts_ends:
            ends = [_end_charge(d, *unpack(x)) / d.charge_a_s[-1] - 1.0 for d in discharges]
            parts.append(np.array(ends) / _END_SHARE)
        return np.concatenate(parts)

    start, low, high, scale = rows[is_free].T
    found = least_squares(residuals, start, bounds=(low, high), x_scale=scale, xtol=1e-10, ftol=1e-10)
    voltage_v, beta, capacity_a_s, resistance_ohm = unpack(found.x)
    by_discharge = tuple(
        _rms(_eq16(d.charge_a_s, voltage_v, beta, capacity_a_s) - resistance_ohm * d.current_a - d.voltage_v)
        for d in discharges
    )
    return BatteryFit(
        model=model,
        nominal_voltage_v=float(voltage_v),
        beta=float(beta),
        capacity_ah=float(capacity_a_s) / _A_S_PER_AH,
        internal_resistance_ohm=float(resistance_ohm),
        rmse_v=float(np.sqrt(np.mean(np.square(by_discharge)))),
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _even_curve(discharge: MeasuredDischarge) -> tuple[Floats, Floats, Floats]:
    """Charge at equal steps, and current and voltage there."""
    charge = np.linspace(0.0, discharge.charge_a_s[-1], _CURVE_POINTS)
    measured = (np.interp(charge, discharge.charge_a_s, of) for of in (discharge.current_a, discharge.voltage_v))
    return charge, *measured


def _end_charge(
    discharge: MeasuredDischarge, nominal_v: float, beta: float, capacity_a_s: float, resistance_ohm: float
) -> float:
    """Charge at which the model has the last voltage of a discharge, A*s: Eq. 16 solved for it."""
    open_v = float(discharge.voltage_v[-1]) + resistance_ohm * float(discharge.current_a[-1])
    return capacity_a_s * (1.0 - charge_left(open_v, nominal_v, beta))


def charge_left(open_v: float, nominal_v: float, beta: float) -> float:
    """Share of the charge at which Eq. 16 has an open-circuit voltage.

    Above the voltage of the full battery there is none: it goes on rising above 1, so that a fit finds its way back.

    Examples
    --------
    >>> round(charge_left(3.0, 4.0, 0.9), 6), charge_left(4.0, 4.0, 0.9)
    (0.230769, 1.0)
    """
    return (1.0 - beta) * open_v / max(nominal_v - beta * open_v, 1e-3 * (1.0 - beta) * nominal_v)


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
        _rms(np.interp(d.charge_a_s, table_charge, table_v, right=0.0) - resistance_ohm * d.current_a - d.voltage_v)
        for d in discharges
    )
    return BatteryFit(
        model="ocv_r",
        nominal_voltage_v=None,
        beta=None,
        capacity_ah=float(slow_charge[-1]) / _A_S_PER_AH,
        internal_resistance_ohm=float(resistance_ohm),
        rmse_v=float(np.sqrt(np.mean(np.square(by_discharge)))),
        table_charge_a_s=table_charge,
        table_voltage_v=table_v,
    )
