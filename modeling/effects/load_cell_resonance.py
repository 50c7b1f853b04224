"""The load cell rings by itself, with what is clamped to it: a property of the sensor, no effect of the machine.

    F_m = F + s (resonance of F, less F)

The same transfer function as that of the carriage (`carriage_resonance`), mostly above its frequencies. All of the
force goes through the cell, so that a single mode has all of it (s = 1, but for the error of a gain); of a carriage
with several modes, or with a guide that bears a part of the force, one has less. A light mode, of up to an eighth of
the force, every bench has somewhere, among the frequencies of the carriage too. Cells of 200 N to 2 kN with a clamp of
0.05 to 0.5 kg ring at 300 Hz to some kHz with a damping ratio of 0.01 to 0.1: assumed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects import carriage_resonance
from sawbench.modeling.effects.effect import Prepared, Strength, TransferFunction, Words
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

_LEAST_SHARE, _LIGHT_SHARE = 0.05, 0.125
_OF_ALL_HZ = tuple(np.geomspace(carriage_resonance.FREQUENCIES_HZ[-1], 1500.0, 28).tolist())
_OF_LIGHT_HZ = carriage_resonance.FREQUENCIES_HZ + _OF_ALL_HZ
# Frequencies that go with a share; without one it is all of the force.
_FREQUENCIES_HZ = (
    ({}, _OF_ALL_HZ),
    ({"share": 1.0}, _OF_ALL_HZ),
    ({"share": _LIGHT_SHARE}, _OF_LIGHT_HZ),
    ({"share": _LEAST_SHARE}, _OF_LIGHT_HZ),
)


def _prepared(baseline: Baseline, state: State) -> Callable[..., tuple[Signature, ...]]:
    of_all = carriage_resonance.prepared(baseline, state)

    def signature(frequency_hz: float, damping: float, share: float = 1.0) -> tuple[Signature, ...]:
        return tuple({name: share * wave for name, wave in one.items()} for one in of_all(frequency_hz, damping))

    return signature


def _distorts(
    state: State, coefficients: Floats, frequency_hz: float, damping: float, share: float = 1.0
) -> Mapping[str, TransferFunction]:
    return carriage_resonance.distorts(state, share * coefficients, frequency_hz, damping)


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
    signature=Prepared(_prepared),
    n_signatures=lambda shape: 1,
    shapes=tuple(
        {"frequency_hz": f, "damping": z, **share}
        for share, frequencies_hz in _FREQUENCIES_HZ
        for f in frequencies_hz
        for z in (0.01, 0.02, 0.04, 0.08, 0.16)
    ),
    continuous=("frequency_hz", "damping", "share"),
    leading=0,
    confused_with=(),
    told_apart_by="",
    background=None,
    distorts=_distorts,
)
