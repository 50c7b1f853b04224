"""Derivatives of runs and periodic strokes with respect to any slot: plant, k_Fc, supply, effects.

Central differences of fourth order over the model itself, on steps that do not adapt to the parameter: the
angle steps are fixed, the time steps near rest have a tolerance of 1e-12. So the difference sees the
derivative of the discrete solution and hardly any noise of the step control. Why differences and not
variational equations: they hold for every slot and every effect alike, need no second set of equations that
could disagree with the first, and batches over the perturbations use both cores. Measured against fourth
differences of a 1e-13 reference integrator the derivatives are good to 1e-6 of their largest value (see the
tests).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.errors import InputError
from modeling import slots
from modeling.parameters import JigsawParameters
from modeling.steady_state import model_vector, periodic_effects, periodic_vector
from modeling.supplies import Supply
from modeling.transient import AT_REST, Cutting, InitialState, Method, run_vector, sample_times, steps_for

Floats = NDArray[np.float64]
RUN_STEP = 2e-5
STROKE_STEP = 1e-3
STROKE_STEPS_PER_TURN = 64
WEIGHTS = ((-2.0, 1.0 / 12.0), (-1.0, -2.0 / 3.0), (1.0, 2.0 / 3.0), (2.0, -1.0 / 12.0))
ONE_SIDED = ((0.0, -25.0 / 12.0), (1.0, 4.0), (2.0, -3.0), (3.0, 4.0 / 3.0), (4.0, -1.0 / 4.0))


@dataclass(frozen=True, kw_only=True, slots=True)
class RunSensitivity:
    """Derivatives of a run with respect to one slot, per unit of the slot; every array has shape (n,).

    Attributes
    ----------
    motor_current, motor_speed, crank_angle, force : ndarray
        A, rad/s, rad and N per unit of the slot.
    """

    motor_current: Floats
    motor_speed: Floats
    crank_angle: Floats
    force: Floats


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeSensitivity:
    """Derivatives of a periodic stroke with respect to one slot, per unit of the slot.

    Attributes
    ----------
    period_s, mean_motor_current, mean_battery_current : float
    motor_current, motor_speed, force : ndarray, shape (n_points,)
        At equal crank angles from 0 on.
    """

    period_s: float
    mean_motor_current: float
    mean_battery_current: float
    motor_current: Floats
    motor_speed: Floats
    force: Floats


def run_sensitivities(
    parameters: JigsawParameters,
    names: Sequence[str],
    *,
    supply: Supply,
    cutting: Cutting,
    duration_s: float | None = None,
    rate_hz: float = 1000.0,
    time_s: ArrayLike | None = None,
    initial: InitialState = AT_REST,
    effects: Mapping[str, float] | None = None,
) -> dict[str, RunSensitivity]:
    """Differentiate a run with respect to slots; arguments as in `simulate`, names as in `slots.NAMES`.

    Raises
    ------
    InputError
        On an unknown slot, or a run that does not end in status "ok".

    Examples
    --------
    >>> from modeling.parameter_sets import paper_jigsaw as paper
    >>> from modeling.supplies import FixedVoltage
    >>> found = run_sensitivities(paper.PARAMETERS, ["k_fc_n_s_per_m"], supply=FixedVoltage(voltage_v=7.875),
    ...                           cutting=paper.CUTTING, duration_s=0.2)
    >>> bool(found["k_fc_n_s_per_m"].crank_angle[-1] < 0)  # a harder cut is slower
    True
    """
    times = sample_times(duration_s, rate_hz, time_s)
    vector, spline, ocv, _ = model_vector(parameters, supply, cutting, effects)
    coarse = run_vector(vector, spline, ocv, times, initial)
    if coarse.status not in ("ok", "battery_empty"):
        raise InputError(f"the run to differentiate is {coarse.status}: {coarse.message}")
    n_steps = steps_for(spline, 64)
    method = Method(steps_per_turn=n_steps, angle_tolerance=np.inf, time_tolerance=1e-12)

    def run(changed: Floats) -> Floats:
        done = run_vector(changed, spline, ocv, times, initial, method=method)
        return np.array([done.motor_current_a, done.motor_speed_rad_s, done.crank_angle_rad, done.force_n])

    found = {}
    for name in names:
        current, speed, angle, force = _difference(vector, name, run, RUN_STEP)
        found[name] = RunSensitivity(motor_current=current, motor_speed=speed, crank_angle=angle, force=force)
    return found


def stroke_sensitivities(
    parameters: JigsawParameters,
    names: Sequence[str],
    *,
    supply: Supply,
    cutting: Cutting,
    soc: float = 1.0,
    slow: InitialState = AT_REST,
    effects: Mapping[str, float] | None = None,
    n_points: int = 64,
) -> dict[str, StrokeSensitivity]:
    """Differentiate the periodic stroke with respect to slots; arguments as in `steady_state`.

    Raises
    ------
    InputError
        On an unknown slot, or where there is no periodic stroke.
    """
    vector, spline, ocv, has_effects = model_vector(parameters, supply, cutting, effects)
    held = InitialState(
        soc=soc,
        winding_temperature_rise_k=slow.winding_temperature_rise_k,
        rc_voltage_v=slow.rc_voltage_v,
        polarization_v=slow.polarization_v,
        cut_distance_m=slow.cut_distance_m,
    )
    n_steps = steps_for(spline, STROKE_STEPS_PER_TURN)

    def stroke(changed: Floats) -> Floats:
        settings = {"steps_per_turn": n_steps, "tolerance": np.inf, "accept": 1e-6}
        if has_effects or slots.needs_extended(changed) or not slow.is_baseline:
            state = periodic_effects(changed, spline, ocv, held, **settings)
        else:
            state = periodic_vector(changed, spline, ocv, soc=soc, **settings)
        if state.status != "ok":
            raise InputError(f"no periodic stroke to differentiate: {state.message}")
        wave = state.waveform(n_points)
        means = [state.period_s, state.mean_motor_current_a, state.mean_battery_current_a]
        return np.concatenate([means, wave.motor_current_a, wave.motor_speed_rad_s, wave.force_n])

    found = {}
    for name in names:
        slope = _difference(vector, name, stroke, STROKE_STEP)
        current, speed, force = slope[3:].reshape(3, n_points)
        found[name] = StrokeSensitivity(
            period_s=float(slope[0]),
            mean_motor_current=float(slope[1]),
            mean_battery_current=float(slope[2]),
            motor_current=current,
            motor_speed=speed,
            force=force,
        )
    return found


def _difference(vector: Floats, name: str, run, relative_step: float) -> Floats:
    """Fourth-order difference of `run` by one slot; one-sided at the end of the slot's range."""
    if name not in slots.INDEX:
        raise InputError(f"unknown slot {name!r}", remedy=f"one of {', '.join(slots.NAMES)}")
    place = slots.INDEX[name]
    size = max(abs(vector[place]), slots.TYPICAL.get(name, 0.0))
    if size == 0.0:
        raise InputError(f"{name} is 0 and has no typical size to take a step of")
    step = relative_step * size
    at_end = vector[place] == 0.0 and name in slots.NOT_NEGATIVE
    total: Floats | None = None
    for away, weight in ONE_SIDED if at_end else WEIGHTS:
        changed = vector.copy()
        changed[place] += away * step
        part = weight * run(changed)
        total = part if total is None else total + part
    assert total is not None
    return total / step
