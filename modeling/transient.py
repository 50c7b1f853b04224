"""Simulate a run of the machine over time: Equations 1 to 13 from a given start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.errors import InputError
from modeling import baseline_kernel as kernel
from modeling import slots
from modeling.parameters import JigsawParameters
from modeling.supplies import Supply
from modeling.validation import finite, not_negative, positive

Floats = NDArray[np.float64]
TransientStatus = Literal["ok", "stalled", "battery_empty", "not_converged"]
NO_TABLE: Floats = np.zeros((0, 4))


class Cutting(Protocol):
    """What a simulation needs of a cutting force."""

    def spline(self) -> Floats | None:
        """Spline of a force over the crank angle, shape (n, 4), or None."""
        ...

    def fill(self, vector: Floats) -> None:
        """Write the cutting slots into a parameter vector, in place."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class InitialState:
    """The state at time 0.

    Attributes
    ----------
    crank_angle_rad : float
        0 is the dead centre with the smallest displacement.
    motor_speed_rad_s : float
        Not negative: the machine turns one way.
    current_a : float
        Motor current.
    soc : float
        State of charge, 0..1.
    blade_force_n : float
        Force stored in the blade, with blade_compliance_m_per_n.
    winding_temperature_rise_k : float
        Above the temperature that resistance and constants are stated for.
    rc_voltage_v, polarization_v : float
        Across the battery's RC element, and across that of the polarization effect.
    cut_distance_m : float
        That the blade has cut before, for wear_per_m.
    """

    crank_angle_rad: float = 0.0
    motor_speed_rad_s: float = 0.0
    current_a: float = 0.0
    soc: float = 1.0
    blade_force_n: float = 0.0
    winding_temperature_rise_k: float = 0.0
    rc_voltage_v: float = 0.0
    polarization_v: float = 0.0
    cut_distance_m: float = 0.0

    def __post_init__(self) -> None:
        finite("crank_angle_rad", self.crank_angle_rad, "rad")
        not_negative("motor_speed_rad_s", self.motor_speed_rad_s, "rad/s")
        finite("current_a", self.current_a, "A")
        finite("soc", self.soc, "")
        if not 0 <= self.soc <= 1:
            raise InputError(f"soc must be in [0, 1], got {self.soc!r}")
        for name, unit in _SLOW_UNITS:
            finite(name, getattr(self, name), unit)

    @property
    def is_baseline(self) -> bool:
        """Whether the quantities that only effects know are all 0."""
        return not any(getattr(self, name) for name, _ in _SLOW_UNITS)

    def to_state(self, gear_ratio: float) -> Floats:
        """Return current, crank speed, crank angle, charge and the slow quantities, shape (9,)."""
        fast = (self.current_a, self.motor_speed_rad_s / gear_ratio, self.crank_angle_rad, self.soc)
        return np.array([*fast, *(getattr(self, name) for name, _ in _SLOW_UNITS)])


_SLOW_UNITS = (
    ("blade_force_n", "N"),
    ("winding_temperature_rise_k", "K"),
    ("rc_voltage_v", "V"),
    ("polarization_v", "V"),
    ("cut_distance_m", "m"),
)

AT_REST = InitialState()


@dataclass(frozen=True, kw_only=True, slots=True)
class Method:
    """How finely a run is integrated; the defaults keep the relative RMS error of the current below 1e-6.

    Attributes
    ----------
    steps_per_turn : int
        Even number of angle steps a turn to begin with, 4 to 4096; with a measured force at least one an interval.
    angle_tolerance : float
        Largest local error of an angle step over stall current and no-load speed; where it is passed the steps are
        halved for the rest of the run. inf keeps steps_per_turn.
    time_tolerance : float
        The same for the time steps near rest, which adapt at every step.
    """

    steps_per_turn: int = 16
    angle_tolerance: float = 1e-6
    time_tolerance: float = 1e-7

    def __post_init__(self) -> None:
        if self.steps_per_turn % 2 or not 4 <= self.steps_per_turn <= kernel.MOST_STEPS_PER_TURN:
            raise InputError(f"steps_per_turn must be even, 4 to 4096, got {self.steps_per_turn!r}")
        for name in ("angle_tolerance", "time_tolerance"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} must be greater than 0, got {getattr(self, name)!r}")


