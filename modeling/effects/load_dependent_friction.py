"""Friction in gear and yoke that grows with what they carry: torque mu |load torque| at the motor.

    J dw/dt = ... - mu |T_load|,   T_load = F lever / gear

Positive amplitude: the motor needs more current under load than the measured force explains; nothing in
air. Forms: gear mesh (tooth load = load torque, with or without the inertia of the plunger, which the teeth
carry too), sliding pair under the mechanism's side force (block in the yoke's slot, |pin force| r |cos(angle)|;
of a slider-crank the guide, which the rod presses on by the tangent of its angle), crank pin bearing (|pin
force| r_pin, here 0.3 r). A wrong torque constant is confounded under load but also shows in idle runs and at
spin-up. Spur gears lose some per cent a mesh, greased or dry sliding pairs have mu = 0.05 to 0.15: assumed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.effects.friction import PRESLIDING, direction
from sawbench.modeling.residuals import Baseline, Signature, inertia_torque, plunger_acceleration
from sawbench.modeling.state import State

if TYPE_CHECKING:
    from sawbench.modeling.machines.linear_axis import AxisBaseline, AxisState

_PIN_SHARE_OF_RADIUS = 0.3


def _signature(baseline: Baseline, state: State, inertia: float, slot: float, pin: float) -> tuple[Signature, ...]:
    if state.setting.is_idle and inertia == 0.0:
        return ({},)
    force = np.zeros_like(state.angle_rad) if state.force_n is None or state.setting.is_idle else state.force_n
    if slot == 0.0 and pin == 0.0:
        mass = baseline.plant.reciprocating_mass_kg.nominal
        torque = baseline.load_torque(state, force) + inertia * inertia_torque(baseline, state, mass=mass)
        return ({"mechanical": np.abs(torque)},)
    lever_m = slot * baseline.mechanism.sliding_lever(state.angle_rad) + pin * _PIN_SHARE_OF_RADIUS * baseline.radius_m
    inertia_n = baseline.plant.reciprocating_mass_kg.nominal * plunger_acceleration(baseline.mechanism, state)
    carried = np.abs(baseline.cutting_sign * force + inertia * inertia_n)
    return ({"mechanical": carried * lever_m / baseline.gear},)


def _axis_signature(axis: AxisBaseline, state: AxisState, presliding: float) -> tuple[Signature, ...]:
    if state.force_n is None:
        return ({},)
    return ({"mechanical": np.abs(state.force_n) * direction(state, presliding * axis.stroke_m)},)


def _on_axis(_: AxisBaseline) -> Effect:
    return replace(
        EFFECT,
        equation="mu * |F_load| * sgn(v)",
        strength=replace(EFFECT.strength, typical=0.1, high=6.0),
        signature=_axis_signature,
        shapes=tuple({"presliding": p} for p in PRESLIDING),
        scales=("stroke_m",),
        needs=(),
        confused_with=("guide_friction",),
        told_apart_by="the same rate with two loads, one of them none",
    )


EFFECT = Effect(
    name="load_dependent_friction",
    place="mechanical",
    equation="mu * |load torque|",
    words=Words(
        happens="gear and yoke rub the harder they are loaded",
        measure="the motor current with a known weight hung on the plunger, moving up and down",
        mend="check lubrication of gear, yoke slot and crank pin",
    ),
    words_on={
        "linear_axis": Words(
            happens="drive and guides rub the harder they are loaded",
            measure="the force of the drive with known loads, moving back and forth",
            mend="check the lubrication of drive and guides",
        )
    },
    parts=("drive", "load"),
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
    variants={"linear_axis": _on_axis},
)
