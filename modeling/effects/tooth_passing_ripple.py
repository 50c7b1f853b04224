"""Single teeth show in the force: F (1 + a sin(2 pi x / p + psi)), x the blade's position, p the pitch.

Locked to the blade's position, so it chirps in time: fast at mid stroke, slow at the dead centres. The
reading is the true force. Free phase: sine and cosine part. A tooth that enters at once and leaves slowly makes
a saw tooth of it: the sharp form has two overtones as well, each with a free phase and half the size of the one
before. Teeth that are set to either side in turn cut unequal chips: that form has the wave of every second tooth too.
The pitch grid advances by a tenth of a turn over 20 mm from one entry to the next, by a fifth for teeth set in turn.
A resonance rings at one frequency at any position. Jigsaw blades: 1.8 to 4.5 mm (makers' catalogues, 6 to 14 teeth
an inch); depth: assumed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from sawbench.modeling.effects.effect import Effect, Prepared, Strength, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import TWO_PI, State

_TEETH_PER_M = np.arange(220.0, 560.0 + 1.0, 5.0)
# Waves a pitch, and the typical size of each.
_SMOOTH, _SHARP, _ALTERNATE = ({1.0: 1.0}, {1.0: 1.0, 2.0: 0.5, 3.0: 0.25}, {1.0: 1.0, 0.5: 0.5, 2.0: 0.5, 3.0: 0.25})


def _prepared(baseline: Baseline, state: State) -> Callable[..., tuple[Signature, ...]]:
    turned = TWO_PI * baseline.mechanism.displacement(state.angle_rad)
    force = baseline.expected_force(state)

    def signature(pitch_m: float, sharp: float, alternate: float = 0.0) -> tuple[Signature, ...]:
        found: list[Signature] = []
        for waves, size in _waves(sharp, alternate).items():
            phase = waves / pitch_m * turned
            found.append({"cutting": size * force * np.sin(phase)})
            found.append({"cutting": size * force * np.cos(phase)})
        return tuple(found)

    return signature


def _waves(sharp: float, alternate: float = 0.0) -> dict[float, float]:
    if alternate:
        return _ALTERNATE
    return _SHARP if sharp else _SMOOTH


EFFECT = Effect(
    name="tooth_passing_ripple",
    place="cutting",
    equation="F * (1 + a * sin(2 pi x / p + psi))",
    words=Words(
        happens="single teeth show in the force",
        measure="the pitch of the teeth with a ruler: the ripple must have the same",
        mend="no fault; keep it in the model, or use a finer blade",
    ),
    parts=("blade",),
    silent_in=("air",),
    strength=Strength(
        name="depth", unit="1", typical=0.15, low=0.1, high=3.0, source="assumed; pitch: blade catalogues"
    ),
    signature=Prepared(_prepared),
    n_signatures=lambda shape: 2 * len(_waves(shape["sharp"], shape.get("alternate", 0.0))),
    shapes=(
        *({"pitch_m": float(1.0 / n), "sharp": sharp} for sharp in (0.0, 1.0) for n in _TEETH_PER_M),
        *({"pitch_m": float(1.0 / n), "sharp": 1.0, "alternate": 1.0} for n in _TEETH_PER_M[::2]),
    ),
    continuous=("pitch_m",),
    needs=("force_n",),
    grows_with=("position", "load"),
    confused_with=("carriage_resonance",),
    told_apart_by="trials at other speeds: it keeps its blade position, a resonance its frequency",
    leading=2,
    is_at_one_place=True,
    # A little of any of its waves, that of every second tooth too.
    background=tuple(
        ({"pitch_m": 1.0 / n, "sharp": 0.0}, 0.03)
        for n in (110.0, 130.0, 150.0, 175.0, 205.0, 240.0, 275.0, 310.0, 345.0, 380.0, 420.0, 470.0, 530.0)
    ),
)