DEFAULT_METHOD = Method()


@dataclass(frozen=True, kw_only=True, slots=True)
class EnergyBalance:
    """Where the electrical energy went between time 0 and the last sample, J.

    Attributes
    ----------
    electrical_in_j : float
        Integral of motor voltage times current.
    copper_j : float
        Integral of R i^2.
    damping_j : float
        Integral of b omega^2.
    cutting_j : float
        Integral of cutting force times blade speed.
    conversion_j : float
        Integral of (k_e - k_m) i omega: 0 for an ideal motor; the paper's constants differ.
    other_j : float
        Friction, windage, rubbing, eccentricity and brushes, where effects are on.
    stored_j : float
        Change of magnetic and kinetic energy.
    closure_error : float
        What is missing, over the energy put in (or the largest term); the integrator's own error.
    """

    electrical_in_j: float
    copper_j: float
    damping_j: float
    cutting_j: float
    conversion_j: float
    other_j: float
    stored_j: float
    closure_error: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Trajectory:
    """A simulated run; every array has shape (n,).

    Attributes
    ----------
    time_s : ndarray
    motor_current_a : ndarray
    motor_speed_rad_s : ndarray
    crank_angle_rad : ndarray
        Counted on from the start, not wrapped.
    soc : ndarray
    status : {"ok", "stalled", "battery_empty", "not_converged"}
    message : str
        One sentence on the status.
    vector : ndarray, shape (N_SLOTS,)
        The parameters it was computed with.
    spline : ndarray, shape (n_nodes, 4)
        Measured force, no rows where there is none.
    ocv : ndarray, shape (n_pieces, 4)
        Battery table, no rows where there is none.
    record : ndarray
        Integrals, end state and counts of the kernel; see `energy`, `error_estimate`.
    start : ndarray, shape (9,)
        State at time 0.
    seen : ndarray, shape (5, n), or None
        Force, displacement and voltages as a run with effects leaves them.
    """

    time_s: Floats
    motor_current_a: Floats
    motor_speed_rad_s: Floats
    crank_angle_rad: Floats
    soc: Floats
    status: TransientStatus
    message: str
    vector: Floats
    spline: Floats
    ocv: Floats
    record: Floats = field(repr=False)
    start: Floats = field(repr=False)
    seen: Floats | None = field(default=None, repr=False)

    @property
    def motor_angle_rad(self) -> Floats:
        """Angle of the motor shaft, rad (Eq. 2)."""
        return self.crank_angle_rad * self.vector[slots.GEAR]

    @property
    def crank_speed_rad_s(self) -> Floats:
        """Speed of the crank, rad/s."""
        return self.motor_speed_rad_s / self.vector[slots.GEAR]

    @property
    def displacement_m(self) -> Floats:
        """Blade displacement, m (Eq. 1)."""
        return self._blade()[0]

    @property
    def blade_velocity_m_s(self) -> Floats:
        """Blade velocity, m/s (Eq. 3)."""
        return self._blade()[1]

    @property
    def force_n(self) -> Floats:
        """Cutting force, N, positive when the blade cuts (Eq. 9)."""
        return self._blade()[2]

    @property
    def motor_voltage_v(self) -> Floats:
        """Voltage at the motor, V."""
        return self._electric()[0]

    @property
    def battery_voltage_v(self) -> Floats:
        """Voltage at the battery's terminals, V; the motor voltage for an ideal source."""
        return self._electric()[1]

    @property
    def battery_current_a(self) -> Floats:
        """Battery current, A; the motor current for an ideal source."""
        return self._electric()[2]

    @property
    def error_estimate(self) -> float:
        """Sum of the embedded local errors of the current over the stall current; an upper bound by experience."""
        return float(self.record[kernel.ERROR_CURRENT])

    @property
    def energy(self) -> EnergyBalance:
        """The energy balance up to the last sample."""
        return _energy(self.vector, self.record, self.start)

    def _blade(self) -> Floats:
        if self.seen is not None:
            velocity = _outputs().play_velocity(self.vector, self.crank_angle_rad, self.motor_speed_rad_s)
            return np.array([self.seen[1], velocity, self.seen[0]])
        return _outputs().blade(self.vector, self.spline, self.crank_angle_rad, self.motor_speed_rad_s)

    def _electric(self) -> Floats:
        if self.seen is not None:
            return self.seen[2:5]
        return _outputs().electric(self.vector, self.ocv, self.motor_current_a, self.soc)


