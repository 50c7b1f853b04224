"""Dry friction of the plunger in its guides: force F_c sgn(v) against the motion, at any load.

    m x'' = ... - F_c sgn(v) (1 + (s - 1) exp(-(v/v_s)^2))

The power F_c |v| is taken from the crank: torque F_c |lever| / gear at the motor, twice a stroke, also in
idle runs; the load cell does not see it. Positive amplitude: friction brakes, the motor draws more than the
baseline says. The Stribeck dip (static over kinetic friction s up to 2, v_s of some cm/s;
Armstrong-Helouvry, Dupont and Canudas de Wit 1994) bites beside the dead centres. Motor friction has no
lever, load friction vanishes in air. Range 0.5 to 20 N: assumed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from sawbench.bench.plain_digits import plain
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.effects.friction import PRESLIDING, direction, stribeck, through_play
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

if TYPE_CHECKING:
    from sawbench.modeling.machines.linear_axis import AxisBaseline, AxisState

# Below this blade velocity the sign is smoothed, m/s.
_SMOOTH_M_S = 0.01


def _signature(baseline: Baseline, state: State, static_ratio: float, stribeck_m_s: float) -> tuple[Signature, ...]:
    velocity = np.abs(baseline.blade_velocity(state))
    grip = np.tanh(velocity / _SMOOTH_M_S) * stribeck(velocity, static_ratio, stribeck_m_s)
    return ({"mechanical": np.abs(baseline.lever(state)) / baseline.gear * grip},)


@dataclass(frozen=True, kw_only=True, slots=True)
class _AxisForm:
    """Numbers of a form on an axis; lengths and speeds as shares of the travel and the top speed."""

    presliding: float = 0.0
    slope: float = 0.0
    static_ratio: float = 1.0
    stribeck_share: float = 1.0
    gap: float = 0.0
    spring: float = 0.0


def _axis_signature(axis: AxisBaseline, state: AxisState, form: _AxisForm) -> tuple[Signature, ...]:
    if form.spring > 0.0:
        return ({"mechanical": through_play(state, form.gap * axis.stroke_m, form.spring * axis.stroke_m)},)
    dip_m_s = form.stribeck_share * axis.top_speed_m_s
    grip = stribeck(np.abs(state.velocity_m_s), form.static_ratio, dip_m_s)
    place = (state.position_m - np.mean(state.position_m)) / (0.5 * axis.stroke_m)
    turning = direction(state, form.presliding * axis.stroke_m)
    return ({"mechanical": turning * grip * (1.0 + form.slope * place)},)


def _axis_form(axis: AxisBaseline, form: _AxisForm) -> str:
    if form.spring > 0.0:
        play = f"{plain(form.gap * axis.stroke_m, 'm')} of play and " if form.gap > 0.0 else ""
        return f"felt through {play}a spring of {plain(form.spring * axis.stroke_m, 'm')}"
    distance = plain(form.presliding * axis.stroke_m, "m")
    said = [f"turning round over a presliding distance of {distance}"] if form.presliding > 0.0 else []
    if form.slope:
        end = "larger" if form.slope > 0.0 else "smaller"
        said.append(f"{abs(form.slope):.0%} larger at the end of {end} displacement".replace("%", " %"))
    if form.static_ratio > 1.0:
        top = plain(form.stribeck_share * axis.top_speed_m_s, "m")
        said.append(f"{form.static_ratio:g} times as large at standstill as well above {top}/s")
    return " and ".join(said) or "the same at every speed"


def _on_axis(axis: AxisBaseline) -> Effect:
    """On an axis that its motor moves rigidly dry friction of the guide and of the motor are one term."""
    dip = [(s, v) for s in (1.5, 2.0) for v in (0.05, 0.3)]
    return replace(
        EFFECT,
        equation="F_c * sgn(v), with a Stribeck dip, presliding, or more at one end",
        strength=replace(EFFECT.strength, typical=0.2 * axis.force_scale_n, high=6.0),
        signature=lambda axis, state, **shape: _axis_signature(axis, state, _AxisForm(**shape)),
        shapes=(
            *({"presliding": p, "slope": k} for p in PRESLIDING for k in (0.0, 0.25, -0.25)),
            *(
                {"gap": g, "spring": s}
                for g in (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.33)
                for s in (0.01, 0.02, 0.05, 0.1, 0.2)
            ),
            *({"presliding": p, "static_ratio": s, "stribeck_share": v} for p in (0.0, 0.004, 0.012) for s, v in dip),
        ),
        scales=("stroke_m", "top_speed_m_s"),
        form_names={},
        form_words=lambda shape: _axis_form(axis, _AxisForm(**shape)),
        needs=(),
        confused_with=("load_dependent_friction", "windage_drag"),
        told_apart_by="a sweep of the cycle rate, with two loads",
        same_as=("motor_coulomb_friction",),
    )


EFFECT = Effect(
    name="guide_friction",
    place="mechanical",
    equation="F_c * sgn(v) on the plunger, with a Stribeck dip",
    words=Words(
        happens="dry friction between plunger and guides",
        measure="the force of a spring balance that pulls the plunger through its stroke, motor uncoupled",
        mend="clean, oil and align the guides",
    ),
    words_on={
        "linear_axis": Words(
            happens="dry friction of the axis",
            measure="the force of a spring balance that pulls the axis through its stroke, drive off",
            mend="clean, oil and align the guides; check seals and preload",
        )
    },
    parts=("guide",),
    strength=Strength(
        name="force_n",
        unit="N",
        typical=5.0,
        low=0.1,
        high=8.0,
        source="assumed",
        follows=lambda load: load.drive_n,
    ),
    signature=_signature,
    shapes=(
        {"static_ratio": 1.0, "stribeck_m_s": 0.1},
        *({"static_ratio": s, "stribeck_m_s": v} for s in (1.5, 2.0) for v in (0.03, 0.1, 0.3)),
    ),
    form_names={"coulomb": {"static_ratio": 1.0, "stribeck_m_s": 0.1}},
    needs=("motor_current_a",),
    confused_with=("motor_coulomb_friction", "load_dependent_friction", "yoke_backlash"),
    told_apart_by="idle runs: twice per stroke over the crank angle, the same at every load and speed",
    variants={"linear_axis": _on_axis},
)
