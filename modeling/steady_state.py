"""The periodic stroke at a fixed state of charge: what the machine settles to within a second."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.errors import InputError
from sawbench.modeling import signals, slots
from sawbench.modeling import stroke_kernel as kernel
from sawbench.modeling.compilation import runner
from sawbench.modeling.parameters import JigsawParameters
from sawbench.modeling.supplies import Supply
from sawbench.modeling.transient import Cutting, model_vector, steps_for
from sawbench.modeling.validation import finite

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
    kernel.NOT_CONVERGED: ("not_converged", "Newton's method did not converge"),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Waveform:
    """A periodic stroke over the crank angle; every array has shape (n_points,).

    Attributes
    ----------
    crank_angle_rad, motor_current_a, motor_speed_rad_s, displacement_m, blade_velocity_m_s, force_n : ndarray
    """

    crank_angle_rad: Floats
    motor_current_a: Floats
    motor_speed_rad_s: Floats
    displacement_m: Floats
    blade_velocity_m_s: Floats
    force_n: Floats


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
    compiles: bool = field(default=True, repr=False)

    @property
    def stroke_rate_hz(self) -> float:
        """Strokes a second."""
        return 1.0 / self.period_s if self.period_s > 0 else 0.0

    def waveform(self, n_points: int = 64) -> Waveform:
        """Return current, speed and force at equal crank angles from 0 on; `n_points` even."""
        if n_points % 2 or n_points < 4:
            raise InputError(f"n_points must be even and at least 4, got {n_points!r}")
        factor = -(-self.steps_per_turn // n_points)
        gear = self.vector[slots.GEAR]
        current, speed = np.zeros(n_points * factor), np.zeros(n_points * factor)
        if self.status == "ok":
            start = (self.start_current_a, self.start_motor_speed_rad_s / gear)
            run, vector = runner(kernel.waveform, self.vector, self.compiles)
            run(vector, self.spline, self.ocv, self.soc, len(current), *start, current, speed)
        angle = 2.0 * np.pi * np.arange(n_points) / n_points
        motor_speed = speed[::factor] * gear
        displacement, velocity, force = signals.blade(self.vector, self.spline, angle, motor_speed)
        return Waveform(
            crank_angle_rad=angle,
            motor_current_a=current[::factor],
            motor_speed_rad_s=motor_speed,
            displacement_m=displacement,
            blade_velocity_m_s=velocity,
            force_n=force,
        )


def steady_state(
    parameters: JigsawParameters,
    *,
    supply: Supply,
    cutting: Cutting,
    soc: float = 1.0,
    steps_per_turn: int | None = None,
    compiles: bool = True,
) -> PeriodicState:
    """Find the periodic stroke by Newton's method on the stroke map with its exact derivative.

    Parameters
    ----------
    parameters : JigsawParameters
    supply : FixedVoltage, FixedDuty or HeldVoltage
    cutting : LinearCutting or MeasuredForce
    soc : float
        State of charge at which the battery is held, 0..1.
    steps_per_turn : int, optional
        To begin with, default 12 or an interval of the measured force; doubled until the local error is
        below 1e-5, which leaves the mean current good to 3e-7.
    compiles : bool
        False has it interpreted: some 30 ms in place of 0.1 ms, without the seconds to compile it once.

    Examples
    --------
    >>> from sawbench.modeling.machines import paper_jigsaw as paper
    >>> from sawbench.modeling.supplies import FixedVoltage
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
    vector, spline, ocv = model_vector(parameters, supply, cutting)
    n_steps = steps_for(spline, DEFAULT_STEPS) if steps_per_turn is None else steps_per_turn
    return periodic_vector(vector, spline, ocv, soc=soc, steps_per_turn=n_steps, compiles=compiles)


def periodic_vector(
    vector: Floats,
    spline: Floats,
    ocv: Floats,
    *,
    soc: float = 1.0,
    steps_per_turn: int = DEFAULT_STEPS,
    tolerance: float = TOLERANCE,
    accept: float = kernel.ACCEPT,
    compiles: bool = True,
) -> PeriodicState:
    """Find the periodic stroke of a parameter vector; see `steady_state`. No checks."""
    result = np.zeros(kernel.N_PERIODIC)
    run, parameters = runner(kernel.periodic_state, vector, compiles)
    code = run(parameters, spline, ocv, float(soc), steps_per_turn, tolerance, accept, result)
    status, message = MESSAGES[code]
    at_rest = signals.open_circuit_voltage(vector, ocv, np.asarray(soc, dtype=np.float64))
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
        else float(at_rest) - vector[slots.BATTERY_RESISTANCE] * battery,
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
        compiles=compiles,
    )
