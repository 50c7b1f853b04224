"""Carriage and load cell ring: the reading is the force through 1 / (1 - (f/f_n)^2 + 2 j zeta f/f_n).

Only the reading rings; the motor feels the force itself, so the mechanical residual, which uses the
reading, shows the same error with the other sign. Fixed in Hz at every speed, where tooth ripple keeps its
blade position. Part of the force may bypass the spring (amplitude below 1), and a carriage has upper modes: a
second form adds one at 1.4 to 3 times the first, of its own size; it does not count without the first.
Every carriage has light modes, of a few per cent of the force, at any frequency: a little of any form is background.
f_n = 60 to 410 Hz and zeta = 0.02 to 0.2: assumed (a carriage of 0.5 to 3 kg on a cell of 1e6 N/m, 400 Hz at most, and
what an estimate of the frequency may miss).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Prepared, Strength, TransferFunction, Words
from sawbench.modeling.effects.transfer import Spectrum, force_error, resonance
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

FREQUENCIES_HZ: Final = tuple(np.geomspace(60.0, 410.0, 40).tolist())
# Frequency of the upper mode over that of the first.
_UPPER = (1.4, 1.8, 2.3, 3.0)


def prepared(baseline: Baseline, state: State) -> Callable[..., tuple[Signature, ...]]:
    """Signature of any form on one state, for a share of one of each mode."""
    force_n = baseline.expected_force(state)
    expected = Spectrum(force_n, state)

    def signature(frequency_hz: float, damping: float, upper: float = 0.0) -> tuple[Signature, ...]:
        readings = [expected.through(mode) for mode in _modes(frequency_hz, damping, upper)]
        return tuple(force_error(baseline, state, reading - force_n) for reading in readings)

    return signature


def _modes(frequency_hz: float, damping: float, upper: float) -> list[TransferFunction]:
    places = (frequency_hz, frequency_hz * upper) if upper else (frequency_hz,)
    return [partial(resonance, place, damping) for place in places]


def distorts(
    _: State, coefficients: Floats, frequency_hz: float, damping: float, upper: float = 0.0
) -> Mapping[str, TransferFunction]:
    """Transfer function through which the cutting force shows, for the share of each mode."""
    modes = _modes(frequency_hz, damping, upper)

    def of_force(f: Floats) -> NDArray[np.complexfloating]:
        return 1.0 + sum(share * (mode(f) - 1.0) for share, mode in zip(coefficients, modes, strict=True))

    return {"cutting": of_force}


EFFECT = Effect(
    name="carriage_resonance",
    place="sensing",
    equation="force reading through a second-order resonance",
    words=Words(
        happens="resonance of the carriage with the load cell",
        measure="the frequency of the force reading after a light hammer blow on the carriage",
        mend="stiffen or damp the carriage",
    ),
    parts=("carriage",),
    silent_in=("air",),
    strength=Strength(name="frequency_hz", unit="Hz", typical=1.0, low=0.1, high=2.0, source="assumed"),
    signature=Prepared(prepared),
    n_signatures=lambda shape: 2 if "upper" in shape else 1,
    shapes=(
        *({"frequency_hz": f, "damping": z} for f in FREQUENCIES_HZ for z in (0.03, 0.08, 0.2)),
        *(
            {"frequency_hz": f, "damping": z, "upper": u}
            for f in FREQUENCIES_HZ[:32:3]
            for z in (0.04, 0.1)
            for u in _UPPER
        ),
    ),
    continuous=("frequency_hz", "damping", "upper"),
    shape_strength=lambda amplitude, shape: shape["frequency_hz"],
    carries=("frequency_hz",),
    leading=1,
    is_pointwise=False,
    needs=("force_n",),
    grows_with=("speed", "load"),
    confused_with=("tooth_passing_ripple", "force_sensor_lag"),
    told_apart_by="trials at several speeds: the resonance keeps its frequency",
    is_at_one_place=True,
    distorts=distorts,
)
