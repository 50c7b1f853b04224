"""What holds the displacement sensor: it yields to the force that moves the plunger, and rings.

Saw, clamp and sensor are pushed back by what moves the plunger and by the force of the cut. What moves the sensor
against the saw adds to its reading, as a mass on a spring does: slow forces move it as they move a plunger that yields
(`diagnosis.inference.plunger_drive`), and near its own frequency it moves many times as far. The angle is told from the
displacement, so that the crank seems to turn unevenly. A mode of a mass as that of a saw is ordinary.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.plunger_drive import SHOWN_HARMONICS, pushing_force
from sawbench.modeling.effects.effect import Effect, Strength, Together
from sawbench.modeling.effects.transfer import Spectrum, resonance
from sawbench.modeling.effects.yoke_backlash import swings
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State
from sawbench.processing.stroke_ripple import wave_seen

# Assumed: the mass of a jigsaw. Lighter parts that ring are stiffer.
_MASS_KG: Final = 2.5


def _signatures(
    baseline: Baseline, state: State, shapes: Sequence[dict[str, float]]
) -> list[tuple[Signature, ...]]:  # fmt: skip
    pushed_n = pushing_force(baseline, state)
    if pushed_n is None:
        return [({},) for _ in shapes]
    pushed, angle_rad = Spectrum(pushed_n, state), state.angle_rad[0]

    def off_rad(frequency_hz: float, damping: float, harmonics: float) -> Floats:
        rings_n = pushed.through(lambda f: resonance(frequency_hz, damping, f)) - pushed_n
        off_m = -np.mean(rings_n, axis=0) / (_MASS_KG * (2.0 * np.pi * frequency_hz) ** 2)
        return wave_seen(baseline.mechanism, angle_rad, off_m, int(harmonics))

    waves_rad = np.array([off_rad(**shape) for shape in shapes])[:, None]
    return [(found,) for found in swings(baseline, state, waves_rad, of_sensor=True)]


SENSOR_MOUNT = Effect(
    name="displacement sensor whose mount rings",
    place="sensing",
    equation="x - c (resonance of m x'' + F, less that itself)",
    strength=Strength(name="share", unit="1", typical=1.0, low=0.1, high=10.0, source="assumed"),
    signature=Together(_signatures),
    shapes=tuple(
        {"frequency_hz": float(f), "damping": z, "harmonics": float(n)}
        for f in np.geomspace(100.0, 1000.0, 60)
        for z in (0.01, 0.03)
        for n in SHOWN_HARMONICS
    ),
    continuous=("frequency_hz", "damping"),
    needs=("force_n",),
    is_pointwise=False,
    is_at_one_place=True,
    background_share=1.0,
)
