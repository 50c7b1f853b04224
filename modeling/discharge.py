"""A whole discharge of the battery: runtime, and charge, voltage, current and stroke rate over it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.errors import InputError
from sawbench.modeling import averaging_kernel as averaging
from sawbench.modeling import discharge_kernel as strokes
from sawbench.modeling import signals, slots
from sawbench.modeling.compilation import runner
from sawbench.modeling.parameters import JigsawParameters
from sawbench.modeling.steady_state import periodic_vector
from sawbench.modeling.stroke_kernel import MOST_STEPS
from sawbench.modeling.supplies import FixedDuty, FixedVoltage, HeldVoltage
from sawbench.modeling.transient import AT_REST, Cutting, InitialState, model_vector, steps_for
from sawbench.modeling.validation import positive

Floats = NDArray[np.float64]
DischargeMethod = Literal["multi_scale", "brute_force"]
DischargeStatus = Literal["ok", "stalled", "cannot_start", "never_reached"]
EndedBy = Literal["soc", "voltage", "stall", "time"]
Settings = tuple[int, float, float, float]  # steps a turn, tolerance of the start-up, cut-off charge and voltage
N_STEPS = 10
MOST_INTERPRETED_STEPS = 160
N_NODES = 8
MOST_NODES = 64
START_TOLERANCE = 1e-5  # of the second before the first calm dead centre; leaves some microseconds
TARGET = 1e-6
N_CURVE_POINTS = 65
CANNOT_START = "the motor cannot turn the crank through a full turn at this supply (voltage_v, duty, force_n)"


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
    notes : tuple of str
        Where a learned term of the model is beyond the range that it holds in.
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
    notes: tuple[str, ...] = ()

    @property
    def curves(self) -> DischargeCurves:
        """Charge, voltage, currents and stroke rate over time."""
        return self._make_curves()


# Size: options by name: what is cut, when it ends, where it begins, how exact it is.
def discharge(
    parameters: JigsawParameters,
    *,
    supply: FixedDuty | HeldVoltage,
    cutting: Cutting,
    cutoff_soc: float = 0.2,
    cutoff_voltage_v: float | None = None,
    initial: InitialState = AT_REST,
    method: DischargeMethod = "multi_scale",
    steps_per_turn: int | None = None,
    target: float = TARGET,
    compiles: bool = True,
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
    steps_per_turn : int, optional
        Default: 10 for a linear force (4e-7 of the runtime), a step an interval for a measured one.
    target : float
        Relative error of the quadrature above which more states of charge are taken; inf takes the fewest.
    compiles : bool
        False has the averaging interpreted: some 20 ms in place of 0.1 ms, without the seconds to compile it once.

    Examples
    --------
    >>> from sawbench.modeling.machines import paper_jigsaw as paper
    >>> from sawbench.modeling.supplies import HeldVoltage
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
    vector, spline, ocv = model_vector(parameters, supply, cutting)
    volts = -1.0 if cutoff_voltage_v is None else float(cutoff_voltage_v)
    n_steps = steps_for(spline, N_STEPS) if steps_per_turn is None else steps_per_turn
    start = initial.to_state(parameters.gear_ratio)
    settings = (n_steps, START_TOLERANCE, float(cutoff_soc), volts)
    done: Discharge | int = strokes.COARSE if method == "multi_scale" else strokes.FAILED
    while done == strokes.COARSE and n_steps <= max(settings[0], MOST_STEPS):
        finer = (n_steps, *settings[1:])
        compiles = compiles or n_steps > max(settings[0], MOST_INTERPRETED_STEPS)
        done = _averaged(vector, spline, ocv, start, finer, target=target, compiles=compiles)
        n_steps *= 2
    return done if isinstance(done, Discharge) else _brute(vector, spline, ocv, start, settings)


@lru_cache(maxsize=16)
def _gauss(n: int) -> Floats:
    """Gauss-Legendre nodes, descending, and their weights, shape (2, n)."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return np.array([nodes[::-1], weights[::-1]])


def _averaged(
    vector: Floats, spline: Floats, ocv: Floats, start: Floats, settings: Settings, *, target: float, compiles: bool
) -> Discharge | int:
    """A discharge from a few strokes, or a code of `averaging_kernel.discharge_averaged` why there is none."""
    run, parameters = runner(averaging.discharge_averaged, vector, compiles)
    n_nodes = N_NODES
    while True:
        table, result = np.zeros((n_nodes, averaging.N_COLUMNS)), np.zeros(averaging.N_RESULT)
        code = run(parameters, spline, ocv, start, settings, _gauss(n_nodes), table, result)
        if code not in (strokes.BY_SOC, strokes.BY_VOLTAGE):
            return code
        span = result[averaging.START_SOC] - result[averaging.END_SOC]
        error = quadrature_error(table[:, averaging.PERIOD] / table[:, averaging.SHARE], span)
        runtime = float(result[averaging.RUNTIME])
        if error <= target * runtime or 2 * n_nodes > MOST_NODES:
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
        _make_curves=partial(_curves, vector, ocv, table, result),
    )


@lru_cache(maxsize=16)
def _to_legendre(n: int) -> Floats:
    """Matrix from values at the Gauss nodes to Legendre coefficients, shape (n, n)."""
    nodes, weights = _gauss(n)
    vander = np.polynomial.legendre.legvander(nodes, n - 1)
    return (vander * weights[:, None]).T * ((2 * np.arange(n) + 1) / 2)[:, None]


def quadrature_error(values: Floats, span: float) -> float:
    """Error of a Gauss rule from the decay of the Legendre coefficients of its integrand."""
    n = len(values)
    coefficients = np.abs(_to_legendre(n) @ values)
    early, late = coefficients[n // 2 - 1 : n // 2 + 1].max(), coefficients[n - 2 :].max()
    if early <= 0 or late <= 0:
        return 0.0
    ratio = min((late / early) ** (2.0 / n), 1.0)  # decay from one degree to the next
    return float(span * late * ratio**n + 1e-15 * span * coefficients[0])


def _curves(vector: Floats, ocv: Floats, table: Floats, result: Floats) -> DischargeCurves:
    """Interpolate the node table to states of charge that fall from the start to the end."""
    series = np.polynomial.legendre
    soc = np.linspace(result[averaging.START_SOC], result[averaging.END_SOC], N_CURVE_POINTS)
    span = soc[0] - soc[-1]
    at = 2.0 * (soc - soc[-1]) / span - 1.0
    transform = _to_legendre(len(table))

    def at_soc(values: Floats) -> Floats:
        return series.legval(at, transform @ values)

    period, share = table[:, averaging.PERIOD], table[:, averaging.SHARE]
    grown = series.legint(transform @ (period / share)) * 0.5 * span
    battery = at_soc(table[:, averaging.BATTERY])
    at_rest = signals.open_circuit_voltage(vector, ocv, soc)
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


def _brute(vector: Floats, spline: Floats, ocv: Floats, start: Floats, settings: Settings) -> Discharge:
    n_steps, _, cutoff_soc, _ = settings
    rows = np.empty((400_000, strokes.N_CURVES))
    time, motor, battery, n_strokes, n_rows, code = strokes.brute_force(vector, spline, ocv, start, settings, rows)
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
