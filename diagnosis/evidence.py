"""How well each effect, and each pair, explains what mistuned parameters leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.recording import Floats
from diagnosis.effects.effect import Effect
from diagnosis.linear_problem import LinearProblem, Marginal

_N_AMPLITUDES = 40
# Every effect of the catalogue may be there a little without being "the" cause: its background amplitude, as a
# share of its typical size (one standard deviation).
BACKGROUND_SHARE = 0.05


@dataclass(frozen=True, kw_only=True, slots=True)
class Column:
    """Whitened signature of one effect in one shape.

    Attributes
    ----------
    effect : Effect
    shape : dict
    columns : ndarray, shape (n, q)
        For an amplitude of `typical`; q is 2 where the phase is free.
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
    """

    effect: Effect
    log_evidence: float
    column: Column
    amplitude: float
    amplitude_std: float
    gain: float

    @property
    def strength(self) -> float:
        """Reported parameter."""
        return self.effect.reported_strength(self.amplitude * self.effect.strength.typical, self.column.shape)

    @property
    def strength_std(self) -> float:
        """Its standard uncertainty."""
        return abs(self.effect.reported_strength(self.amplitude_std * self.effect.strength.typical, self.column.shape))


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
    baseline = problem.campaign.baseline
    out: dict[str, list[Column]] = {}
    for effect in effects:
        found = []
        for shape in effect.shapes:
            parts: list[Floats] = []
            rows: list[tuple[slice, list[Floats]]] = []
            for part in problem.parts:
                signatures = effect.signatures(baseline, part.smooth, shape)
                rows.append((part.place, [part.whiten(s) for s in signatures]))
            q = max(len(columns) for _, columns in rows)
            for k in range(q):
                column = np.zeros(len(problem.data))
                for place, columns in rows:
                    if k < len(columns):
                        column[place] = columns[k]
                parts.append(effect.strength.typical * column)
            stacked = np.array(parts).T
            if np.isfinite(stacked).all() and np.abs(stacked).max(initial=0.0) > 1e-9:
                found.append(Column(effect=effect, shape=shape, columns=stacked))
        out[effect.name] = found
    return out


def amplitudes(effect: Effect) -> Floats:
    """Grid of amplitudes in multiples of the typical size, equally likely."""
    low, high = effect.strength.low, effect.strength.high
    if high / low < 5.0:
        return np.linspace(low, high, 15)
    return np.geomspace(max(low, 0.1), high, _N_AMPLITUDES)


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
    logs, fits = [], []
    for column in columns:
        gram, moment = marginal.gram(column.columns)
        grid = amplitudes(column.effect)
        log, amplitude, std, gain = _one(grid, gram[0, 0], moment[0]) if len(moment) == 1 else _two(grid, gram, moment)
        logs.append(log)
        fits.append((amplitude, std, gain))
    best = int(np.argmax(logs))
    top = max(logs)
    return Explanation(
        effect=columns[0].effect,
        log_evidence=top + float(np.log(np.mean(np.exp(np.array(logs) - top)))),
        column=columns[best],
        amplitude=fits[best][0],
        amplitude_std=fits[best][1],
        gain=fits[best][2],
    )


def _one(grid: Floats, gram: float, moment: float) -> tuple[float, float, float, float]:
    log = grid * moment - 0.5 * grid**2 * gram
    top = float(log.max())
    amplitude = float(np.clip(moment / gram, grid[0], grid[-1])) if gram > 0 else float(grid[0])
    gain = 2.0 * amplitude * moment - amplitude**2 * gram
    std = float(1.0 / np.sqrt(gram)) if gram > 0 else np.inf
    return top + float(np.log(np.mean(np.exp(log - top)))), amplitude, std, gain


def _two(grid: Floats, gram: Floats, moment: Floats) -> tuple[float, float, float, float]:
    """Amplitude with a free phase: the two parts are normal with variance amplitude^2 / 2."""
    logs = []
    for amplitude in grid:
        spread = 0.5 * amplitude**2
        inner = np.eye(2) + spread * gram
        logs.append(0.5 * spread * moment @ np.linalg.solve(inner, moment) - 0.5 * np.linalg.slogdet(inner)[1])
    log = np.array(logs)
    top = float(log.max())
    regular = gram + 1e-9 * np.trace(gram) * np.eye(2)
    solution = np.linalg.solve(regular, moment)
    std = float(np.sqrt(0.5 * np.trace(np.linalg.inv(regular))))
    return (
        top + float(np.log(np.mean(np.exp(log - top)))), float(np.hypot(*solution)), std,
        float(moment @ solution),
    )  # fmt: skip


def background(columns: dict[str, list[Column]], *, leave_out: Sequence[str] = ()) -> Floats | None:
    """Nuisance columns for small amounts of every effect, shape (n, q), times their prior std; None if none."""
    chosen = [found[0].columns * BACKGROUND_SHARE for name, found in columns.items() if found and name not in leave_out]
    return np.hstack(chosen) if chosen else None