def battery_table(supply: Supply) -> Floats:
    """Spline of the battery's open-circuit voltage, shape (n, 4); no rows where it has an equation or is absent."""
    table = None if supply.battery is None else supply.battery.ocv_table()
    return NO_TABLE if table is None else table


def _outputs():
    from modeling import output_kernel

    return output_kernel


def simulate(
    parameters: JigsawParameters,
    *,
    supply: Supply,
    cutting: Cutting,
    duration_s: float | None = None,
    rate_hz: float = 1000.0,
    time_s: ArrayLike | None = None,
    initial: InitialState = AT_REST,
    effects: Mapping[str, float] | None = None,
    method: Method = DEFAULT_METHOD,
) -> Trajectory:
    """Simulate the machine over time (Eqs. 1 to 13).

    Parameters
    ----------
    parameters : JigsawParameters
    supply : FixedVoltage, FixedDuty or HeldVoltage
    cutting : LinearCutting or MeasuredForce
    duration_s : float, optional
        Samples at 0, 1/rate_hz, ... up to and including the duration where it falls on the grid.
    rate_hz : float
    time_s : array_like, shape (n,), optional
        Sample times instead of duration and rate, increasing, from 0 on, s.
    initial : InitialState
    effects : mapping of slot name to value, optional
        Unmodelled effects, names and units as in `modeling.slots`.
    method : Method

    Returns
    -------
    Trajectory

    Raises
    ------
    InputError
        On times that do not increase, or a value out of its range.

    Examples
    --------
    >>> from modeling.parameter_sets import paper_jigsaw as paper
    >>> from modeling.supplies import FixedVoltage
    >>> run = simulate(paper.PARAMETERS, supply=FixedVoltage(voltage_v=paper.MOTOR_VOLTAGE_V),
    ...                cutting=paper.CUTTING, duration_s=1.0)
    >>> run.status, round(float(run.motor_current_a.max()), 2)
    ('ok', 34.73)
    """
    times = sample_times(duration_s, rate_hz, time_s)
    vector = parameters.to_vector()
    supply.fill(vector)
    cutting.fill(vector)
    spline = cutting.spline()
    slots.set_effects(vector, effects)
    return run_vector(
        vector, NO_TABLE if spline is None else spline, battery_table(supply), times, initial, method=method
    )


def run_vector(
    vector: Floats,
    spline: Floats,
    ocv: Floats,
    time_s: Floats,
    initial: InitialState = AT_REST,
    *,
    method: Method = DEFAULT_METHOD,
) -> Trajectory:
    """Simulate a parameter vector; see `simulate`. No checks."""
    start = initial.to_state(vector[slots.GEAR])
    out = np.empty((4, len(time_s)))
    seen = None
    if slots.needs_extended(vector) or not initial.is_baseline:
        from modeling.extended_transient import run_extended

        code, record, seen = run_extended(vector, spline, ocv, time_s, start, method.time_tolerance, out)
    else:
        record = np.empty(kernel.N_RECORD)
        tolerances = (method.angle_tolerance, method.time_tolerance)
        n_steps = (
            method.steps_per_turn if len(spline) == 0 else max(method.steps_per_turn, steps_for(spline, 16))
        )
        code = kernel.simulate_baseline(vector, spline, ocv, time_s, start, n_steps, tolerances, out, record)
    status, message = _STATUS[code]
    return Trajectory(
        time_s=time_s,
        motor_current_a=out[0],
        motor_speed_rad_s=out[1],
        crank_angle_rad=out[2],
        soc=out[3],
        status=status,
        message=message,
        vector=vector,
        spline=spline,
        ocv=ocv,
        record=record,
        start=start,
        seen=seen,
    )


