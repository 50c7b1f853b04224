"""What a load cell reads of the machine's vibration: a saw shakes the bench that the cell is mounted on.

The plunger goes back and forth, and its inertia force shakes machine, carriage and cell. What the cell reads of it runs
at the stroke rate, in air as in wood, with a phase of its own, and grows faster than the square of the speed where the
bench is soft. How much that is depends on the bench; some hundredths of the inertia force are ordinary, and no gap of
the saw. What is far more is a force that reads something else too (`diagnosis.inference.beyond.sensing`).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.nuisance import Nuisance
from sawbench.diagnosis.inference.nuisances import force_reads
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

PHASES: Final = {"in phase": 0.0, "a quarter of a turn late": 0.5 * np.pi}
# A soft bench carries 1 + (w / w_n)^2 + ... of it: the second term counts as much at the usual speed.
POWERS: Final = {"": 2, ", of a soft bench": 4}


def vibration_nuisances(baseline: Baseline) -> Iterator[Nuisance]:
    """List the waves at the stroke rate that the machine's vibration may add to the reading of the force.

    Parameters
    ----------
    baseline : Baseline

    Yields
    ------
    Nuisance
        In shares of the inertia force of the reciprocating mass.
    """
    for of_bench, power in POWERS.items():
        for phase, late_rad in PHASES.items():
            yield Nuisance(
                name=name_of(phase, of_bench), std=SETTINGS.sensors.vibration_share,
                signature=partial(_shaken, power=power, late_rad=late_rad),
            )  # fmt: skip


def name_of(phase: str, of_bench: str) -> str:
    """Name of one of the waves: of `PHASES` and `POWERS`."""
    return f"vibration in the force, {phase}{of_bench}"


def usual_rad_s(baseline: Baseline) -> float:
    """Speed of the crank in the usual trial."""
    return baseline.load.motor_speed_rad_s / baseline.gear


def inertia_n(baseline: Baseline, speed_rad_s: Floats) -> Floats:
    """Amplitude of the inertia force of the reciprocating mass at some speeds of the crank."""
    return baseline.plant.reciprocating_mass_kg.nominal * baseline.radius_m * speed_rad_s**2


def _shaken(baseline: Baseline, state: State, *, power: int, late_rad: float) -> Signature:
    if state.force_n is None:
        return {}
    speed_rad_s: Floats = np.sqrt(np.mean(state.speed_rad_s**2, axis=-1, keepdims=True))
    softer = (speed_rad_s / usual_rad_s(baseline)) ** (power - 2)
    return force_reads(baseline, state, inertia_n(baseline, speed_rad_s) * softer * np.cos(state.angle_rad - late_rad))
