"""A simulated run: where it starts, how finely it is integrated, what it leaves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.errors import InputError
from sawbench.modeling import signals, slots
from sawbench.modeling import transient_kernel as kernel
from sawbench.modeling.validation import finite, not_negative

Floats = NDArray[np.float64]
TransientStatus = Literal["ok", "stalled", "battery_empty", "not_converged"]


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
    """

    crank_angle_rad: float = 0.0
    motor_speed_rad_s: float = 0.0
    current_a: float = 0.0
    soc: float = 1.0

    def __post_init__(self) -> None:
        finite("crank_angle_rad", self.crank_angle_rad, "rad")
        not_negative("motor_speed_rad_s", self.motor_speed_rad_s, "rad/s")
        finite("current_a", self.current_a, "A")
        finite("soc", self.soc, "")
        if not 0 <= self.soc <= 1:
            raise InputError(f"soc must be in [0, 1], got {self.soc!r}")

    def to_state(self, gear_ratio: float) -> Floats:
        """Return current, crank speed, crank angle and charge, shape (4,)."""
        return np.array([self.current_a, self.motor_speed_rad_s / gear_ratio, self.crank_angle_rad, self.soc])


AT_REST = InitialState()


@dataclass(frozen=True, kw_only=True, slots=True)
class Method:
    """How finely a run is integrated; the defaults keep the relative RMS error of the current below 1e-6.

    Attributes
    ----------
    steps_per_turn : int
        Even number of angle steps a turn to begin with, 4 to 4096; with a measured force at least one an
        interval.
    angle_tolerance : float
        Largest local error of an angle step over stall current and no-load speed; where it is passed the
        steps are halved for the rest of the run. inf keeps steps_per_turn.
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
        Integrals, end state and counts of the kernel; see `energy`.
    start : ndarray, shape (4,)
        State at time 0.
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
    def energy(self) -> EnergyBalance:
        """The energy balance up to the last sample."""
        return _energy(self.vector, self.record, self.start)

    def _blade(self) -> tuple[Floats, Floats, Floats]:
        return signals.blade(self.vector, self.spline, self.crank_angle_rad, self.motor_speed_rad_s)

    def _electric(self) -> tuple[Floats, Floats, Floats]:
        return signals.electric(self.vector, self.ocv, self.motor_current_a, self.soc)


def _energy(p: Floats, record: Floats, start: Floats) -> EnergyBalance:
    gear = p[slots.GEAR]
    end = record[kernel.END_CURRENT : kernel.END_ANGLE + 1]
    stored = signals.stored_energy(p, end[0], end[1], end[2]) - signals.stored_energy(p, start[0], start[1], start[2])
    supplied, cut = record[kernel.E_SUPPLIED], record[kernel.E_CUT]
    copper = p[slots.RESISTANCE] * record[kernel.E_COPPER]
    damping = p[slots.DAMPING] * gear * gear * record[kernel.E_DAMPED]
    conversion = (p[slots.BACK_EMF] - p[slots.TORQUE_CONSTANT]) * gear * record[kernel.E_CONVERTED]
    missing = supplied - copper - damping - conversion - cut - stored
    largest = max(abs(supplied), copper, damping, abs(cut), abs(stored), 1e-30)
    return EnergyBalance(
        electrical_in_j=float(supplied),
        copper_j=float(copper),
        damping_j=float(damping),
        cutting_j=float(cut),
        conversion_j=float(conversion),
        stored_j=float(stored),
        closure_error=float(missing / largest),
    )
