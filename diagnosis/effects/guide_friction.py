"""Dry friction of the plunger in its guides: force F_c sgn(v) against the motion, whatever the load.

    m x'' = ... - F_c sgn(v) (1 + (s - 1) exp(-(v/v_s)^2))

The power F_c |v| is taken from the crank: torque F_c r |sin(angle)| / gear at the motor, twice a stroke,
also in idle runs; the load cell does not see it. Positive amplitude: friction brakes, the motor draws more
than the baseline says. The Stribeck dip (static over kinetic friction s up to 2, v_s of some cm/s;
Armstrong-Helouvry, Dupont and Canudas de Wit 1994) bites beside the dead centres. Motor friction has no
|sin|, load friction vanishes in air. Range 0.5 to 20 N: assumed.
"""

from __future__ import annotations

import numpy as np

from diagnosis.effects.effect import Effect, Strength
from diagnosis.equations import Baseline, Signature
from diagnosis.state import State

# Below this blade velocity the sign is smoothed, m/s.
_SMOOTH_M_S = 0.01


def _signature(baseline: Baseline, state: State, static_ratio: float, stribeck_m_s: float) -> tuple[Signature, ...]:
    velocity = np.abs(baseline.blade_velocity(state))
    grip = np.tanh(velocity / _SMOOTH_M_S) * (1.0 + (static_ratio - 1.0) * np.exp(-((velocity / stribeck_m_s) ** 2)))
    lever_m = baseline.radius_m * np.abs(np.sin(state.angle_rad)) / baseline.gear
    return ({"mechanical": lever_m * grip},)


EFFECT = Effect(
    name="guide_friction",
    place="mechanical",
    equation="F_c * sgn(v) on the plunger, with a Stribeck dip",
    strength=Strength(name="force_n", unit="N", typical=5.0, low=0.1, high=4.0, source="assumed"),
    signature=_signature,
    shapes=(
        {"static_ratio": 1.0, "stribeck_m_s": 0.1},
        *({"static_ratio": s, "stribeck_m_s": v} for s in (1.5, 2.0) for v in (0.03, 0.1, 0.3)),
    ),
    needs=("motor_current_a",),
    confused_with=("motor_coulomb_friction", "load_dependent_friction", "yoke_backlash"),
    told_apart_by="idle runs: twice a stroke over the crank angle, the same at every load and speed",
)
