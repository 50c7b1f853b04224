"""Pins and bearings between crank and plunger that yield: it is behind the crank by the force over a stiffness.

The angle of the crank is told from the plunger, so that the motor seems to be ahead of it while the blade cuts: by the
wave that the regression of the displacement finds in what the plunger is behind by (`processing.stroke_ripple`). A
linear cut holds it back by an angle that is even over the cutting half, and is none on the way back: its edges lie at
the dead centres, where the torque of inertia shows them. Some hundredths of a millimetre are ordinary, and no gap of
the saw. What yields by far more is play of the yoke or a shaft that twists (`diagnosis.inference.beyond.drive`).
"""

from __future__ import annotations

from typing import Final

from sawbench.diagnosis.inference.nuisance import Nuisance
from sawbench.modeling.residuals import Baseline, Signature, is_angle_known, motor_ahead
from sawbench.modeling.state import State, angle_derivative
from sawbench.processing.stroke_ripple import wave_seen

# Assumed: 5 N a micrometre, of pin, bearings and guide one behind the other.
_STD_M_PER_N: Final = 2e-7


def yielding_plunger() -> Nuisance:
    """Return what a plunger that yields may take off the balances, in m/N."""
    return Nuisance(
        name="compliance of the plunger's drive",
        nominal=0.0,
        std=_STD_M_PER_N,
        is_plant=False,
        signature=_held_back,
    )


def _held_back(baseline: Baseline, state: State) -> Signature:
    if state.kind != "running" or state.force_n is None or not is_angle_known(state):
        return {}
    back_m = -baseline.cutting_sign * state.force_n
    behind_rad = -wave_seen(baseline.mechanism, state.angle_rad[0], back_m)
    speed = baseline.gear * state.speed_rad_s * angle_derivative(behind_rad)
    return motor_ahead(baseline, speed, state.speed_rad_s * angle_derivative(speed))
