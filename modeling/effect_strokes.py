"""Periodic strokes with effects: at the baseline's speed where possible, else by the extended kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from modeling import extended_physics as physics
from modeling import frozen_effects as frozen
from modeling import periodic_kernel as kernel
from modeling import slots
from modeling.extended_stroke import StrokeMap, find_periodic
from modeling.extended_transient import scales
from modeling.transient import InitialState

Floats = NDArray[np.float64]
STROKE_TOLERANCE = 1e-8
MOST_CHIP_ROUNDS = 30


@dataclass(frozen=True, kw_only=True, slots=True)
class EffectStroke:
    """What a periodic stroke with effects leaves for the next question.

    Attributes
    ----------
    code : int
        As in `periodic_kernel`.
    kind : {"simple", "extended"}
    vector : ndarray, shape (N_SLOTS,)
        Effective vector of a simple stroke, the vector itself of an extended one.
    start : ndarray, shape (4,)
        Current, crank speed, blade force at angle 0, duration of a turn.
    period_s, motor_charge_a_s, battery_charge_a_s : float
    mean_rates : ndarray, shape (N_STATES,)
        Mean rates of the slow quantities, places as in `extended_physics`; 0 at the others.
    n_strokes, steps_per_turn : int
    """

    code: int
    kind: Literal["simple", "extended"]
    vector: Floats
    start: Floats
    period_s: float
    motor_charge_a_s: float
    battery_charge_a_s: float
    mean_rates: Floats
    n_strokes: int
    steps_per_turn: int


def effect_stroke(
    vector: Floats,
    spline: Floats,
    ocv: Floats,
    slow: InitialState,
    *,
    steps_per_turn: int,
    tolerance: float,
    accept: float = kernel.ACCEPT,
    guess: Floats | None = None,
) -> EffectStroke:
    """Find the periodic stroke with the slow quantities of `slow` held.

    Parameters
    ----------
    vector, spline, ocv : ndarray
        As in `steady_state.model_vector`.
    slow : InitialState
        Charge, temperature, RC voltages, distance cut; its angle, speed and current do not matter.
    steps_per_turn : int
        To begin with, of a simple stroke.
    tolerance : float
        Local error of a simple stroke's steps.
    accept : float
        Newton step that is the last, of a simple stroke.
    guess : ndarray, shape (4,), optional
        `start` of a stroke near by.
    """
    if frozen.is_simple(vector):
        return _simple(vector, spline, ocv, slow, steps_per_turn, tolerance, accept)
    return _extended(vector, spline, ocv, slow, steps_per_turn, guess)


def _steps_with_teeth(vector: Floats, steps_per_turn: int) -> int:
    """Enough steps to see every tooth go by: eight a tooth where the blade is fastest."""
    if vector[slots.TOOTH] == 0.0:
        return steps_per_turn
    wanted = 8 * 2 * np.pi * vector[slots.RADIUS] / vector[slots.TOOTH_PITCH]
    while steps_per_turn < wanted and steps_per_turn < 2048:
        steps_per_turn *= 2
    return steps_per_turn


def _simple(
    vector: Floats,
    spline: Floats,
    ocv: Floats,
    slow: InitialState,
    n_steps: int,
    tolerance: float,
    accept: float,
) -> EffectStroke:
    effective = np.empty_like(vector)
    result = np.zeros(kernel.N_PERIODIC)
    n_steps = _steps_with_teeth(vector, n_steps)
    sagged = slow.rc_voltage_v + slow.polarization_v
    turn_s = 2 * np.pi / (0.75 * scales(vector)[1])
    n_strokes = 0
    code = kernel.NOT_CONVERGED
    before: tuple[float, float] | None = None
    for _ in range(MOST_CHIP_ROUNDS):
        frozen.freeze(vector, slow.winding_temperature_rise_k, sagged, slow.cut_distance_m, turn_s, effective)
        code = kernel.periodic_state(effective, spline, ocv, slow.soc, n_steps, tolerance, accept, result)
        n_strokes += int(result[kernel.N_STROKES])
        if code != kernel.PERIODIC or vector[slots.CHIP_EXPONENT] == 0.0:
            break
        miss = result[kernel.PERIOD] - turn_s
        if abs(miss) < 1e-10 * turn_s:
            break
        # Secant steps on the chip's own period.
        rate = 0.3 if before is None else (miss - before[1]) / (turn_s - before[0]) + 1.0
        before = (turn_s, miss)
        turn_s += miss / (1.0 - rate)
    rates = np.zeros(physics.N_STATES)
    if code == kernel.PERIODIC:
        _simple_rates(vector, effective, spline, ocv, slow, result, rates)
    return EffectStroke(
        code=code,
        kind="simple",
        vector=effective,
        start=np.array([result[kernel.START_CURRENT], result[kernel.START_SPEED], 0.0, result[kernel.PERIOD]]),
        period_s=float(result[kernel.PERIOD]),
        motor_charge_a_s=float(result[kernel.MOTOR_CHARGE]),
        battery_charge_a_s=float(result[kernel.BATTERY_CHARGE]),
        mean_rates=rates,
        n_strokes=n_strokes,
        steps_per_turn=int(result[kernel.STEPS]),
    )


def _simple_rates(
    vector: Floats,
    effective: Floats,
    spline: Floats,
    ocv: Floats,
    slow: InitialState,
    result: Floats,
    rates: Floats,
) -> None:
    """Mean rates of the slow quantities over a simple stroke."""
    period = result[kernel.PERIOD]
    battery = result[kernel.BATTERY_CHARGE] / period
    if vector[slots.MODE] != slots.FIXED_VOLTAGE:
        rates[physics.SOC] = -battery / vector[slots.CAPACITY]
        drop = vector[slots.RC_RESISTANCE] * battery
        rates[physics.RC] = (drop - slow.rc_voltage_v) / vector[slots.RC_TIME]
        drop = vector[slots.POLARIZATION_RESISTANCE] * battery
        rates[physics.POLARIZATION] = (drop - slow.polarization_v) / vector[slots.POLARIZATION_TIME]
    rates[physics.DISTANCE] = 2.0 * vector[slots.RADIUS] / period
    if vector[slots.HEAT_CAPACITY] > 0.0:
        n = max(int(result[kernel.STEPS]), 32)
        current, speed = np.empty(n), np.empty(n)
        kernel.waveform(
            effective,
            spline,
            ocv,
            slow.soc,
            n,
            result[kernel.START_CURRENT],
            result[kernel.START_SPEED],
            current,
            speed,
        )
        square = float((current**2 / speed).sum() / (1.0 / speed).sum())
        cooled = slow.winding_temperature_rise_k / vector[slots.THERMAL_RESISTANCE]
        rates[physics.HEAT] = (effective[slots.RESISTANCE] * square - cooled) / vector[slots.HEAT_CAPACITY]


def frozen_state(slow: InitialState) -> Floats:
    """Return the slow quantities where the extended kernel wants them, shape (N_ALL,)."""
    state = np.zeros(physics.N_ALL)
    state[: physics.N_STATES] = slow.to_state(1.0)
    state[physics.CURRENT] = state[physics.SPEED] = state[physics.ANGLE] = state[physics.FORCE] = 0.0
    return state


def extended_map(vector: Floats, spline: Floats, ocv: Floats, slow: InitialState) -> StrokeMap:
    """Return the stroke of the extended machine with the slow quantities of `slow` held."""
    return StrokeMap(
        vector=vector,
        spline=spline,
        ocv=ocv,
        frozen=frozen_state(slow),
        scales=scales(vector),
        tolerance=STROKE_TOLERANCE,
    )


def _extended(
    vector: Floats, spline: Floats, ocv: Floats, slow: InitialState, n_steps: int, guess: Floats | None
) -> EffectStroke:
    if guess is None:
        guess = _start_without_them(vector, spline, ocv, slow, n_steps)
    stroke = extended_map(vector, spline, ocv, slow)
    code, x, end, n_strokes = find_periodic(stroke, guess)
    period = float(x[3])
    rates = np.zeros(physics.N_STATES)
    battery = 0.0
    if code == kernel.PERIODIC:
        rates[physics.SOC :] = (end - stroke.frozen)[physics.SOC : physics.N_STATES] / period
        rates[physics.FORCE] = 0.0
        battery = -rates[physics.SOC] * period * vector[slots.CAPACITY]
    return EffectStroke(
        code=code,
        kind="extended",
        vector=vector,
        start=x,
        period_s=period,
        motor_charge_a_s=float(end[physics.MOTOR_CHARGE]),
        battery_charge_a_s=float(battery),
        mean_rates=rates,
        n_strokes=n_strokes,
        steps_per_turn=n_steps,
    )


def without_extended(vector: Floats) -> Floats:
    """Return a vector without the effects that only the extended kernel knows."""
    plain = vector.copy()
    plain[slots.EXPONENT] = 1.0
    plain[slots.GUIDE_STATIC] = 0.0
    for place in (slots.COMPLIANCE, slots.CURRENT_LIMIT, slots.BACKLASH, slots.ENGAGEMENT):
        plain[place] = 0.0
    return plain


def _start_without_them(vector: Floats, spline: Floats, ocv: Floats, slow: InitialState, n_steps: int) -> Floats:
    """Start of the stroke without the effects that make it extended."""
    stroke = _simple(without_extended(vector), spline, ocv, slow, n_steps, np.inf, kernel.ACCEPT)
    if stroke.code == kernel.PERIODIC:
        return stroke.start
    current, speed = scales(vector)
    return np.array([0.2 * current, 0.7 * speed, 0.0, 2 * np.pi / (0.7 * speed)])
