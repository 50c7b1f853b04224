"""Air drag of fan and rotor: torque c w^2 at the motor.

    J dw/dt = ... - tau_1000 (w / 1000 rad/s)^p,  p = 2 (laminar gaps and recirculation: 1.6 to 2.4)

Positive amplitude: the motor needs more current than the baseline says, the more the faster. Told from
viscous and Coulomb friction by a speed sweep in air. Fans of hand tools take 1 to 10 W of shaft power near
1000 rad/s, that is 1 to 10 mN*m: assumed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

if TYPE_CHECKING:
    from sawbench.modeling.machines.linear_axis import AxisBaseline, AxisState

_REFERENCE_RAD_S = 1000.0


def _signature(baseline: Baseline, state: State, power: float) -> tuple[Signature, ...]:
    speed = baseline.gear * state.speed_rad_s / _REFERENCE_RAD_S
    return ({"mechanical": _drag(speed, power)},)


def _drag(speed: Floats, power: float) -> Floats:
    """Against the motion, 1 at a speed of 1."""
    return np.sign(speed) * np.abs(speed) ** power


def _axis_signature(axis: AxisBaseline, state: AxisState, power: float) -> tuple[Signature, ...]:
    share = state.velocity_m_s / axis.top_speed_m_s
    return ({"mechanical": _drag(share, power)},)


def _on_axis(axis: AxisBaseline) -> Effect:
    typical_n = 0.1 * axis.force_scale_n
    return replace(
        EFFECT,
        equation="c * |v|^p * sgn(v)",
        strength=replace(EFFECT.strength, name="force_at_top_speed_n", unit="N", typical=typical_n, high=6.0),
        signature=_axis_signature,
        shapes=tuple({"power": p} for p in (2.0, 1.6, 2.4)),
        scales=("top_speed_m_s",),
        needs=(),
        confused_with=("guide_friction",),
        told_apart_by="a sweep of the cycle rate",
    )


EFFECT = Effect(
    name="windage_drag",
    place="mechanical",
    equation="c * w^2 on the motor shaft",
    words=Words(
        happens="air and fan brake the motor, the more the faster it runs",
        measure="the idle current at several speeds, with and without the fan",
        mend="check the fan and its duct",
    ),
    words_on={
        "linear_axis": Words(
            name="drag that grows with speed squared",
            happens="drag of air or oil on the axis grows with the square of its speed",
            measure="the force of the drive at several constant speeds",
            mend="check lubricant, seals and air gaps",
        )
    },
    parts=("drive",),
    strength=Strength(
        name="torque_at_1000_rad_s_n_m",
        unit="N*m",
        typical=0.006,
        low=0.1,
        high=8.0,
        source="assumed",
        follows=lambda load: load.torque_n_m / load.motor_speed_rad_s**2,
    ),
    signature=_signature,
    shapes=tuple({"power": p} for p in (2.0, 1.6, 1.8, 2.2, 2.4)),
    continuous=("power",),
    form_names={"quadratic": {"power": 2.0}},
    needs=("motor_current_a",),
    grows_with=("speed",),
    confused_with=("motor_coulomb_friction", "guide_friction"),
    told_apart_by="idle runs at several speeds",
    variants={"linear_axis": _on_axis},
)
