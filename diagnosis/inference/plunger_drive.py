"""Pins and bearings between crank and plunger: they yield, and run in their fits with some play.

The plunger is behind the pin of the crank by the force between them over a stiffness, and by half of the clearance, on
the side that the pin pushes from. The angle of the crank is told from the plunger, so that the motor seems to turn
unevenly: by the wave that the regression of the displacement finds in what the plunger is behind by
(`processing.stroke_ripple`). Its edges lie where the force begins, ends, or changes its sign, and the torque of inertia
shows them. Some hundredths of a millimetre are ordinary, and no gap of the saw. What is far more is play of the yoke or
a shaft that twists (`diagnosis.inference.beyond.drive`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.nuisance import Nuisance
from sawbench.modeling.residuals import Baseline, Signature, is_angle_known, motor_ahead, plunger_acceleration
from sawbench.modeling.state import State, angle_derivative
from sawbench.processing.stroke_ripple import wave_seen

# Assumed: 5 N a micrometre, of pin, bearings and guide one behind the other.
_YIELDS_M_PER_N: Final = 2e-7
# Clearance of a running fit of 6 to 10 mm: 13 to 50 um by ISO 286-2, H8/f7.
_FIT_M: Final = 3e-5


def plunger_drive_nuisances() -> Iterator[Nuisance]:
    """List what the drive of the plunger may take off the balances.

    Yields
    ------
    Nuisance
        Its compliance in m/N, and the clearance of its fits in m.
    """
    behind_m: dict[str, tuple[float, Callable[[Floats], Floats]]] = {
        "compliance": (_YIELDS_M_PER_N, lambda pushed_n: pushed_n),
        "clearance": (_FIT_M, lambda pushed_n: 0.5 * np.sign(pushed_n)),
    }
    for name, (std, behind) in behind_m.items():
        yield Nuisance(
            name=f"{name} of the plunger's drive", nominal=0.0, std=std, is_plant=False,
            signature=partial(_seen, behind_m=behind),
        )  # fmt: skip


def _seen(baseline: Baseline, state: State, *, behind_m: Callable[[Floats], Floats]) -> Signature:
    """By a plunger that is behind by that for the force, N, with which the pin pushes it up the angle."""
    if state.kind != "running" or state.force_n is None or not is_angle_known(state):
        return {}
    inertia_n = baseline.plant.reciprocating_mass_kg.nominal * plunger_acceleration(baseline.mechanism, state)
    behind = behind_m(inertia_n + baseline.cutting_sign * state.force_n)
    ahead_rad = wave_seen(baseline.mechanism, state.angle_rad[0], behind)
    speed = baseline.gear * state.speed_rad_s * angle_derivative(ahead_rad)
    return motor_ahead(baseline, speed, state.speed_rad_s * angle_derivative(speed))
