"""A gear off its centre: once a crank turn the drag, or the transmission ratio, swings.

    torque form:     J dw/dt = ... - a sin(angle + psi)
    kinematic form:  motor speed = gear * crank speed * (1 + e cos(angle + psi))
    both:            each with its own size and phase

A gear that is off its centre does both; which is felt depends on the backlash and on the bearing. In the kinematic form
the baseline, which knows the crank alone, misses back-EMF (k_e times the swing of the motor speed) and the torque that
swings the rotor, and the load reaches the motor through the other ratio. Free phase: sine and cosine part. One unit of
the kinematic form is e = 1 per N*m, so that 0.003 stands for 3 mN*m or for 0.3 %. Once a stroke, also in idle runs,
where cutting cannot cause it. Radial runout of hobbed gears of this size is 20 to 60 um (classes of ISO 1328), 0.1 to
0.5 % of the radius; torque: assumed.
"""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature, motor_ahead
from sawbench.modeling.state import State


def _signature(baseline: Baseline, state: State, kinematic: float, torque: float = 0.0) -> tuple[Signature, ...]:
    sine, cosine = np.sin(state.angle_rad), np.cos(state.angle_rad)
    drags: tuple[Signature, ...] = ({"mechanical": sine}, {"mechanical": cosine})
    if kinematic == 0.0:
        return drags
    swings = _swing(baseline, state, sine, cosine), _swing(baseline, state, cosine, -sine)
    return (*drags, *swings) if torque else swings


def _swing(baseline: Baseline, state: State, wave: Floats, slope: Floats) -> Signature:
    """Residuals where the ratio swings by `wave`, whose derivative with the crank angle is `slope`."""
    extra_speed = baseline.gear * state.speed_rad_s * wave
    extra_acceleration = baseline.gear * (state.acceleration_rad_s2 * wave + state.speed_rad_s**2 * slope)
    load = 0.0 if state.force_n is None else baseline.load_torque(state, state.force_n)
    ahead = motor_ahead(baseline, extra_speed, extra_acceleration)
    loaded: Signature = {"mechanical": ahead["mechanical"] - load * wave}
    return ahead | loaded


EFFECT = Effect(
    name="gear_eccentricity",
    place="mechanical",
    equation="a * sin(angle + psi) at the motor",
    words=Words(
        happens="runout of the gear wheel",
        measure="the radial runout of the gear wheel with a dial gauge",
        mend="measure the runout of the gear wheel",
    ),
    parts=("motor", "gear", "crank"),
    strength=Strength(
        name="torque_n_m",
        unit="N*m",
        typical=0.0075,
        low=0.1,
        high=8.0,
        source="assumed: a tenth of the mean torque; ISO 1328",
        follows=lambda load: load.torque_n_m,
    ),
    signature=_signature,
    n_signatures=lambda shape: 4 if "torque" in shape else 2,
    shapes=({"kinematic": 0.0}, {"kinematic": 1.0}, {"kinematic": 1.0, "torque": 1.0}),
    leading=2,
    needs=("motor_current_a",),
    confused_with=("yoke_backlash",),
    told_apart_by="idle runs: once per stroke without load",
)
