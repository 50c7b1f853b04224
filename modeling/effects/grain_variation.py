"""The wood is not the same everywhere: k (1 + a sin(2 pi path / wavelength + psi)), path = feed * time.

A slow modulation across strokes, locked to the feed path of the trial (which starts at an unknown place:
free phase, sine and cosine part, of each trial its own). Usable at the resolution of the units; the average
over the strokes of a unit is accounted for. Tooth ripple repeats in every stroke, wear only grows. Annual
rings of oak and locust: 1 to 8 mm; knots and boards to 20 mm; hardness of early and late wood differs by 10
to 50 %: assumed.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Strength, Words
from sawbench.modeling.effects.strokes import StrokeWave
from sawbench.modeling.effects.transfer import stroke_rate_hz
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import TWO_PI, State

# Evenly spaced in wave number: neighbours drift apart by half a turn over 40 mm of feed.
WAVELENGTHS_M: Final[tuple[float, ...]] = tuple(float(1.0 / n) for n in np.arange(50.0, 1000.1, 12.5))


def feed_phase(state: State, wavelength_m: float) -> tuple[Floats, Floats]:
    """Phase of the wood's wave at each point, rad, and what is left of it in the mean over a unit's strokes.

    Returns
    -------
    phase_rad : ndarray, shape (n_units, n_points)
    share : ndarray, shape (n_units, 1)
        May be negative, as of any moving average.
    """
    wave_number = TWO_PI * state.setting.feed_m_s / wavelength_m
    rate_hz = stroke_rate_hz(state)
    within_s = (state.angle_rad - np.pi) / (TWO_PI * rate_hz)
    half_turn = 0.5 * wave_number / rate_hz
    n_strokes = np.asarray(state.n_strokes, float)[:, None]
    # Dirichlet kernel; its 0/0 (a whole wave a stroke) has the limit +-1.
    below = np.sin(half_turn)
    is_whole = np.abs(below) < 1e-9
    share = np.where(
        is_whole,
        np.cos(n_strokes * half_turn) / np.cos(half_turn),
        np.sin(n_strokes * half_turn) / (n_strokes * np.where(is_whole, 1.0, below)),
    )
    return wave_number * (state.time_s + within_s), share


def _signature(baseline: Baseline, state: State, wavelength_m: float) -> tuple[Signature, ...]:
    if not state.setting.feed_m_s > 0.0:
        return {}, {}
    phase, share = feed_phase(state, wavelength_m)
    force = baseline.expected_force(state) * share
    return {"cutting": force * np.sin(phase)}, {"cutting": force * np.cos(phase)}


EFFECT = Effect(
    name="grain_variation",
    place="cutting",
    equation="k * (1 + a * sin(2 pi * feed path / wavelength))",
    words=Words(
        happens="the specific cutting coefficient varies along the cut (grain)",
        measure="the spacing of the annual rings along the cut",
        mend="cut along the grain, or average longer",
    ),
    parts=("blade",),
    silent_in=("air", "start_up"),
    strength=Strength(name="depth", unit="1", typical=0.12, low=0.1, high=4.0, source="assumed"),
    signature=_signature,
    n_signatures=lambda shape: 2,
    shapes=tuple({"wavelength_m": w} for w in WAVELENGTHS_M),
    is_pointwise=False,
    needs=("force_n",),
    grows_with=("feed", "position"),
    confused_with=("blade_wear",),
    told_apart_by="trials at another feed: the modulation keeps its wavelength on the path, not its period",
    background=(),
    strokes=StrokeWave(
        waves_per_m=(60.0, 1200.0),
        depths=np.geomspace(0.02, 0.6, 9),
        words="grain of the wood: waves of {wavelength_mm:.1f} mm along the feed",
    ),
)
