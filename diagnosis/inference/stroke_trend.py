"""How the wood's hardness changes over blade life and feed, from single strokes: a worn blade, a chip's thickness.

Both only scale the cutting force, slowly or from trial to trial, and so they hide in what pieces of wood differ by.
Their whole evidence lies in one number a stroke, whose noise is known from the strokes themselves: scatter with memory
within a trial, and a piece of wood of its own in each, which may be harder at one end of the cut. So the likelihood is
that of a mixed model without any form but the effect's own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.settings import SETTINGS, Strokes
from sawbench.diagnosis.inference.stroke_series import StrokeSeries
from sawbench.diagnosis.log_mean import log_mean_exp, log_mean_exp_rows
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.strokes import StrokeTrend
from sawbench.modeling.state import State

# Size of a block's scatter in standard errors of its logarithm from what trials show, but in steps of a quarter at
# least; memory from block to block, and scatter from piece to piece: all are averaged over.
_SCATTERS = (-1.0, 0.0, 1.0, 2.0)
_LEAST_STEP = 0.25
_MEMORIES = (0.0, 0.3, 0.6, 0.85)
_PIECES = (0.012, 0.025, 0.05, 0.1, 0.2)
# Log of the hardness by which a piece of wood changes from one end of the longest cut to the other.
_ALONG_CUTS = (0.0, 0.03, 0.1)


@dataclass(frozen=True, kw_only=True, slots=True)
class Blocks:
    """Hardness averaged over blocks of strokes, all trials one after the other.

    Attributes
    ----------
    log_k, distance_m, log_speed, log_feed : ndarray, shape (n,)
        Speed and feed over their means. The speed is that of the operating point: a hard piece slows its own strokes,
        and a trial's own speed would be taken for the cause.
    trial, stock : ndarray of int, shape (n,)
    """

    log_k: Floats
    distance_m: Floats
    log_speed: Floats
    log_feed: Floats
    trial: np.ndarray
    stock: np.ndarray

    @property
    def into_cut(self) -> Floats:
        """Distance cut since the first block of the trial, over that of the longest trial, shape (n,).

        0 where one state of each trial is all that is known of it.
        """
        first = np.array([self.distance_m[self.trial == number][0] for number in range(int(self.trial.max()) + 1)])
        cut_m = self.distance_m - first[self.trial]
        longest_m = float(cut_m.max())
        return cut_m / longest_m if longest_m > 0.0 else cut_m


def blocks_of(
    states: Sequence[State], strokes: Sequence[StrokeSeries], known: Sequence[KnownEffect] = ()
) -> Blocks | None:
    """Average the strokes of every cutting trial.

    Parameters
    ----------
    states : sequence of State
        They say how far the blade had cut and how fast it ran.
    strokes : sequence of StrokeSeries
    known : sequence of KnownEffect
        Trends among them are taken off.

    Returns
    -------
    Blocks or None
        None where fewer than three trials can be used.
    """
    running = {s.setting.label: s for s in states if s.kind == "running" and not s.setting.is_idle}
    stocks = {name: k for k, name in enumerate(dict.fromkeys(s.setting.stock for s in running.values()))}
    speeds = _speeds(running.values())
    trials: list[Floats] = []
    for series in strokes:
        state, n_strokes = running.get(series.label), len(series.k_n_s_per_m)
        # A short trial is two blocks, which are shorter.
        of_block = min(SETTINGS.strokes.block, n_strokes // 2)
        n = n_strokes // of_block
        hardness = series.k_n_s_per_m[: n * of_block].reshape(n, of_block).mean(axis=1)
        if state is None or not np.all(hardness > 0.0):
            continue
        at_s = series.time_s[: n * of_block].reshape(n, of_block).mean(axis=1)
        distance = np.interp(at_s, state.time_s[:, 0], state.cut_distance_m[:, 0])
        setting = state.setting
        of_trial = (speeds[setting.operating_point], np.log(series.feed_m_s), len(trials), stocks[setting.stock])
        trials.append(np.column_stack([np.log(hardness), distance, *(np.full(n, v) for v in of_trial)]))
    if len(trials) < SETTINGS.noise.least_trials:
        return None
    log_k, distance, log_speed, log_feed, trial, stock = np.vstack(trials).T
    distance = np.maximum(distance, 0.0)
    log_speed, log_feed = log_speed - log_speed.mean(), log_feed - log_feed.mean()
    for one in known:
        if isinstance(one.effect.strokes, StrokeTrend):
            log_k = log_k - one.effect.strokes.log_change(distance, log_feed - log_speed, one.value, **one.form)
    return Blocks(
        log_k=log_k,
        distance_m=distance,
        log_speed=log_speed,
        log_feed=log_feed,
        trial=trial.astype(int),
        stock=stock.astype(int),
    )


def _speeds(running: Iterable[State]) -> dict[str, float]:
    """Logarithm of the crank speed by operating point, mean of its trials."""
    found: dict[str, list[float]] = {}
    for state in running:
        found.setdefault(state.setting.operating_point, []).append(float(np.log(state.speed_rad_s.mean())))
    return {point: float(np.mean(logs)) for point, logs in found.items()}


@dataclass(frozen=True, kw_only=True, slots=True)
class Trend:
    """Log evidence of a trend of the hardness against a wood that only scatters.

    Attributes
    ----------
    alone : float
        Where nothing else makes the cut harder or softer.
    beside_cutting : float
        Where another effect of the cut or of a sensor may act: hardness is free to go with a power of the speed, and of
        the feed unless the trend itself does.
    size, size_std : float
        Mean and standard deviation of the reported parameter, hardness as free as beside another effect.
    """

    alone: float
    beside_cutting: float
    size: float
    size_std: float


# Trials are too few or too short.
NOTHING_SHOWN = Trend(alone=0.0, beside_cutting=0.0, size=0.0, size_std=0.0)


def trend_evidence(
    blocks: Blocks | None, trends: Mapping[str, StrokeTrend], numbers: Strokes = SETTINGS.strokes
) -> dict[str, Trend]:
    """Weigh trends by the hardness of the strokes; hardness of each stock is free.

    Parameters
    ----------
    blocks : Blocks or None
        Of `blocks_of`.
    trends : mapping of str to StrokeTrend
        By effect.
    numbers : Strokes

    Returns
    -------
    dict of str to Trend
        By effect; empty without blocks.
    """
    if blocks is None or not trends:
        return {}
    changes = {name: _changes(blocks, trend) for name, trend in trends.items()}
    free, little = numbers.free_std, numbers.little_std
    alone = _log_odds(blocks, changes, speed_std=little, feed_std=little)
    beside: dict[str, Floats] = {}
    for goes_with_feed in (False, True):
        chosen = {name: changes[name] for name, trend in trends.items() if trend.goes_with_feed == goes_with_feed}
        beside |= _log_odds(blocks, chosen, speed_std=free, feed_std=little if goes_with_feed else free)
    found = {}
    for name, trend in trends.items():
        size, size_std = _moments(beside[name].reshape(len(trend.shapes), -1), trend.sizes)
        found[name] = Trend(
            alone=log_mean_exp(alone[name]), beside_cutting=log_mean_exp(beside[name]), size=size, size_std=size_std
        )
    return found


def _changes(blocks: Blocks, trend: StrokeTrend) -> Floats:
    """Change of the log hardness for every form and size, shape (forms * sizes, n)."""
    thickness = blocks.log_feed - blocks.log_speed
    return np.array(
        [
            trend.log_change(blocks.distance_m, thickness, size, **shape)
            for shape, size in product(trend.shapes, trend.sizes)
        ]
    )


def _log_odds(blocks: Blocks, means: Mapping[str, Floats], *, speed_std: float, feed_std: float) -> dict[str, Floats]:
    """Log likelihood of each effect's means, shape (forms, n), against none, shape (forms,)."""
    if not means:
        return {}
    none = np.zeros((1, len(blocks.log_k)))
    logs = _log_likelihoods(blocks, np.vstack([none, *means.values()]), speed_std=speed_std, feed_std=feed_std)
    ends = np.cumsum([1, *(len(mean) for mean in means.values())])
    return {name: part - logs[0] for name, part in zip(means, np.split(logs, ends[:-1])[1:], strict=True)}


