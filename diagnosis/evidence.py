"""How well each effect, and each pair, explains what mistuned parameters leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from bench.recording import Floats
from diagnosis.effects.effect import Effect
from diagnosis.linear_problem import LinearProblem, Marginal, Widened
from diagnosis.log_mean import log_mean_exp
from diagnosis.weighing import SIZE_TEMPERATURE

_N_AMPLITUDES = 40
# Less than this share of its typical size is background, not a cause.
_LEAST_AMPLITUDE = 0.15
_SAME_VALUE = 1e-6


@dataclass(frozen=True, kw_only=True, slots=True)
class Column:
    """Whitened signature of one effect in one shape.

    Attributes
    ----------
    effect : Effect
    shape : dict
    columns : ndarray, shape (n, q)
        For an amplitude of `typical`; q is 2 or more where the phase is free.
    """

    effect: Effect
    shape: dict[str, float]
    columns: Floats


@dataclass(frozen=True, kw_only=True, slots=True)
class Explanation:
    """What one effect explains at best.

    Attributes
    ----------
    effect : Effect
    log_evidence : float
        Against the same nuisances without the effect; amplitudes and shapes integrated out.
    column : Column
        Of the best shape.
    amplitude, amplitude_std : float
        In multiples of the typical size; least squares with the nuisances.
    gain : float
        Largest fall of the whitened misfit.
    contribution : ndarray, shape (n,)
        Whitened signature at the fitted size and phase.
    shape_spread : float
        Relative standard deviation of the reported strength between the shapes, as likely as they are.
    form_share : float
        How far nature's form seems to be from the best shape, relative: one of those that were tried.
    mixture : (float, float), optional
        Size and its standard deviation over mixtures of the shapes (`diagnosis.size`), in multiples of the typical
        size: what is reported, where it is there, instead of the amplitude of the best shape.
    """

    effect: Effect
    log_evidence: float
    column: Column
    amplitude: float
    amplitude_std: float
    gain: float
    contribution: Floats
    shape_spread: float = 0.0
    form_share: float = 0.0
    mixture: tuple[float, float] | None = None

    @property
    def strength(self) -> float:
        """Reported parameter."""
        if self.mixture is not None:
            return self.mixture[0] * self.effect.strength.typical
        return self.effect.reported_strength(self.amplitude * self.effect.strength.typical, self.column.shape)

    @property
    def strength_std(self) -> float:
        """Its standard uncertainty: from the noise, between the shapes, and from what nature's form differs.

        From the noise: half of what one standard deviation of the amplitude either way changes, tempered as sizes are.
        """
        if self.mixture is not None:
            return float(np.hypot(self.mixture[1] * self.effect.strength.typical, self.form_share * self.strength))
        typical = self.effect.strength.typical
        step = np.sqrt(SIZE_TEMPERATURE) * self.amplitude_std
        high, low = (
            self.effect.reported_strength(typical * max(self.amplitude + sign * step, 1e-6), self.column.shape)
            for sign in (1.0, -1.0)
        )
        known = float(np.hypot(0.5 * (high - low), np.hypot(self.shape_spread, self.form_share) * self.strength))
        # A size that is read off a free wave is right to a factor of two.
        return known if self.effect.size_of is None else max(known, 0.5 * abs(self.strength))


def catalogue_columns(problem: LinearProblem, effects: Sequence[Effect]) -> dict[str, list[Column]]:
    """Whitened signatures of every effect and shape that this campaign can show at all.

    Parameters
    ----------
    problem : LinearProblem
    effects : sequence of Effect

    Returns
    -------
    dict of str to list of Column
        By effect; an empty list where the campaign shows nothing of it.
    """
    out: dict[str, list[Column]] = {}
    for effect in effects:
        found = _columns(problem, effect, effect.shapes)
        out[effect.name] = [
            Column(effect=effect, shape=shape, columns=effect.strength.typical * columns)
            for shape, columns in zip(effect.shapes, found, strict=True)
            if columns is not None
        ]
    return out


def _columns(problem: LinearProblem, effect: Effect, shapes: Sequence[dict[str, float]]) -> list[Floats | None]:
    """Whitened signatures per unit of strength, (n, q) for each shape, or None where nothing shows."""
    if not shapes:
        return []
    baseline = problem.campaign.baseline
    placed = []
    for part in problem.parts:
        groups = [effect.signatures(baseline, part.smooth, shape) for shape in shapes]
        counts = [len(group) for group in groups]
        placed.append((part.place, counts, part.whiten_all([s for group in groups for s in group])))
    ends = [np.cumsum([0, *counts]) for _, counts, _ in placed]
    out: list[Floats | None] = []
    for k in range(len(shapes)):
        stacked = np.zeros((len(problem.data), max(counts[k] for _, counts, _ in placed)))
        for (place, counts, rows), end in zip(placed, ends, strict=True):
            stacked[place, : counts[k]] = rows[end[k] : end[k + 1]].T
        shown = np.isfinite(stacked).all() and np.abs(stacked).max(initial=0.0) * effect.strength.typical > 1e-9
        out.append(stacked if shown else None)
    return out


@lru_cache(maxsize=256)
def amplitudes(low: float, high: float) -> Floats:
    """Grid of amplitudes in multiples of the typical size, equally likely."""
    if high / low < 5.0:
        return np.linspace(low, high, 15)
    return np.geomspace(max(low, _LEAST_AMPLITUDE), high, _N_AMPLITUDES)


def explain(marginal: Marginal, columns: Sequence[Column]) -> Explanation | None:
    """Integrate amplitude and shape of one effect out.

    Parameters
    ----------
    marginal : Marginal
    columns : sequence of Column
        All shapes of one effect.

    Returns
    -------
    Explanation or None
        None where the campaign shows nothing of it.
    """
    if not columns:
        return None
    return _explanation(columns, [marginal.gram(column.columns) for column in columns])


class Catalogue:
    """All columns side by side, with the inner products that no choice of nuisances changes.

    Parameters
    ----------
    columns : dict of str to list of Column
        By effect.
    data : ndarray, shape (n,)
    """

    def __init__(self, columns: dict[str, list[Column]], data: Floats) -> None:
        self.columns = columns
        entries = [column.columns for found in columns.values() for column in found]
        self.stacked = np.hstack([np.zeros((len(data), 0)), *entries])
        self.moments = self.stacked.T @ data
        self.squares = [columns.T @ columns for columns in entries]

    def explain(self, marginal: Marginal) -> dict[str, Explanation]:
        """`explain` for every effect with one product of matrices; without effects that show nothing."""
        half = marginal.half(self.stacked)
        taken = half.T @ marginal.data_half
        found, start, number = {}, 0, 0
        for name, entries in self.columns.items():
            inner = []
            for column in entries:
                place = slice(start, start + column.columns.shape[1])
                part = half[:, place]
                inner.append((self.squares[number] - part.T @ part, self.moments[place] - taken[place]))
                start, number = place.stop, number + 1
            if inner:
                found[name] = _explanation(entries, inner)
        return found


def _explanation(columns: Sequence[Column], inner: Sequence[tuple[Floats, Floats]]) -> Explanation:
    logs, fits = [], []
    for column, (gram, moment) in zip(columns, inner, strict=True):
        grid = amplitudes(column.effect.strength.low, column.effect.strength.high)
        log, solution, std, gain = _one(grid, gram, moment) if len(moment) == 1 else _several(grid, gram, moment)
        leading = column.effect.leading
        if 0 < leading < len(moment) and column.effect.amplitude(solution) < grid[0]:
            log, first, std, gain = _several(grid, gram[:leading, :leading], moment[:leading])
            solution = np.concatenate([first, np.zeros(len(moment) - leading)])
        logs.append(log)
        fits.append((solution, std, gain))
    best = int(np.argmax(logs))
    solution, std, gain = fits[best]
    effect = columns[0].effect
    strengths = [
        effect.reported_strength(effect.amplitude(fit[0]) * effect.strength.typical, column.shape)
        for column, fit in zip(columns, fits, strict=True)
    ]
    return Explanation(
        effect=effect,
        log_evidence=log_mean_exp(logs),
        column=columns[best],
        amplitude=effect.amplitude(solution),
        amplitude_std=std,
        gain=gain,
        contribution=columns[best].columns @ solution,
        shape_spread=_relative_spread(np.array(strengths), np.array(logs)),
    )


def _relative_spread(values: Floats, logs: Floats) -> float:
    """Standard deviation of the values about the likeliest one, over that one; likely as the tempered logs say.

    No less than the shapes that were tried can resolve: even between the likeliest and the next value.
    """
    weights = np.exp((logs - logs.max()) / SIZE_TEMPERATURE)
    best = float(values[np.argmax(logs)])
    if not best:
        return 0.0
    away = np.abs(values - best)
    next_one = float(np.min(away, where=away > _SAME_VALUE * abs(best), initial=np.inf))
    resolved = next_one / np.sqrt(12.0) if np.isfinite(next_one) else 0.0
    return float(np.hypot(np.sqrt(np.sum(weights * away**2) / np.sum(weights)), resolved)) / abs(best)


def explain_formed(
    problem: LinearProblem, fixed: Floats, modes: Floats, columns: Sequence[Column], shares: Sequence[float]
) -> tuple[float, Explanation]:
    """Integrate amplitude and shape out as `explain` does, and how far nature's form may be from the catalogue's.

    Parameters
    ----------
    problem : LinearProblem
    fixed : ndarray, shape (n, p)
        Further nuisance columns, times their prior standard deviation.
    modes : ndarray, shape (n, q)
        Of `form_modes`.
    columns : sequence of Column
        Shapes of one effect.
    shares : sequence of float
        Standard deviations of the form's error to try, equally likely.

    Returns
    -------
    log_evidence : float
        Absolute: of the data, averaged over the shares.
    explanation : Explanation
        For the best share; its `log_evidence` is against the same nuisances and modes without the effect.
    """
    widened = Widened(problem, fixed, modes)
    stacked = np.hstack([c.columns for c in columns])
    cross, own = widened.cross(stacked), stacked.T @ problem.data
    ends = np.cumsum([0, *(c.columns.shape[1] for c in columns)])
    squares = [c.columns.T @ c.columns for c in columns]
    found = []
    for share in shares:
        log_z, data_half, half = widened.at(share, cross)
        inner = [
            (squares[k] - half[:, a:b].T @ half[:, a:b], own[a:b] - half[:, a:b].T @ data_half)
            for k, (a, b) in enumerate(pairwise(ends))
        ]
        explanation = _explanation(columns, inner)
        explanation = replace(explanation, form_share=share)
        found.append((log_z + explanation.log_evidence, explanation))
    return log_mean_exp([log_z for log_z, _ in found]), max(found, key=lambda entry: entry[0])[1]


def _one(grid: Floats, gram: Floats, moment: Floats) -> tuple[float, Floats, float, float]:
    square, inner = float(gram[0, 0]), float(moment[0])
    log = grid * inner - 0.5 * grid**2 * square
    amplitude = float(np.clip(inner / square, grid[0], grid[-1])) if square > 0 else float(grid[0])
    gain = 2.0 * amplitude * inner - amplitude**2 * square
    std = float(1.0 / np.sqrt(square)) if square > 0 else np.inf
    return log_mean_exp(log), np.array([amplitude]), std, gain


def _several(grid: Floats, gram: Floats, moment: Floats) -> tuple[float, Floats, float, float]:
    """Amplitude with free phases: every part is normal with variance amplitude^2 / 2."""
    spread = 0.5 * grid**2
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    turned = vectors.T @ moment
    inner = 1.0 + spread[:, None] * values
    log = 0.5 * spread * np.sum(turned**2 / inner, axis=1) - 0.5 * np.log(inner).sum(axis=1)
    regular = gram + 1e-9 * np.trace(gram) * np.eye(len(moment))
    solution = np.linalg.solve(regular, moment)
    std = float(np.sqrt(0.5 * np.trace(np.linalg.inv(regular)[:2, :2])))
    return log_mean_exp(log), solution, std, float(moment @ solution)


def background(problem: LinearProblem, effects: Sequence[Effect]) -> Floats:
    """Nuisance columns for small amounts of every effect, shape (n, q), times their prior standard deviation."""
    return np.hstack([np.zeros((len(problem.data), 0)), *little_of_each(problem, effects).values()])


def little_of_each(problem: LinearProblem, effects: Sequence[Effect]) -> dict[str, Floats]:
    """`background` by the name of the effect."""
    found = {}
    for effect in effects:
        sizes = [share * effect.strength.typical for _, share in effect.little]
        shown = _columns(problem, effect, [shape for shape, _ in effect.little])
        kept = [columns * size for columns, size in zip(shown, sizes, strict=True) if columns is not None]
        found[effect.name] = np.hstack([np.zeros((len(problem.data), 0)), *kept])
    return found
