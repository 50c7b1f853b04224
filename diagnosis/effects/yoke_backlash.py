"""Play between crank pin and yoke: a dead band of 0.1 to 0.5 mm in which the pin does not carry the plunger.

The pin pushes with m x'' + F; where that force changes sign, the plunger crosses the gap: in air near mid
stroke (inertia), under a cut near the dead centres, and where friction holds the plunger, right after them.
Meanwhile the pin is free of m x'' + F, afterwards it takes the impact (mechanical residual); the force
follows the plunger, not the pin (cutting residual); and the displacement sensor, which sits on the plunger,
makes the crank angle and its speed swing although the crank does not (back-EMF and inertia of the baseline
go with the wrong speed). All fixed in angle. The motion is computed for two cases: free flight without
bounce, plunger held by friction. Range: usual clearance fits plus wear, assumed.
"""

from __future__ import annotations

import numpy as np

from diagnosis.effects.effect import Effect, Strength
from diagnosis.effects.plunger_play import plunger_motion, tracked_angle
from diagnosis.equations import Baseline, Signature
from diagnosis.reduction import angle_derivative
from diagnosis.state import TWO_PI, State

_GAPS_M = (1e-4, 1.5e-4, 2e-4, 3e-4, 4e-4, 5e-4)


def _signature(baseline: Baseline, state: State, gap_m: float, held: float) -> tuple[Signature, ...]:
    if state.kind != "running":
        return ({},)
    plant, gear, radius = baseline.plant, baseline.gear, baseline.radius_m
    speed = state.speed_rad_s.mean(axis=0)
    damping = float(np.mean(state.slow["k_guess_n_s_per_m"]))
    mass, sign = plant.reciprocating_mass_kg.nominal, baseline.cutting_sign
    motion = plunger_motion(
        speed, gap_m=gap_m, radius_m=radius, mass_kg=mass, damping_n_s_per_m=damping, cutting_sign=sign,
        is_held=bool(held),
    )  # fmt: skip
    angle = (np.arange(len(speed)) + 0.5) * TWO_PI / len(speed)
    deviation = tracked_angle(motion.position_m)
    read = angle + deviation
    read_speed = speed * (1.0 + angle_derivative(deviation))
    excess_speed = read_speed - speed
    excess_acceleration = speed * angle_derivative(excess_speed)
    read_acceleration = speed * angle_derivative(speed) + excess_acceleration
    sine, cosine = np.sin(read), np.cos(read)
    force = damping * np.maximum(sign * motion.velocity_m_s, 0.0)
    carried = mass * radius * (sine * read_acceleration + cosine * read_speed**2) + sign * force
    turning = plant.rotor_inertia_kg_m2.nominal * gear + plant.yoke_inertia_kg_m2.nominal / gear
    found: Signature = {
        "electrical": -plant.back_emf_constant_v_s_per_rad.nominal * gear * excess_speed,
        "mechanical": motion.pin_force_n * radius * np.sin(angle) / gear
        - carried * radius * sine / gear
        - turning * excess_acceleration
        - plant.motor_damping_n_m_s_per_rad.nominal * gear * excess_speed,
        "cutting": force - damping * np.maximum(sign * radius * read_speed * sine, 0.0),
    }
    grid = state.angle_rad
    return ({name: np.interp(grid, read, wave, period=TWO_PI) for name, wave in found.items()},)


EFFECT = Effect(
    name="yoke_backlash",
    place="mechanical",
    equation="plunger free within a gap around the crank pin",
    strength=Strength(name="gap_m", unit="m", typical=1.0, low=0.7, high=1.4, source="assumed"),
    signature=_signature,
    shapes=tuple({"gap_m": g, "held": h} for g in _GAPS_M for h in (0.0, 1.0)),
    shape_strength=lambda amplitude, shape: amplitude * shape["gap_m"],
    needs=("motor_current_a",),
    grows_with=("position",),
    confused_with=("gear_eccentricity", "engagement_delay", "guide_friction"),
    told_apart_by="idle against cutting: fixed in angle, not in time, and the displacement itself is bent",
)