def steps_for(spline: Floats | None, default: int) -> int:
    """Steps a turn: the default, or with a measured force one a spline interval (or two, ... where they are many).

    Steps that end on the nodes see a polynomial; steps that straddle them lose two orders, unseen by the embedded
    error estimate.

    Examples
    --------
    >>> steps_for(None, 12), steps_for(np.zeros((64, 4)), 12), steps_for(np.zeros((256, 4)), 12)
    (12, 64, 64)
    """
    if spline is None or len(spline) == 0:
        return default
    n = len(spline)
    while n > 96 and n % 4 == 0:
        n //= 2
    while n < default:
        n *= 2
    return n


_STATUS: dict[int, tuple[TransientStatus, str]] = {
    kernel.OK: ("ok", "ran to the last sample"),
    kernel.STALLED: (
        "stalled",
        "the crank stands at the end: the motor cannot overcome the load at this supply (force_n, voltage_v)",
    ),
    kernel.NO_CONVERGENCE: ("not_converged", "the step size fell below 1 ps or the steps ran out"),
    kernel.EMPTY: ("battery_empty", "the state of charge fell below 0"),
}


def sample_times(duration_s: float | None, rate_hz: float, time_s: ArrayLike | None) -> Floats:
    if time_s is not None:
        times = np.ascontiguousarray(time_s, dtype=np.float64)
        if times.ndim != 1 or len(times) == 0 or not np.isfinite(times).all():
            raise InputError("time_s must be one row of finite times")
        if times[0] < 0 or (np.diff(times) <= 0).any():
            raise InputError("time_s must increase from 0 on")
        return times
    if duration_s is None:
        raise InputError("give duration_s or time_s")
    positive("duration_s", duration_s, "s")
    positive("rate_hz", rate_hz, "Hz")
    return _grid(duration_s, rate_hz).copy()  # numba compiles once more for a read-only array


@lru_cache(maxsize=32)
def _grid(duration_s: float, rate_hz: float) -> Floats:
    times = np.arange(int(duration_s * rate_hz * (1 + 1e-12)) + 1) / rate_hz
    return times


def _energy(p: Floats, record: Floats, start: Floats) -> EnergyBalance:
    gear = p[slots.GEAR]
    end = record[kernel.END_CURRENT : kernel.END_ANGLE + 1]
    stored = _outputs().stored_energy(p, end[0], end[1], end[2])
    stored -= _outputs().stored_energy(p, start[0], start[1], start[2])
    supplied = record[kernel.E_SUPPLIED]
    if len(record) > kernel.N_RECORD:  # a run with effects keeps the terms themselves
        copper, conversion, damping, cut, other = (
            record[1],
            record[2],
            record[3],
            record[4],
            record[kernel.N_RECORD],
        )
    else:
        copper = p[slots.RESISTANCE] * record[kernel.E_COPPER]
        damping = p[slots.DAMPING] * gear * gear * record[kernel.E_DAMPED]
        conversion = (p[slots.BACK_EMF] - p[slots.TORQUE_CONSTANT]) * gear * record[kernel.E_CONVERTED]
        cut, other = record[kernel.E_CUT], 0.0
    missing = supplied - copper - damping - conversion - cut - other - stored
    largest = max(abs(supplied), copper, damping, abs(cut), abs(other), abs(stored), 1e-30)
    return EnergyBalance(
        electrical_in_j=float(supplied),
        copper_j=float(copper),
        damping_j=float(damping),
        cutting_j=float(cut),
        conversion_j=float(conversion),
        other_j=float(other),
        stored_j=float(stored),
        closure_error=float(missing / largest),
    )
