"""How the wood's hardness changes over blade life and feed, from single strokes: a worn blade, a chip's thickness.

Both only scale the cutting force, slowly or from trial to trial, and so they hide in what pieces of wood differ by.
Their whole evidence lies in one number a stroke, whose noise is known from the strokes themselves: scatter with memory
within a trial, and a piece of wood of its own in each. So the likelihood is that of a mixed model without any form but
the effect's own, and it needs hardly any tempering, which the features of all channels do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import Any

import numpy as np

from bench.recording import Floats
from diagnosis.effects import blade_wear, chip_thickness
from diagnosis.effects.effect import Effect
from diagnosis.log_mean import log_mean_exp
from diagnosis.state import State
from diagnosis.stroke_series import StrokeSeries

# Of the sensors' effects: a wandering zero leaves the slope of force over speed alone, the current has no part in it.
_LEAVE_FORCE = ("force_offset_drift", "current_sensor_lag")
WEAR, CHIP = blade_wear.EFFECT.name, chip_thickness.EFFECT.name
# Strokes are averaged over a block of that many; what a wood remembers for longer is fitted as memory of the blocks.
_BLOCK = 20
_MIN_TRIALS = 3
# Size of a block's scatter as a multiple of what trials show about their trend, memory from block to block, and scatter
# from piece to piece: all are averaged over.
_SCATTERS = (0.8, 1.0, 1.25, 1.6)
_MEMORIES = (0.0, 0.3, 0.6, 0.85)
_PIECES = (0.012, 0.025, 0.045, 0.07)
# Standard deviation of what is not asked for: hardness of a stock (logarithm), and its powers of speed and feed.
_STOCK_STD = 3.0
_FREE_STD, _LITTLE_STD = 0.5, 0.03
_N_GROWTHS = 12
_EXPONENTS = np.geomspace(0.1, 1.2, 10)


@dataclass(frozen=True, kw_only=True, slots=True)
class Blocks:
    """Hardness averaged over blocks of strokes, all trials one after the other.

    Attributes
    ----------
    log_k, distance_m, log_speed, log_feed : ndarray, shape (n,)
        Speed and feed over their means.
    trial, stock : ndarray of int, shape (n,)
    """

    log_k: Floats
    distance_m: Floats
    log_speed: Floats
    log_feed: Floats
    trial: np.ndarray
    stock: np.ndarray


def bends_force(effect: Effect) -> bool:
    """Whether an effect may change with the speed how hard the wood seems, by the cut itself or by a sensor."""
    return effect.place == "cutting" or (effect.place == "sensing" and effect.name not in _LEAVE_FORCE)


def blocks_of(states: Sequence[State], strokes: Sequence[StrokeSeries]) -> Blocks | None:
    """Average the strokes of every cutting trial.

    Parameters
    ----------
    states : sequence of State
        They say how far the blade had cut and how fast it ran.
    strokes : sequence of StrokeSeries

    Returns
    -------
    Blocks or None
        None where fewer than three trials can be used.
    """
    running = {s.setting.label: s for s in states if s.kind == "running" and not s.setting.is_idle}
    stocks = {name: k for k, name in enumerate(dict.fromkeys(s.setting.stock for s in running.values()))}
    trials: list[Floats] = []
    for series in strokes:
        state = running.get(series.label)
        n = 0 if state is None else len(series.k_n_s_per_m) // _BLOCK
        if state is None or n < 2:
            continue
        cut = slice(0, n * _BLOCK)
        hardness = series.k_n_s_per_m[cut].reshape(n, _BLOCK).mean(axis=1)
        if not np.all(hardness > 0.0):
            continue
        at_s = series.time_s[cut].reshape(n, _BLOCK).mean(axis=1)
        known_s = state.time_s[:, 0]
        distance = np.interp(at_s, known_s, state.cut_distance_m[:, 0])
        speed = np.interp(at_s, known_s, state.speed_rad_s.mean(axis=1))
        same = [np.full(n, v) for v in (np.log(series.feed_m_s), len(trials), stocks[state.setting.stock])]
        trials.append(np.column_stack([np.log(hardness), distance, np.log(speed), *same]))
    if len(trials) < _MIN_TRIALS:
        return None
    log_k, distance, log_speed, log_feed, trial, stock = np.vstack(trials).T
    return Blocks(
        log_k=log_k,
        distance_m=np.maximum(distance, 0.0),
        log_speed=log_speed - log_speed.mean(),
        log_feed=log_feed - log_feed.mean(),
        trial=trial.astype(int),
        stock=stock.astype(int),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Trend:
    """Log evidence of a worn blade and of a chip's thickness against a wood that only scatters, by effect.

    Attributes
    ----------
    alone : mapping of str to float
        Where nothing else makes the cut harder or softer.
    beside_cutting : mapping of str to float
        Where another effect of the cut or of a sensor may act: hardness is free to go with a power of the speed, and of
        the feed unless the chip is asked for.
    sizes : mapping of str to (float, float)
        Mean and standard deviation of the reported parameter, hardness as free as beside another effect.
    """

    alone: Mapping[str, float]
    beside_cutting: Mapping[str, float]
    sizes: Mapping[str, tuple[float, float]]


def trend_evidence(blocks: Blocks | None) -> Trend:
    """Weigh wear and chip thickness by the hardness of the strokes; hardness of each stock is free.

    Parameters
    ----------
    blocks : Blocks or None
        Of `blocks_of`.

    Returns
    -------
    Trend
        Empty without blocks.
    """
    if blocks is None:
        nothing: MappingProxyType[str, Any] = MappingProxyType({})
        return Trend(alone=nothing, beside_cutting=nothing, sizes=nothing)
    worn, growths = _worn(blocks)
    chips = np.array([m * (blocks.log_feed - blocks.log_speed) for m in _EXPONENTS])
    free, little = _FREE_STD, _LITTLE_STD
    alone = _log_odds(blocks, {WEAR: worn, CHIP: chips}, speed_std=little, feed_std=little)
    beside = _log_odds(blocks, {WEAR: worn}, speed_std=free, feed_std=free)
    beside |= _log_odds(blocks, {CHIP: chips}, speed_std=free, feed_std=little)
    return Trend(
        alone=MappingProxyType({name: log_mean_exp(logs) for name, logs in alone.items()}),
        beside_cutting=MappingProxyType({name: log_mean_exp(logs) for name, logs in beside.items()}),
        sizes=MappingProxyType({WEAR: _moments(beside[WEAR], growths), CHIP: _moments(beside[CHIP], _EXPONENTS)}),
    )


def _log_odds(blocks: Blocks, means: Mapping[str, Floats], *, speed_std: float, feed_std: float) -> dict[str, Floats]:
    """Log likelihood of each effect's means, shape (forms, n), against none, shape (forms,)."""
    none = np.zeros((1, len(blocks.log_k)))
    logs = _log_likelihoods(blocks, np.vstack([none, *means.values()]), speed_std=speed_std, feed_std=feed_std)
    ends = np.cumsum([1, *(len(mean) for mean in means.values())])
    return {name: part - logs[0] for name, part in zip(means, np.split(logs, ends[:-1])[1:], strict=True)}


