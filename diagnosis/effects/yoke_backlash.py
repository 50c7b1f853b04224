"""Play between crank pin and yoke: a dead band of 0.1 to 0.5 mm in which the pin does not carry the plunger.

The pin pushes with m x'' + F; where that force changes sign, the plunger crosses the gap: in air near mid
stroke (inertia), under a cut near the dead centres, and where friction holds the plunger, right after them.
Meanwhile the pin is free of m x'' + F, afterwards it takes the impact (mechanical residual); the force
follows the plunger, not the pin (cutting residual); and the displacement sensor, which sits on the plunger,
makes the crank angle and its speed swing although the crank does not: back-EMF and inertia torque of the
baseline go with the wrong speed, by far the largest trace. All fixed in angle. The motion is computed without
bounce: free flight, flight braked by guide friction, plunger held by it. Clearance and wear: assumed.
"""

from __future__ import annotations

import numpy as np

from bench.recording import Floats
from diagnosis.effects.effect import Effect, Strength
from diagnosis.effects.plunger_play import plunger_motion, tracked_angle
from diagnosis.equations import Baseline, Signature
from diagnosis.reduction import angle_derivative
from diagnosis.state import TWO_PI, State

_SPEED_HARMONICS = 4
_GAPS_M = (1e-4, 1.6e-4, 2.4e-4, 3.5e-4, 5e-4)
# Guide friction that steers the plunger in the gap: none, parts of its inertia force, holding it.
_FRICTIONS_N = (0.0, 4.0, 8.0, 14.0, 1e6)


def _signature(baseline: Baseline, state: State, gap_m: float, friction_n: float) -> tuple[Signature, ...]:
    if state.kind != "running" or state.current_a is None or state.current_rate_a_s is None:
        return ({},)
    plant, gear, radius = baseline.plant, baseline.gear, baseline.radius_m
    speed = _speed_from_back_emf(baseline, state, state.current_a, state.current_rate_a_s)
    damping = float(np.mean(state.slow["k_guess_n_s_per_m"]))
    mass, sign = plant.reciprocating_mass_kg.nominal, baseline.cutting_sign
    motion = plunger_motion(
        speed, gap_m=gap_m, radius_m=radius, mass_kg=mass, damping_n_s_per_m=damping, cutting_sign=sign,
        friction_n=friction_n,
    )  # fmt: skip
    angle = (np.arange(len(speed)) + 0.5) * TWO_PI / len(speed)
    deviation = tracked_angle(motion.position_m)
    read = angle + deviation
    excess_speed = speed * angle_derivative(deviation)
    excess_acceleration = speed * angle_derivative(excess_speed)
    read_speed = speed + excess_speed
    read_acceleration = speed * angle_derivative(speed) + excess_acceleration
    sine, cosine = np.sin(read), np.cos(read)
    force = damping * np.maximum(sign * motion.velocity_m_s, 0.0)
    carried = mass * radius * (sine * read_acceleration + cosine * read_speed**2) + sign * force
    turning = plant.rotor_inertia_kg_m2.nominal * gear + plant.yoke_inertia_kg_m2.nominal / gear
    found: Signature = {
        "electrical": -plant.back_emf_constant_v_s_per_rad.nominal * gear * excess_speed,
        "mechanical": (motion.pin_force_n * np.sin(angle) - carried * sine) * radius / gear
        - turning * excess_acceleration
        - plant.motor_damping_n_m_s_per_rad.nominal * gear * excess_speed,
        "cutting": force - damping * np.maximum(sign * radius * read_speed * sine, 0.0),
    }
    return ({name: np.interp(state.angle_rad, read, wave, period=TWO_PI) for name, wave in found.items()},)


def _speed_from_back_emf(baseline: Baseline, state: State, current_a: Floats, rate_a_s: Floats) -> Floats:
    """Crank speed over the turn, shape (n_points,), free of the swing that play puts into displacement."""
    plant = baseline.plant
    drop_v = plant.resistance_ohm.nominal * current_a + plant.inductance_h.nominal * rate_a_s
    spectrum = np.fft.rfft((state.motor_voltage_v - drop_v).mean(axis=0))
    spectrum[_SPEED_HARMONICS + 1 :] = 0.0
    n_points = state.angle_rad.shape[-1]
    ripple = np.fft.irfft(spectrum, n_points) / max(float(spectrum[0].real) / n_points, 1e-6)
    ripple = np.clip(ripple, 0.3, 3.0)
    # The duration of a turn is right whatever the play.
    slowness = float(np.mean(1.0 / state.speed_rad_s))
    return ripple * np.float64(np.mean(1.0 / ripple) / slowness)


EFFECT = Effect(
    name="yoke_backlash",
    place="mechanical",
    equation="plunger free within a gap around the crank pin",
    strength=Strength(name="gap_m", unit="m", typical=1.0, low=0.7, high=1.4, source="assumed"),
    signature=_signature,
    shapes=tuple({"gap_m": g, "friction_n": f} for g in _GAPS_M for f in _FRICTIONS_N),
    shape_strength=lambda amplitude, shape: amplitude * shape["gap_m"],
    needs=("motor_current_a",),
    grows_with=("position",),
    confused_with=("gear_eccentricity", "engagement_delay", "guide_friction"),
    told_apart_by="idle against cutting: fixed in angle, not in time, and the displacement itself is bent",
)
