"""Simulate a run of the machine over time: Equations 1 to 13 from a given start."""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from sawbench.bench.errors import InputError
from sawbench.modeling import slots
from sawbench.modeling import transient_kernel as kernel
from sawbench.modeling.compilation import runner
from sawbench.modeling.parameters import JigsawParameters
from sawbench.modeling.supplies import Supply
from sawbench.modeling.trajectory import (
    AT_REST,
    DEFAULT_METHOD,
    Floats,
    InitialState,
    Method,
    Trajectory,
    TransientStatus,
)
from sawbench.modeling.validation import positive

NO_TABLE: Floats = np.zeros((0, 4))


class Cutting(Protocol):
    """What a simulation needs of a cutting force."""

    def spline(self) -> Floats | None:
        """Spline of a force over the crank angle, shape (n, 4), or None."""
        ...

    def fill(self, vector: Floats) -> None:
        """Write the cutting slots into a parameter vector, in place."""
        ...


def battery_table(supply: Supply) -> Floats:
    """Return the battery's table, shape (n, 4); no rows where it has an equation or is absent."""
    table = None if supply.battery is None else supply.battery.ocv_table()
    return NO_TABLE if table is None else table


# Size: options by name, of the run and of the method.
def simulate(
    parameters: JigsawParameters,
    *,
    supply: Supply,
    cutting: Cutting,
    duration_s: float | None = None,
    rate_hz: float = 1000.0,
    time_s: ArrayLike | None = None,
    initial: InitialState = AT_REST,
    method: Method = DEFAULT_METHOD,
    compiles: bool = True,
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
    method : Method
    compiles : bool
        False has it interpreted: some 15 ms a second in place of 0.03 ms, without the ten seconds to compile it once.

    Raises
    ------
    InputError
        On times that do not increase, or a value out of its range.

    Examples
    --------
    >>> from sawbench.modeling.machines import paper_jigsaw as paper
    >>> from sawbench.modeling.supplies import FixedVoltage
    >>> run = simulate(paper.PARAMETERS, supply=FixedVoltage(voltage_v=paper.MOTOR_VOLTAGE_V),
    ...                cutting=paper.CUTTING, duration_s=1.0)
    >>> run.status, round(float(run.motor_current_a.max()), 2)
    ('ok', 34.73)
    """
    times = sample_times(duration_s, rate_hz, time_s)
    vector, spline, ocv = model_vector(parameters, supply, cutting)
    return run_vector(vector, spline, ocv, times, initial, method=method, compiles=compiles)


def model_vector(parameters: JigsawParameters, supply: Supply, cutting: Cutting) -> tuple[Floats, Floats, Floats]:
    """Return the parameter vector, the force spline and the battery table."""
    vector = parameters.to_vector()
    supply.fill(vector)
    cutting.fill(vector)
    spline = cutting.spline()
    return vector, NO_TABLE if spline is None else spline, battery_table(supply)


def run_vector(
    vector: Floats,
    spline: Floats,
    ocv: Floats,
    time_s: Floats,
    initial: InitialState = AT_REST,
    *,
    method: Method = DEFAULT_METHOD,
    compiles: bool = True,
) -> Trajectory:
    """Simulate a parameter vector; see `simulate`. No checks."""
    start = initial.to_state(vector[slots.GEAR])
    out = np.empty((4, len(time_s)))
    record = np.empty(kernel.N_RECORD)
    tolerances = (method.angle_tolerance, method.time_tolerance)
    n_steps = method.steps_per_turn if len(spline) == 0 else max(method.steps_per_turn, steps_for(spline, 16))
    run, numbers = runner(kernel.simulate_transient, vector, compiles)
    code = run(numbers, spline, ocv, time_s, start, n_steps, tolerances, out, record)
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
    )


def steps_for(spline: Floats | None, default: int) -> int:
    """Return the steps a turn: the default, or with a measured force one an interval (or two, or four).

    Steps that end on the nodes see a polynomial; steps that straddle them lose two orders, unseen by the
    embedded error estimate.

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
    kernel.OK: ("ok", "completed"),
    kernel.STALLED: (
        "stalled",
        "the crank stalls:  the motor cannot overcome the load at this supply (force_n, voltage_v)",
    ),
    kernel.NO_CONVERGENCE: (
        "not_converged",
        "the step size fell below 1 ps, or the maximum number of steps was reached",
    ),
    kernel.EMPTY: ("battery_empty", "the state of charge fell below 0"),
}


def sample_times(duration_s: float | None, rate_hz: float, time_s: ArrayLike | None) -> Floats:
    """Return checked sample times, shape (n,), s, from a duration and a rate or as given."""
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
