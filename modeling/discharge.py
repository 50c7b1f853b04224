"""A whole discharge of the battery: runtime, and charge, voltage, current and stroke rate over it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bench.errors import InputError
from modeling import averaging_kernel as averaging
from modeling import discharge_kernel as strokes
from modeling import slots
from modeling.parameters import JigsawParameters
from modeling.steady_state import model_vector, periodic_vector
from modeling.supplies import FixedDuty, FixedVoltage, HeldVoltage
from modeling.transient import AT_REST, Cutting, InitialState, steps_for
from modeling.validation import positive

Floats = NDArray[np.float64]
DischargeMethod = Literal["multi_scale", "brute_force"]
DischargeStatus = Literal["ok", "stalled", "cannot_start", "never_reached"]
EndedBy = Literal["soc", "voltage", "stall", "time"]
N_STEPS = 10
N_NODES = 8
MOST_NODES = 64
START_TOLERANCE = 1e-5  # of the second before the first calm dead centre; leaves some microseconds
TARGET = 1e-6
N_CURVE_POINTS = 65
CANNOT_START = "the motor never turns the crank over at this supply (voltage_v, duty, force_n)"


@dataclass(frozen=True, kw_only=True, slots=True)
class DischargeCurves:
    """Means over a stroke along a discharge; every array has shape (n,).

    Attributes
    ----------
    time_s, soc, battery_voltage_v, battery_current_a, motor_current_a, stroke_rate_hz : ndarray
    """

    time_s: Floats
    soc: Floats
    battery_voltage_v: Floats
    battery_current_a: Floats
    motor_current_a: Floats
    stroke_rate_hz: Floats


@dataclass(frozen=True, kw_only=True, slots=True)
class Discharge:
    """A discharge from the initial state to a cut-off.

    Attributes
    ----------
    runtime_s : float
        Until the cut-off, or until the machine stopped.
    mean_battery_current_a, mean_motor_current_a : float
        Charge over runtime, A.
    n_strokes : float
    ended_by : {"soc", "voltage", "stall", "time"}
    status : {"ok", "stalled", "cannot_start", "never_reached"}
    message : str
    numerical_error_s : float
        Estimated error of the numerical method, not of the model.
    curves : DischargeCurves
        Along the discharge, computed when asked for.
    """

    runtime_s: float
    mean_battery_current_a: float
    mean_motor_current_a: float
    n_strokes: float
    ended_by: EndedBy
    status: DischargeStatus
    message: str
    numerical_error_s: float
    _make_curves: Callable[[], DischargeCurves] = field(repr=False, compare=False)

    @property
    def curves(self) -> DischargeCurves:
        """Charge, voltage, currents and stroke rate over time."""
        return self._make_curves()


def discharge(
    parameters: JigsawParameters,
    *,
    supply: FixedDuty | HeldVoltage,
    cutting: Cutting,
    cutoff_soc: float = 0.2,
    cutoff_voltage_v: float | None = None,
    initial: InitialState = AT_REST,
    method: DischargeMethod = "multi_scale",
    effects: Mapping[str, float] | None = None,
    steps_per_turn: int | None = None,
) -> Discharge:
    """Run the battery down.

    Parameters
    ----------
    parameters : JigsawParameters
    supply : FixedDuty or HeldVoltage
        With its battery; Eq. 16 in the paper.
    cutting : LinearCutting or MeasuredForce
    cutoff_soc : float
        State of charge at which it ends, [0, 1); section 4.3 of the paper takes 0.2.
    cutoff_voltage_v : float, optional
        Ends earlier where the battery voltage, mean over a stroke, falls to this.
    initial : InitialState
    method : {"multi_scale", "brute_force"}
        Averaging over periodic strokes (3e-6 of brute force, a hundred times faster), or every stroke.
    effects : mapping of slot name to value, optional
        As in `simulate`.
    steps_per_turn : int, optional
        Default: 10 for a linear force (4e-7 of the runtime), a step an interval for a measured one.

    Returns
    -------
    Discharge

    Examples
    --------
    >>> from modeling.parameter_sets import paper_jigsaw as paper
    >>> from modeling.supplies import HeldVoltage
    >>> held = HeldVoltage(voltage_v=paper.MOTOR_VOLTAGE_V, battery=paper.BATTERY)
    >>> round(discharge(paper.PARAMETERS, supply=held, cutting=paper.CUTTING).runtime_s, 1)
    927.4
    """
    if isinstance(supply, FixedVoltage) or supply.battery is None:
        raise InputError("a discharge needs a supply with a battery, got FixedVoltage")
    if not 0 <= cutoff_soc < 1:
        raise InputError(f"cutoff_soc must be in [0, 1), got {cutoff_soc!r}")
    if cutoff_soc >= initial.soc:
        raise InputError(f"cutoff_soc {cutoff_soc} must be below the initial soc {initial.soc}")
    if cutoff_voltage_v is not None:
        positive("cutoff_voltage_v", cutoff_voltage_v, "V")
    vector, spline, ocv, has_effects = model_vector(parameters, supply, cutting, effects)
    volts = -1.0 if cutoff_voltage_v is None else float(cutoff_voltage_v)
    n_steps = steps_for(spline, N_STEPS) if steps_per_turn is None else steps_per_turn
    if has_effects or not initial.is_baseline:
        return _with_effects(vector, spline, ocv, initial, cutoff_soc, volts, method, n_steps)
    start = initial.to_state(parameters.gear_ratio)
    return discharge_vector(vector, spline, ocv, start, cutoff_soc, volts, method, n_steps)


def _with_effects(
    vector: Floats,
    spline: Floats,
    ocv: Floats,
    initial: InitialState,
    cutoff_soc: float,
    volts: float,
    method: DischargeMethod,
    n_steps: int,
) -> Discharge:
    from modeling import effect_discharge as slow

    if method == "multi_scale":
        done = slow.averaged(vector, spline, ocv, initial, cutoff_soc, volts, n_steps)
    else:
        done = slow.brute_force(vector, spline, ocv, initial, cutoff_soc, volts)
    runtime, motor, battery, ended, error, rows = done
    ended_by: EndedBy = "stall" if ended in ("stall", "cannot_start") else ended  # type: ignore[assignment]
    status, message = _EFFECT_ENDINGS[ended]
    return Discharge(
        runtime_s=float(runtime),
        mean_battery_current_a=float(battery / runtime) if runtime > 0 else 0.0,
        mean_motor_current_a=float(motor / runtime) if runtime > 0 else 0.0,
        n_strokes=float(np.trapezoid(rows[:, 5], rows[:, 0])) if len(rows) > 1 else 0.0,
        ended_by=ended_by,
        status=status,
        message=message,
        numerical_error_s=float(error),
        _make_curves=partial(_stroke_curves, rows),
    )


def discharge_vector(
    vector: Floats,
    spline: Floats,
    ocv: Floats,
    start: Floats,
    cutoff_soc: float,
    cutoff_voltage_v: float,
    method: DischargeMethod = "multi_scale",
    steps_per_turn: int = N_STEPS,
) -> Discharge:
    """Run down a parameter vector; `start` is (current, crank speed, crank angle, soc). No checks."""
    if method == "multi_scale":
        done = _averaged(vector, spline, ocv, start, cutoff_soc, cutoff_voltage_v, steps_per_turn)
        if done is not None:
            return done
    return _brute(vector, spline, ocv, start, cutoff_soc, cutoff_voltage_v, steps_per_turn)


def runtime_batch(
    vectors: Floats,
    *,
    cutoff_soc: float = 0.2,
    cutoff_voltage_v: float | None = None,
    spline: Floats | None = None,
    ocv: Floats | None = None,
    steps_per_turn: int | None = None,
) -> Floats:
    """Runtime from full and at rest of many parameter vectors on all cores, shape (n_cases,), s.

    NaN where a discharge cannot be averaged (a stall on the way): run `discharge` on that case.
    """
    from modeling.transient import NO_TABLE

    rows = np.ascontiguousarray(vectors, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != slots.N_SLOTS:
        raise InputError(f"vectors needs shape (n_cases, {slots.N_SLOTS}), got {rows.shape}")
    volts = -1.0 if cutoff_voltage_v is None else float(cutoff_voltage_v)
    runtimes = np.empty(len(rows))
    nodes, weights = _gauss(2 * N_NODES)
    averaging.runtimes(
        rows,
        NO_TABLE if spline is None else spline,
        NO_TABLE if ocv is None else ocv,
        steps_for(spline, N_STEPS) if steps_per_turn is None else steps_per_turn,
        START_TOLERANCE,
        cutoff_soc,
        volts,
        nodes,
        weights,
        runtimes,
    )
    return runtimes


@lru_cache(maxsize=16)
def _gauss(n: int) -> tuple[Floats, Floats]:
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return np.ascontiguousarray(nodes[::-1]), np.ascontiguousarray(weights[::-1])


def _averaged(
    vector: Floats, spline: Floats, ocv: Floats, start: Floats, cutoff_soc: float, volts: float, n_steps: int
) -> Discharge | None:
    n_nodes = N_NODES
    while True:
        nodes, weights = _gauss(n_nodes)
        table = np.zeros((n_nodes, averaging.N_COLUMNS))
        result = np.zeros(averaging.N_RESULT)
        code = averaging.discharge_averaged(
            vector,
            spline,
            ocv,
            start,
            n_steps,
            START_TOLERANCE,
            cutoff_soc,
            volts,
            nodes,
            weights,
            table,
            result,
        )
        if code not in (strokes.BY_SOC, strokes.BY_VOLTAGE):
            return None
        span = result[averaging.START_SOC] - result[averaging.END_SOC]
        error = _quadrature_error(table[:, averaging.PERIOD] / table[:, averaging.SHARE], span)
        runtime = float(result[averaging.RUNTIME])
        if error <= TARGET * runtime or 2 * n_nodes > MOST_NODES:
            break
        n_nodes *= 2
    # Calibrated on the step error of the mean current: local error 1e-5 goes with 3e-7.
    error += runtime * 0.1 * float(result[averaging.LOCAL_ERROR])
    share_of_charge = (start[3] - result[averaging.END_SOC]) * vector[slots.CAPACITY]
    motor = result[averaging.MOTOR_CHARGE] / (runtime - result[averaging.START_TIME])
    return Discharge(
        runtime_s=runtime,
        mean_battery_current_a=float(share_of_charge / runtime),
        mean_motor_current_a=float(motor),
        n_strokes=float(result[averaging.STROKES]),
        ended_by="soc" if code == strokes.BY_SOC else "voltage",
        status="ok",
        message="reached the cut-off",
        numerical_error_s=float(error),
        _make_curves=partial(_curves, vector, ocv, nodes, table, result),
    )


@lru_cache(maxsize=16)
def _to_legendre(n: int) -> Floats:
    """Matrix from values at the Gauss nodes to Legendre coefficients, shape (n, n)."""
    nodes, weights = _gauss(n)
    vander = np.polynomial.legendre.legvander(nodes, n - 1)
    return (vander * weights[:, None]).T * ((2 * np.arange(n) + 1) / 2)[:, None]


def _quadrature_error(values: Floats, span: float) -> float:
    """Error of a Gauss rule from the decay of the Legendre coefficients of its integrand."""
    n = len(values)
    coefficients = np.abs(_to_legendre(n) @ values)
    early, late = coefficients[n // 2 - 1 : n // 2 + 1].max(), coefficients[n - 2 :].max()
    if early <= 0 or late <= 0:
        return 0.0
    ratio = min((late / early) ** (2.0 / n), 1.0)  # decay from one degree to the next
    return float(span * late * ratio**n + 1e-15 * span * coefficients[0])


def _curves(vector: Floats, ocv: Floats, nodes: Floats, table: Floats, result: Floats) -> DischargeCurves:
    """Interpolate the node table to states of charge that fall from the start to the end."""
    series = np.polynomial.legendre
    soc = np.linspace(result[averaging.START_SOC], result[averaging.END_SOC], N_CURVE_POINTS)
    span = soc[0] - soc[-1]
    at = 2.0 * (soc - soc[-1]) / span - 1.0
    transform = _to_legendre(len(nodes))

    def at_soc(values: Floats) -> Floats:
        return series.legval(at, transform @ values)

    period, share = table[:, averaging.PERIOD], table[:, averaging.SHARE]
    grown = series.legint(transform @ (period / share)) * 0.5 * span
    battery = at_soc(table[:, averaging.BATTERY])
    at_rest = np.array([averaging.open_circuit_at(vector, ocv, s) for s in soc])
    return DischargeCurves(
        time_s=result[averaging.START_TIME] + series.legval(1.0, grown) - series.legval(at, grown),
        soc=soc,
        battery_voltage_v=at_rest - vector[slots.BATTERY_RESISTANCE] * battery,
        battery_current_a=battery,
        motor_current_a=at_soc(table[:, averaging.CHARGE] / period),
        stroke_rate_hz=1.0 / at_soc(period),
    )


def _stroke_curves(rows: Floats) -> DischargeCurves:
    return DischargeCurves(
        time_s=rows[:, strokes.TIME],
        soc=rows[:, strokes.SOC],
        battery_voltage_v=rows[:, strokes.VOLTAGE],
        battery_current_a=rows[:, strokes.BATTERY_CURRENT],
        motor_current_a=rows[:, strokes.MOTOR_CURRENT],
        stroke_rate_hz=rows[:, strokes.RATE],
    )


def _brute(
    vector: Floats, spline: Floats, ocv: Floats, start: Floats, cutoff_soc: float, volts: float, n_steps: int
) -> Discharge:
    rows = np.empty((400_000, strokes.N_CURVES))
    time, motor, battery, n_strokes, n_rows, code = strokes.brute_force(
        vector, spline, ocv, start, n_steps, START_TOLERANCE, cutoff_soc, volts, rows
    )
    curves = rows[:n_rows].copy()
    middle = 0.5 * (start[3] + cutoff_soc)
    coarse = periodic_vector(vector, spline, ocv, soc=middle, steps_per_turn=n_steps, tolerance=np.inf)
    fine = periodic_vector(vector, spline, ocv, soc=middle, steps_per_turn=2 * n_steps, tolerance=np.inf)
    error = 0.0
    if coarse.status == fine.status == "ok":
        error = 2.0 * time * abs(coarse.mean_battery_current_a / fine.mean_battery_current_a - 1.0)
    ended, status, message = _ENDINGS[code]
    if code == strokes.BY_STALL and n_strokes == 0:
        status, message = "cannot_start", CANNOT_START
    return Discharge(
        runtime_s=float(time),
        mean_battery_current_a=float(battery / time) if time > 0 else 0.0,
        mean_motor_current_a=float(motor / time) if time > 0 else 0.0,
        n_strokes=float(n_strokes),
        ended_by=ended,
        status=status,
        message=message,
        numerical_error_s=float(error),
        _make_curves=partial(_stroke_curves, curves),
    )


_ENDINGS: dict[int, tuple[EndedBy, DischargeStatus, str]] = {
    strokes.BY_SOC: ("soc", "ok", "reached the cut-off"),
    strokes.BY_VOLTAGE: ("voltage", "ok", "reached the cut-off"),
    strokes.BY_STALL: (
        "stall",
        "stalled",
        "the motor could no longer overcome the load (voltage_v, duty, force_n)",
    ),
    strokes.BY_LIMIT: ("time", "never_reached", "the cut-off was not reached in 1e7 s"),
    strokes.FAILED: ("time", "never_reached", "the start-up did not converge"),
}
_EFFECT_ENDINGS: dict[str, tuple[DischargeStatus, str]] = {
    "soc": _ENDINGS[strokes.BY_SOC][1:],
    "voltage": _ENDINGS[strokes.BY_VOLTAGE][1:],
    "stall": _ENDINGS[strokes.BY_STALL][1:],
    "cannot_start": ("cannot_start", CANNOT_START),
    "time": _ENDINGS[strokes.BY_LIMIT][1:],
}
