"""How much the features scatter from stroke to stroke, and what that makes of the only spin-up there is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.features import START_UP_EDGES_S, Layout, time_bins
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.state import State

# Of the battery's line, in which a converter chops the motor's current: what no filter takes of that grows with it.
_CHOPPED: Final = ("supply", "converter")


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeScatter:
    """How one equation scatters from stroke to stroke, of all idle or of all cutting trials.

    Attributes
    ----------
    covariance : ndarray, shape (n, n)
        Of a single stroke's features.
    current2_a2 : float
        Mean square of the motor's current; 0 where it is not measured.
    """

    covariance: Floats
    current2_a2: float

    def of_means(self, rate_hz: float) -> tuple[float, float]:
        """Density of the noise over time, and variance of what the mean of a stroke has beyond that and drifts."""
        variance = np.diag(self.covariance)
        # An amplitude's variance is twice the density over the stroke's length.
        density = 0.5 * float(np.mean(variance[1:])) / rate_hz
        return density, max(float(variance[0]) - density * rate_hz, 0.0)


# (blade in air, equation)
Scatter = Mapping[tuple[bool, str], StrokeScatter]


def scatter_of(found: Sequence[tuple[State, Layout, Floats]]) -> dict[tuple[bool, str], StrokeScatter]:
    """Covariance of a single stroke's features, pooled over idle and over cutting trials: a few factors and a rest.

    Wood scatters in one or two directions (the whole force, its place in the stroke); what is left is sensor
    noise. A factor model keeps the two apart where shrinking to the diagonal would spread the wood over all.
    Equations are kept apart: what their residuals have in common from stroke to stroke comes of mistuned
    parameters, and a gap of one equation must not be taken for scatter of another.

    Parameters
    ----------
    found : sequence of (State, Layout, ndarray)
        With the features of each unit, shape (n_units, layout.size).

    Returns
    -------
    dict of (bool, str) to StrokeScatter
        By blade in air and equation.
    """
    pools: dict[tuple[bool, str], list[Floats]] = {}
    currents: dict[bool, list[float]] = {}
    for state, layout, features in found:
        n = len(features)
        if state.kind != "running" or n < SETTINGS.noise.least_units:
            continue
        time = np.arange(n) - 0.5 * (n - 1)
        trend = np.outer(time, time @ features) / (time @ time)
        deviation = (features - features.mean(axis=0) - trend) * np.sqrt(n / (n - 2) * state.n_strokes[0])
        current = 0.0 if state.current_a is None else float(np.mean(state.current_a**2))
        currents.setdefault(state.setting.is_idle, []).append(current)
        for equation, part in layout.slices.items():
            pools.setdefault((state.setting.is_idle, equation), []).append(deviation[:, part])
    return {
        (is_idle, equation): StrokeScatter(
            covariance=_factors(np.concatenate(rows)), current2_a2=float(np.mean(currents[is_idle]))
        )
        for (is_idle, equation), rows in pools.items()
    }  # fmt: skip


def noise_of(state: State, layout: Layout, blocks: Floats, scatter: Scatter, rate_hz: float) -> Floats:
    """Covariance of one block of features that the scatter predicts, shape (layout.size, layout.size).

    Parameters
    ----------
    state : State
    layout : Layout
    blocks : ndarray, shape (n_blocks, n_units)
    scatter : mapping
        Of `scatter_of`.
    rate_hz : float
        Strokes per second.
    """
    if state.kind != "running":
        return _start_up(state, layout, scatter, rate_hz)
    covariance = np.zeros((layout.size, layout.size))
    strokes = float(state.n_strokes[0]) / float((blocks[0] ** 2).sum())
    for equation, place in layout.slices.items():
        known = _known(scatter, equation, is_idle=state.setting.is_idle)
        if known is not None:
            covariance[place, place] = known.covariance / strokes
    return covariance


def _known(scatter: Scatter, equation: str, *, is_idle: bool) -> StrokeScatter | None:
    """Scatter of the trials of a kind; that of the others where these are too short to tell."""
    return scatter.get((is_idle, equation), scatter.get((not is_idle, equation)))


def _start_up(state: State, layout: Layout, scatter: Scatter, rate_hz: float) -> Floats:
    """Noise of the bins of a start: the stroke's mean drifts slowly, its harmonics tell the noise a second holds."""
    width_s = np.diff(START_UP_EDGES_S)
    middle_s = np.cumsum(width_s) - 0.5 * width_s
    near = np.exp(-np.abs(middle_s[:, None] - middle_s) * rate_hz / SETTINGS.noise.memory_strokes)
    covariance = np.zeros((layout.size, layout.size))
    for equation, place in layout.slices.items():
        known = _known(scatter, equation, is_idle=True)
        if known is None:
            continue
        density, slow = (np.full(len(width_s), one) for one in known.of_means(rate_hz))
        loaded = scatter.get((False, equation))
        if equation in _CHOPPED and loaded is not None and state.current_a is not None:
            more = time_bins(state.current_a**2)[0] - known.current2_a2
            by_load = np.maximum(more, 0.0) * _growth(known, loaded, rate_hz)[:, None]
            density, slow = density + by_load[0], slow + by_load[1]
        drift = np.sqrt(slow)
        covariance[place, place] = np.outer(drift, drift) * near + np.diag(density / width_s)
    return covariance


def _growth(idle: StrokeScatter, loaded: StrokeScatter, rate_hz: float) -> Floats:
    """What `of_means` gains with the square of the motor's current, shape (2,); 0 where idle runs take as much."""
    more = np.array(loaded.of_means(rate_hz)) - np.array(idle.of_means(rate_hz))
    current2_a2 = loaded.current2_a2 - idle.current2_a2
    return np.maximum(more, 0.0) / current2_a2 if current2_a2 > 0.0 else np.zeros(2)


def _factors(deviation: Floats) -> Floats:
    """Covariance of rows of shape (n, size) as factors above the noise edge of random correlations, plus a diagonal."""
    n, size = deviation.shape
    spread = np.sqrt(np.mean(deviation**2, axis=0)) + 1e-12
    _, values, vectors = np.linalg.svd(deviation / spread / np.sqrt(n), full_matrices=False)
    edge = (1.0 + np.sqrt(size / n)) ** 2
    kept = values**2 > edge
    loads = (values[kept, None] * vectors[kept]).T
    rest = np.maximum(1.0 - np.sum(loads**2, axis=1), 1e-3)
    return (loads @ loads.T + np.diag(rest)) * np.outer(spread, spread)


def contrast_misfit(whitened: Sequence[Floats]) -> float:
    """Mean square of what blocks of a trial differ by beyond mean and trend, over what is whitened to 1.

    Parameters
    ----------
    whitened : sequence of ndarray, shape (n_blocks, size)
        One a trial.

    Returns
    -------
    float
        0 where no trial has four blocks.
    """
    squares, count = 0.0, 0
    for rows in whitened:
        n = len(rows)
        if n < SETTINGS.noise.least_blocks:
            continue
        basis, _ = np.linalg.qr(np.stack([np.ones(n), np.arange(n)], axis=1))
        squares += float(np.sum((rows - basis @ (basis.T @ rows)) ** 2))
        count += (n - 2) * rows.shape[1]
    return squares / count if count else 0.0