def _moments(logs: Floats, values: Floats) -> tuple[float, float]:
    """Mean and standard deviation of values that are as likely as the logarithms say."""
    weight = np.exp(logs - logs.max())
    mean = float(np.average(values, weights=weight))
    return mean, float(np.sqrt(np.average((values - mean) ** 2, weights=weight)))


def _worn(blocks: Blocks) -> tuple[Floats, Floats]:
    """Logarithm of the growth for every form and size, shape (forms * sizes, n), and the sizes, (forms * sizes,)."""
    forms = [blade_wear.growth(blocks.distance_m, **shape) for shape in blade_wear.EFFECT.shapes]
    strength = blade_wear.EFFECT.strength
    sizes = strength.typical * np.geomspace(strength.low, strength.high, _N_GROWTHS)
    return np.array([np.log1p(size * form) for form, size in product(forms, sizes)]), np.tile(sizes, len(forms))


def _log_likelihoods(blocks: Blocks, means: Floats, *, speed_std: float, feed_std: float) -> Floats:
    """Of the mixed model with each mean, shape (len(means), n), averaged over what is not known of the noise."""
    from scipy.linalg import solve_triangular

    same_trial = blocks.trial[:, None] == blocks.trial
    same_stock = blocks.stock[:, None] == blocks.stock
    free = _STOCK_STD**2 * same_stock.astype(np.float64)
    free += speed_std**2 * np.outer(blocks.log_speed, blocks.log_speed)
    free += feed_std**2 * np.outer(blocks.log_feed, blocks.log_feed)
    place = np.arange(len(blocks.trial))
    lag = np.abs(place[:, None] - place)
    variance = _scatter_within(blocks)
    rest = (blocks.log_k - means).T
    found = []
    for scatter, memory, piece in product(_SCATTERS, _MEMORIES, _PIECES):
        within = np.where(same_trial, memory**lag, 0.0) * variance * scatter**2
        root = np.linalg.cholesky(free + piece**2 * same_trial + within)
        half = solve_triangular(root, rest, lower=True)
        found.append(-0.5 * np.sum(half**2, axis=0) - np.sum(np.log(np.diag(root))))
    return np.array([log_mean_exp(column) for column in np.array(found).T])


def _scatter_within(blocks: Blocks) -> float:
    """Variance of the blocks about the line through those of their trial."""
    squares, degrees = 0.0, 0
    for trial in range(int(blocks.trial.max()) + 1):
        values = blocks.log_k[blocks.trial == trial]
        count = np.arange(len(values))
        if len(values) > 2:
            squares += float(np.sum((values - np.polyval(np.polyfit(count, values, 1), count)) ** 2))
            degrees += len(values) - 2
    return max(squares / max(degrees, 1), 1e-6)
