"""Friction in gear and yoke that grows with what they carry: torque mu |load torque| at the motor.

    J dw/dt = ... - mu |T_load|,   T_load = F r sin(angle) / gear

Positive amplitude: the motor needs more current under load than the measured force explains; nothing in
air. Forms: gear mesh (tooth load = load torque, with or without the inertia of the plunger, which the teeth
carry too), sliding block in the yoke's slot (|pin force| r |cos(angle)|), crank pin bearing (|pin force|
r_pin, here 0.3 r). A wrong torque constant looks alike under load but also shows in idle runs and at
spin-up. Spur gears lose some per cent a mesh, greased or dry sliding pairs have mu = 0.05 to 0.15: assumed.
"""

from __future__ import annotations

import numpy as np

from bench.recording import Floats
from diagnosis.effects.effect import Effect, Strength
from diagnosis.equations import Baseline, Signature, inertia_torque
from diagnosis.state import State

_PIN_SHARE_OF_RADIUS = 0.3


def _signature(baseline: Baseline, state: State, inertia: float, slot: float, pin: float) -> tuple[Signature, ...]:
    if state.setting.is_idle and inertia == 0.0:
        return ({},)
    force = np.zeros_like(state.angle_rad) if state.force_n is None or state.setting.is_idle else state.force_n
    if slot == 0.0 and pin == 0.0:
        mass = baseline.plant.reciprocating_mass_kg.nominal
        torque = baseline.load_torque(state, force) + inertia * inertia_torque(baseline, state, mass=mass)
        return ({"mechanical": np.abs(torque)},)
    lever_m = baseline.radius_m * (slot * np.abs(np.cos(state.angle_rad)) + pin * _PIN_SHARE_OF_RADIUS)
    carried = np.abs(baseline.cutting_sign * force + inertia * _plunger_inertia_n(baseline, state))
    return ({"mechanical": carried * lever_m / baseline.gear},)


def _plunger_inertia_n(baseline: Baseline, state: State) -> Floats:
    sine, cosine = np.sin(state.angle_rad), np.cos(state.angle_rad)
    acceleration = baseline.radius_m * (sine * state.acceleration_rad_s2 + cosine * state.speed_rad_s**2)
    return baseline.plant.reciprocating_mass_kg.nominal * acceleration


EFFECT = Effect(
    name="load_dependent_friction",
    place="mechanical",
    equation="mu * |load torque|",
    strength=Strength(
        name="friction_share",
        unit="1",
        typical=0.08,
        low=0.1,
        high=4.0,
        source="assumed",
    ),
    signature=_signature,
    shapes=(
        {"inertia": 0.0, "slot": 0.0, "pin": 0.0},
        {"inertia": 1.0, "slot": 0.0, "pin": 0.0},
        {"inertia": 1.0, "slot": 1.0, "pin": 0.0},
        {"inertia": 1.0, "slot": 0.0, "pin": 1.0},
    ),
    needs=("motor_current_a", "force_n"),
    grows_with=("load",),
    confused_with=("guide_friction", "motor_coulomb_friction"),
    told_apart_by="idle against cutting; idle runs and a spin-up fix the torque constant",
)
