"""The load cell rings by itself, with what is clamped to it: a property of the sensor, no effect of the machine.

The same transfer function as that of the carriage (`carriage_resonance`), above its frequencies, and all of the force
goes through the cell: the share that rings is 1, but for the error of a gain. Cells of 200 N to 2 kN with a clamp of
0.05 to 0.5 kg ring at 300 Hz to some kHz with a damping ratio of 0.01 to 0.1: assumed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from sawbench.modeling.effects import carriage_resonance
from sawbench.modeling.effects.effect import Strength, Words

_FREQUENCIES_HZ = tuple(float(f) for f in np.geomspace(carriage_resonance.HIGHEST_HZ, 1500.0, 28))

EFFECT = replace(
    carriage_resonance.EFFECT,
    name="load_cell_resonance",
    equation="force reading through a second-order resonance of the load cell itself",
    words=Words(
        happens="resonance of the load cell itself",
        measure="the frequency of the force reading after a light tap on the unloaded load cell",
        mend="use a stiffer load cell or a lighter clamp",
    ),
    strength=Strength(name="frequency_hz", unit="Hz", typical=1.0, low=0.8, high=1.25, source="assumed"),
    n_signatures=lambda shape: 1,
    shapes=tuple({"frequency_hz": f, "damping": z} for f in _FREQUENCIES_HZ for z in (0.01, 0.02, 0.04, 0.08, 0.16)),
    continuous=("frequency_hz", "damping"),
    leading=0,
    confused_with=(),
    told_apart_by="",
    background=None,
)
