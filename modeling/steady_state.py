"""The periodic stroke at a fixed state of charge: what the machine settles to within a second."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.errors import InputError
from modeling import periodic_kernel as kernel
from modeling import slots
from modeling.parameters import JigsawParameters
from modeling.supplies import Supply
from modeling.transient import AT_REST, NO_TABLE, Cutting, InitialState, battery_table, steps_for
from modeling.validation import finite
from modeling.waveform import Waveform, extended_waveform, simple_waveform

if TYPE_CHECKING:
    from modeling.effect_strokes import EffectStroke

Floats = NDArray[np.float64]
PeriodicStatus = Literal["ok", "stalled", "not_converged"]
DEFAULT_STEPS = 12
TOLERANCE = 1e-5  # largest local error, relative; leaves a mean current good to 3e-7
MESSAGES: dict[int, tuple[PeriodicStatus, str]] = {
    kernel.PERIODIC: ("ok", "periodic"),
    kernel.NO_DRIVE: (
        "stalled",
        "no periodic stroke: the motor cannot overcome the load at this supply (voltage_v, duty, force_n)",
    ),
    kernel.NOT_CONVERGED: ("not_converged", "Newton's method did not settle"),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class PeriodicState:
    """One periodic stroke.

    Attributes
    ----------
    period_s : float
        Duration of a stroke, s; 0 where status is not "ok", like every figure here.
    mean_motor_current_a, mean_battery_current_a : float
        Over one stroke, A; for an ideal voltage source the battery current is the motor's.
    battery_voltage_v : float
        Mean at the battery's terminals, V; the source's voltage for an ideal one.
    start_current_a, start_motor_speed_rad_s : float
        At the dead centre at angle 0.
    status : {"ok", "stalled", "not_converged"}
    message : str
    n_strokes : int
        Strokes computed to find it.
    steps_per_turn : int
        That the tolerance asked for.
    """

    period_s: float
    mean_motor_current_a: float
    mean_battery_current_a: float
    battery_voltage_v: float
    start_current_a: float
    start_motor_speed_rad_s: float
    status: PeriodicStatus
    message: str
    n_strokes: int
    steps_per_turn: int
    vector: Floats = field(repr=False)
    spline: Floats = field(repr=False)
    ocv: Floats = field(repr=False)
    soc: float = 1.0
    slow: InitialState = AT_REST
    stroke: EffectStroke | None = field(default=None, repr=False)

    @property
    def stroke_rate_hz(self) -> float:
        """Strokes a second."""
        return 1.0 / self.period_s if self.period_s > 0 else 0.0

    def waveform(self, n_points: int = 64) -> Waveform:
        """Return current, speed and force at equal crank angles from 0 on; `n_points` even."""
        if n_points % 2 or n_points < 4:
            raise InputError(f"n_points must be even and at least 4, got {n_points!r}")
        if self.stroke is not None and self.stroke.kind == "extended":
            return extended_waveform(self, n_points)
        return simple_waveform(self, n_points)


@dataclass(frozen=True, kw_only=True, slots=True)
class PeriodicBatch:
    """Periodic strokes of many vectors; arrays have shape (n_cases,), 0 where `is_periodic` is False.

    Attributes
    ----------
    period_s, mean_motor_current_a, mean_battery_current_a, start_current_a, start_motor_speed_rad_s : ndarray
    is_periodic : ndarray of bool
    """

    period_s: Floats
    mean_motor_current_a: Floats
    mean_battery_current_a: Floats
    start_current_a: Floats
    start_motor_speed_rad_s: Floats
    is_periodic: NDArray[np.bool_]


def model_vector(
    parameters: JigsawParameters,
    supply: Supply,
    cutting: Cutting,
    effects: Mapping[str, float] | None = None,
) -> tuple[Floats, Floats, Floats, bool]:
    """Return the parameter vector, the force spline, the battery table, and whether any effect is on."""
    vector = parameters.to_vector()
    supply.fill(vector)
    cutting.fill(vector)
    spline = cutting.spline()
    slots.set_effects(vector, effects)
    return vector, NO_TABLE if spline is None else spline, battery_table(supply), slots.needs_extended(vector)


def steady_state(
    parameters: JigsawParameters,
    *,
    supply: Supply,
    cutting: Cutting,
    soc: float = 1.0,
    effects: Mapping[str, float] | None = None,
    slow: InitialState = AT_REST,
    steps_per_turn: int | None = None,
) -> PeriodicState:
    """Find the periodic stroke by Newton's method on the stroke map with its exact derivative.

    Parameters
    ----------
    parameters : JigsawParameters
    supply : FixedVoltage, FixedDuty or HeldVoltage
    cutting : LinearCutting or MeasuredForce
    soc : float
        State of charge at which the battery is held, 0..1.
    effects : mapping of slot name to value, optional
        As in `simulate`. Those that only change coefficients cost as much as the baseline; a cutting
        exponent, a Stribeck dip, blade compliance, a current limit, backlash and delayed engagement some
        hundred times more.
    slow : InitialState
        Winding temperature, RC voltages and distance cut that are held; the rest of it does not matter.
    steps_per_turn : int, optional
        To begin with, default 12 or an interval of the measured force; doubled until the local error is
        below 1e-5, which leaves the mean current good to 3e-7.

    Returns
    -------
    PeriodicState

    Examples
    --------
    >>> from modeling.parameter_sets import paper_jigsaw as paper
    >>> from modeling.supplies import FixedVoltage
    >>> state = steady_state(paper.PARAMETERS, supply=FixedVoltage(voltage_v=paper.MOTOR_VOLTAGE_V),
    ...                      cutting=paper.CUTTING)
    >>> round(state.stroke_rate_hz, 2), round(state.mean_motor_current_a, 3)
    (13.93, 10.483)
    """
    finite("soc", soc, "")
    if not 0 <= soc <= 1:
        raise InputError(f"soc must be in [0, 1], got {soc!r}")
    if steps_per_turn is not None and (steps_per_turn % 2 or steps_per_turn < 4):
        raise InputError(f"steps_per_turn must be even and at least 4, got {steps_per_turn!r}")
    vector, spline, ocv, has_effects = model_vector(parameters, supply, cutting, effects)
    n_steps = steps_for(spline, DEFAULT_STEPS) if steps_per_turn is None else steps_per_turn
    if has_effects or not slow.is_baseline:
        return periodic_effects(vector, spline, ocv, replace(slow, soc=soc), steps_per_turn=n_steps)
    return periodic_vector(vector, spline, ocv, soc=soc, steps_per_turn=n_steps)


def periodic_vector(
    vector: Floats,
    spline: Floats,
    ocv: Floats,
    *,
    soc: float = 1.0,
    steps_per_turn: int = DEFAULT_STEPS,
    tolerance: float = TOLERANCE,
    accept: float = kernel.ACCEPT,
) -> PeriodicState:
    """Find the periodic stroke of a parameter vector; see `steady_state`. No checks."""
    result = np.zeros(kernel.N_PERIODIC)
    code = kernel.periodic_state(vector, spline, ocv, float(soc), steps_per_turn, tolerance, accept, result)
    status, message = MESSAGES[code]
    if code != kernel.PERIODIC:
        result[:] = 0.0
    period = float(result[kernel.PERIOD])
    per = 1.0 / period if period > 0 else 0.0
    motor = float(result[kernel.MOTOR_CHARGE]) * per
    is_source = vector[slots.MODE] == slots.FIXED_VOLTAGE
    battery = motor if is_source else float(result[kernel.BATTERY_CHARGE]) * per
    return PeriodicState(
        period_s=period,
        mean_motor_current_a=motor,
        mean_battery_current_a=battery,
        battery_voltage_v=float(vector[slots.VOLTAGE])
        if is_source
        else kernel.open_circuit_voltage(vector, ocv, float(soc)) - vector[slots.BATTERY_RESISTANCE] * battery,
        start_current_a=float(result[kernel.START_CURRENT]),
        start_motor_speed_rad_s=float(result[kernel.START_SPEED] * vector[slots.GEAR]),
        status=status,
        message=message,
        n_strokes=int(result[kernel.N_STROKES]),
        steps_per_turn=int(result[kernel.STEPS]),
        vector=vector,
        spline=spline,
        ocv=ocv,
        soc=float(soc),
    )


def periodic_effects(
    vector: Floats,
    spline: Floats,
    ocv: Floats,
    slow: InitialState,
    *,
    steps_per_turn: int = DEFAULT_STEPS,
    tolerance: float = TOLERANCE,
    accept: float = kernel.ACCEPT,
    guess: Floats | None = None,
) -> PeriodicState:
    """Find the periodic stroke of a parameter vector with effects; see `steady_state`. No checks."""
    from modeling.effect_strokes import effect_stroke

    stroke = effect_stroke(
        vector,
        spline,
        ocv,
        slow,
        steps_per_turn=steps_per_turn,
        tolerance=tolerance,
        accept=accept,
        guess=guess,
    )
    status, message = MESSAGES[stroke.code]
    per = 1.0 / stroke.period_s if status == "ok" else 0.0
    is_source = vector[slots.MODE] == slots.FIXED_VOLTAGE
    motor = stroke.motor_charge_a_s * per
    battery = motor if is_source else stroke.battery_charge_a_s * per
    terminal = float(vector[slots.VOLTAGE])
    if not is_source:
        terminal = kernel.open_circuit_voltage(vector, ocv, slow.soc) - slow.rc_voltage_v - slow.polarization_v
        terminal -= (vector[slots.BATTERY_RESISTANCE] + vector[slots.EXTRA_RESISTANCE]) * battery
    return PeriodicState(
        period_s=stroke.period_s if status == "ok" else 0.0,
        mean_motor_current_a=motor,
        mean_battery_current_a=battery,
        battery_voltage_v=float(terminal),
        start_current_a=float(stroke.start[0]) if status == "ok" else 0.0,
        start_motor_speed_rad_s=float(stroke.start[1] * vector[slots.GEAR]) if status == "ok" else 0.0,
        status=status,
        message=message,
        n_strokes=stroke.n_strokes,
        steps_per_turn=stroke.steps_per_turn,
        vector=vector,
        spline=spline,
        ocv=ocv,
        soc=slow.soc,
        slow=slow,
        stroke=stroke,
    )


def _solve_batch(
    rows: Floats, force: Floats, table: Floats, soc: Floats, n_steps: int, results: Floats, statuses: NDArray
) -> None:
    """Lanes where they fit, the scalar kernel for the rest; rows with effects one by one."""
    from modeling import lane_kernel as lanes

    first = slots.GUIDE_COULOMB
    has_effects = (rows[:, first:] != slots.defaults()[first:]).any(axis=1) | (rows[:, slots.RC_RESISTANCE] != 0)
    if has_effects.any():
        raise InputError("a batch takes vectors without effects; call steady_state for those")
    statuses[:] = lanes.UNDECIDED
    if len(force) == 0:
        lanes.periodic_lanes(rows, table, soc, n_steps, TOLERANCE, results, statuses)
    left = np.flatnonzero(statuses < 0)
    if len(left):
        some, codes = np.zeros((len(left), kernel.N_PERIODIC)), np.empty(len(left), dtype=np.int64)
        kernel.periodic_states(rows[left], force, table, soc[left], n_steps, TOLERANCE, some, codes)
        results[left], statuses[left] = some, codes


def steady_state_batch(
    vectors: ArrayLike | Sequence[Floats],
    *,
    soc: ArrayLike = 1.0,
    spline: Floats | None = None,
    ocv: Floats | None = None,
    steps_per_turn: int | None = None,
) -> PeriodicBatch:
    """Periodic strokes of many parameter vectors at once, on all cores.

    Parameters
    ----------
    vectors : array_like, shape (n_cases, N_SLOTS)
        As `JigsawParameters.to_vector` and the parts' `fill` make them.
    soc : float or array_like, shape (n_cases,)
    spline, ocv : ndarray, shape (n, 4), optional
        Tables that all cases share.
    steps_per_turn : int

    Returns
    -------
    PeriodicBatch
    """
    rows = np.ascontiguousarray(vectors, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != slots.N_SLOTS:
        raise InputError(f"vectors needs shape (n_cases, {slots.N_SLOTS}), got {rows.shape}")
    charge = np.ascontiguousarray(np.broadcast_to(np.asarray(soc, dtype=np.float64), (len(rows),)))
    results = np.zeros((len(rows), kernel.N_PERIODIC))
    statuses = np.empty(len(rows), dtype=np.int64)
    force = NO_TABLE if spline is None else spline
    table = NO_TABLE if ocv is None else ocv
    n_steps = steps_for(spline, DEFAULT_STEPS) if steps_per_turn is None else steps_per_turn
    _solve_batch(rows, force, table, charge, n_steps, results, statuses)
    good = statuses == kernel.PERIODIC
    results[~good] = 0.0
    period = results[:, kernel.PERIOD]
    per = np.divide(1.0, period, out=np.zeros_like(period), where=good)
    motor = results[:, kernel.MOTOR_CHARGE] * per
    is_source = rows[:, slots.MODE] == slots.FIXED_VOLTAGE
    return PeriodicBatch(
        period_s=period,
        mean_motor_current_a=motor,
        mean_battery_current_a=np.where(is_source, motor, results[:, kernel.BATTERY_CHARGE] * per),
        start_current_a=results[:, kernel.START_CURRENT],
        start_motor_speed_rad_s=results[:, kernel.START_SPEED] * rows[:, slots.GEAR],
        is_periodic=good,
    )