def _moments(logs: Floats, sizes: Floats) -> tuple[float, float]:
    """Mean and standard deviation of a size; logarithms of the likelihood, shape (forms, sizes).

    Each of the sizes stands for all that are nearer to it than to the others.
    """
    weight = np.exp(logs - logs.max()).sum(axis=0)
    mean = float(np.average(sizes, weights=weight))
    return mean, float(np.sqrt(np.average((sizes - mean) ** 2 + np.gradient(sizes) ** 2 / 12.0, weights=weight)))


def _log_likelihoods(blocks: Blocks, means: Floats, *, speed_std: float, feed_std: float) -> Floats:
    """Of the mixed model with each mean, shape (len(means), n), averaged over what is not known of the noise."""
    from scipy.linalg import solve_triangular

    rest = (blocks.log_k - means).T
    found = []
    for root in noise_roots(blocks, speed_std=speed_std, feed_std=feed_std):
        half = solve_triangular(root, rest, lower=True)
        found.append(-0.5 * np.sum(half**2, axis=0) - np.sum(np.log(np.diag(root))))
    return log_mean_exp_rows(np.array(found).T)


def noise_roots(blocks: Blocks, *, speed_std: float, feed_std: float) -> Iterator[Floats]:
    """Cholesky factors of the covariance of the log hardness, shape (n, n) each, for all that is not known of the wood.

    Parameters
    ----------
    blocks : Blocks
    speed_std, feed_std : float
        Of the powers of speed and feed with which the hardness goes.

    Yields
    ------
    ndarray
        Equally likely: scatter and its memory within a trial, what pieces differ by, and how they change along the cut.
    """
    same_trial = blocks.trial[:, None] == blocks.trial
    same_stock = blocks.stock[:, None] == blocks.stock
    free = SETTINGS.workpieces.stock_log_std**2 * same_stock.astype(np.float64)
    free += speed_std**2 * np.outer(blocks.log_speed, blocks.log_speed)
    free += feed_std**2 * np.outer(blocks.log_feed, blocks.log_feed)
    place = np.arange(len(blocks.trial))
    lag = np.abs(place[:, None] - place)
    variance, degrees = _scatter_within(blocks)
    step = max(_LEAST_STEP, 1.0 / np.sqrt(2.0 * degrees))
    middle = np.bincount(blocks.trial, blocks.into_cut) / np.bincount(blocks.trial)
    along = blocks.into_cut - middle[blocks.trial]
    slopes = np.where(same_trial, np.outer(along, along), 0.0)
    for scatter, memory in product(_SCATTERS, _MEMORIES):
        within = free + np.where(same_trial, memory**lag, 0.0) * variance * np.exp(2.0 * scatter * step)
        for piece, change in product(_PIECES, _ALONG_CUTS):
            yield np.linalg.cholesky(within + piece**2 * same_trial + change**2 * slopes)


def _scatter_within(blocks: Blocks) -> tuple[float, int]:
    """Variance of the blocks about the line through those of their trial, and its degrees of freedom.

    Two blocks are about their mean: a trend within the trial counts as scatter then, which is on the safe side.
    """
    squares, degrees = 0.0, 0
    for trial in range(int(blocks.trial.max()) + 1):
        values = blocks.log_k[blocks.trial == trial]
        count = np.arange(len(values))
        order = min(len(values) - 2, 1)
        squares += float(np.sum((values - np.polyval(np.polyfit(count, values, order), count)) ** 2))
        degrees += len(values) - 1 - order
    return max(squares / degrees, 1e-6), degrees
