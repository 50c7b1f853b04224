"""A periodic stroke over the crank angle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from modeling import periodic_kernel as kernel
from modeling import slots

if TYPE_CHECKING:
    from modeling.steady_state import PeriodicState

Floats = NDArray[np.float64]


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


def simple_waveform(state: PeriodicState, n_points: int) -> Waveform:
    """Sample a stroke of the baseline, or of an effective vector."""
    from modeling.output_kernel import blade, simple_forces

    factor = -(-state.steps_per_turn // n_points)
    n_fine = n_points * factor
    current, speed = np.zeros(n_fine), np.zeros(n_fine)
    vector = state.vector if state.stroke is None else state.stroke.vector
    gear = vector[slots.GEAR]
    if state.status == "ok":
        w = state.start_motor_speed_rad_s / gear
        kernel.waveform(vector, state.spline, state.ocv, state.soc, n_fine, state.start_current_a, w, current, speed)
    angle = 2 * np.pi * np.arange(n_points) / n_points
    motor_speed = np.ascontiguousarray(speed[::factor]) * gear
    displacement, velocity, force = blade(vector, state.spline, angle, motor_speed)
    if state.stroke is not None:
        force = simple_forces(vector, state.spline, angle, motor_speed)
    return Waveform(
        crank_angle_rad=angle,
        motor_current_a=np.ascontiguousarray(current[::factor]),
        motor_speed_rad_s=motor_speed,
        displacement_m=displacement,
        blade_velocity_m_s=velocity,
        force_n=force,
    )


def extended_waveform(state: PeriodicState, n_points: int) -> Waveform:
    """Sample a stroke of the extended machine."""
    from modeling.effect_strokes import extended_map
    from modeling.extended_stroke import waveform
    from modeling.output_kernel import play_velocity

    assert state.stroke is not None
    out, seen = np.zeros((4, n_points)), np.zeros((5, n_points))
    if state.status == "ok":
        stroke = extended_map(state.vector, state.spline, state.ocv, replace(state.slow, soc=state.soc))
        out, seen = waveform(stroke, state.stroke.start, state.period_s, n_points)
    return Waveform(
        crank_angle_rad=2 * np.pi * np.arange(n_points) / n_points,
        motor_current_a=out[0],
        motor_speed_rad_s=out[1],
        displacement_m=seen[1],
        blade_velocity_m_s=play_velocity(state.vector, out[2], out[1]),
        force_n=seen[0],
    )
