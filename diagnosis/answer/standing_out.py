"""Significant regions of the gap, against what an intact machine would show, false discovery rate controlled.

A cell is a part of the whitened equation residuals z that re-tuned parameters leave: an equation in a sector of the
crank angle, in a band of harmonics, in a part of the trials or of the start-up, or at an operating point. Were nothing
but noise, mistuned parameters and background effects (S) there, z = M^-1 y would
have the covariance M^-1 + (M^-1 S)(M^-1 S)'. A cell with probes U is judged by its misfit u' A^-1 u, u = U z, where A
is no smaller than the covariance of u can be, A = U ((1 - C) / b + n C) U' + (U M^-1 S)(U M^-1 S)':

- z is the mean over the b time blocks of a trial that belong to the cell: a gap is what stays.
- What the model of an intact machine misses is the same in every time block and every repeat of an operating point. So
  its share C of the noise counts n times, n being the number of repeats. What scatters from stroke to stroke, the rest,
  is another one in each.
- The noise is taken as large as it is stated, though an intact machine leaves only the share `Weights.quiet` of it:
  that share differs from cell to cell.

The misfit is then a weighted sum of chi-squared numbers with no weight above 1. It is compared with the chi-squared law
with its expectation as degrees of freedom: of all such sums with that expectation, that one has the heaviest tail.

Of all cells together those are significant that the rule of Benjamini and Yekutieli (2001, doi
10.1214/aos/1013699998) allows at a false discovery rate of 5 %; it holds however the cells depend on each other, as
these do: they overlap.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.features import START_UP_EDGES_S
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Part
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.residuals import Equation
from sawbench.modeling.state import TWO_PI

Partition = Literal["crank_angle", "harmonic", "time", "start_up", "operating_point"]
# Partition, equation, and the place of each cell.
_Key = tuple[Partition, Equation, tuple[str, ...]]
N_SECTORS: Final = 24
_BANDS: Final = (0, 1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 65, 129)
_LEAST_EXPECTED: Final = 1e-6


@dataclass(frozen=True, kw_only=True, slots=True)
class Cell:
    """One place of a partition.

    Attributes
    ----------
    partition : Partition
    equation : Equation
    place : str
        Degrees, harmonics, part of the trial's time, time after the first motion, or the operating point.
    misfit : float
        Square of the residual, over what noise and background effects could be.
    expected : float
        Misfit without a gap: the degrees of freedom.
    p_value : float
    q_value : float
        Smallest false discovery rate at which the cell is significant.
    """

    partition: Partition
    equation: Equation
    place: str
    misfit: float
    expected: float
    p_value: float
    q_value: float

    @property
    def stands_out(self) -> bool:
        """Whether the cell is among the discoveries."""
        return self.q_value < SETTINGS.report.false_discovery_rate


@dataclass(frozen=True, kw_only=True, slots=True)
class _Piece:
    """What one trial adds to some cells of one partition and equation.

    Attributes
    ----------
    key : _Key
    block : int or None
        Time block of the part that it reads; None for the mean over all.
    probes : ndarray, shape (n_cells, n_probes, size)
        Of length 1 each, on the whitened features of one block.
    common : ndarray, shape (size, size)
        What the model of an intact machine misses, as a share of the noise of one block.
    n_repeats : int
        Trials that share it.
    """

    key: _Key
    block: int | None
    probes: Floats
    common: Floats
    n_repeats: int


class _Sums:
    """What the trials add to some cells, from which they are judged: everything over the noise at its largest.

    Of the columns that `find_cells` puts side by side: what is left of the data, what small background effects leave,
    and what the nuisances take up. All arrays have the cells first, and the whitened probes of all trials second.
    """

    def __init__(self, n_small: int) -> None:
        self._small, self._taken = slice(1, 1 + n_small), slice(1 + n_small, None)
        self._seen: list[Floats] = []
        self._noise: list[Floats] = []
        self._independent: Floats | float = 0.0

    def add(self, piece: _Piece, columns: Floats, n_blocks: int) -> None:
        """Count one trial in; columns are means over so many of its blocks, shape (size, n_columns)."""
        probes = piece.probes
        common = probes @ piece.common @ probes.mT
        scatter = probes @ probes.mT / n_blocks
        own = scatter - common / n_blocks
        whitener = np.linalg.inv(np.linalg.cholesky(own + piece.n_repeats * common))
        seen = whitener @ (probes @ columns)
        noise, scatter = (whitener @ one @ whitener.mT for one in (own + common, scatter))
        # What nuisances take up of independent noise, they take up of any.
        left = 1.0 - np.sum(seen[:, :, self._taken] ** 2, axis=(1, 2)) / _trace(scatter)
        self._independent += _trace(noise) * left
        self._seen.append(seen)
        self._noise.append(noise)

    def misfits(self) -> tuple[Floats, Floats]:
        """Misfit of each cell and its expectation, shape (n_cells,): on whitened probes, A is 1 + S S'."""
        seen = np.concatenate(self._seen, axis=1)
        data, small, taken = seen[:, :, :1], seen[:, :, self._small], seen[:, :, self._taken]
        explained = _explained_by(small)
        found = np.sum(data * (data - explained @ data), axis=(1, 2))
        expected = self._independent + np.sum(taken * (explained @ taken), axis=(1, 2)) + _trace(explained)
        start = 0
        for noise in self._noise:
            stop = start + noise.shape[-1]
            expected -= np.sum(noise * explained[:, start:stop, start:stop], axis=(1, 2))
            start = stop
        return found, expected


def _explained_by(small: Floats) -> Floats:
    """Share of the probes, S (1 + S'S)^-1 S', that small effects explain, (n_cells, n, n), from S, (n_cells, n, q)."""
    n, n_small = small.shape[1:]
    if n < n_small:
        return np.eye(n) - np.linalg.inv(np.eye(n) + small @ small.mT)
    return small @ np.linalg.solve(np.eye(n_small) + small.mT @ small, small.mT)


def _trace(squares: Floats) -> Floats:
    return np.trace(squares, axis1=1, axis2=2)


def find_cells(problem: LinearProblem, small: Floats | None = None) -> tuple[Cell, ...]:
    """Test every cell of every partition.

    Parameters
    ----------
    problem : LinearProblem
    small : ndarray, shape (n, q), optional
        Nuisance columns of the background effects, times their prior standard deviation; without, there is none.

    Returns
    -------
    tuple of Cell
        In the order of the partitions; cells that nuisances take up wholly are left out.
    """
    marginal = Marginal(problem, scale=problem.wide_scale)
    # M^-1 = I - taken taken'.
    taken = marginal.taken_up().T
    small = marginal.rest(np.zeros((len(taken), 0)) if small is None else small)
    columns = np.hstack([marginal.data_split[1][:, None], small, taken])
    repeats = Counter(p.setting.operating_point for p in problem.parts if p.state.kind == "running")
    found: dict[_Key, _Sums] = {}
    for part in problem.parts:
        by_block = columns[part.place].reshape(part.blocks.shape[0], part.layout.size, -1)
        mean = by_block.mean(axis=0)
        for piece in _pieces(part, max(repeats[part.setting.operating_point], 1)):
            sums = found.setdefault(piece.key, _Sums(small.shape[1]))
            if piece.block is None:
                sums.add(piece, mean, len(by_block))
            else:
                sums.add(piece, by_block[piece.block], 1)
    return _judged(found)


def _judged(found: dict[_Key, _Sums]) -> tuple[Cell, ...]:
    from scipy.special import chdtrc

    judged = {
        (partition, equation, place): (misfit, expected)
        for (partition, equation, places), sums in found.items()
        for place, misfit, expected in zip(places, *map(np.ndarray.tolist, sums.misfits()), strict=True)
    }
    # Rounding may leave less than nothing, for which there is no chi-squared law.
    kept = {key: (misfit, expected) for key, (misfit, expected) in judged.items() if expected > _LEAST_EXPECTED}
    if not kept:
        return ()
    p_values = [float(chdtrc(expected, max(misfit, 0.0))) for misfit, expected in kept.values()]
    q_values = _false_discovery_rates(p_values)
    return tuple(
        Cell(
            partition=partition, equation=equation, place=place, misfit=misfit, expected=expected, p_value=p,
            q_value=float(q),
        )
        for ((partition, equation, place), (misfit, expected)), p, q in zip(
            kept.items(), p_values, q_values, strict=True
        )
    )  # fmt: skip


def _false_discovery_rates(p_values: Sequence[float]) -> Floats:
    """Smallest rate at which each is significant, by Benjamini and Yekutieli.

    `scipy.stats` has it too, and takes half a second to import.
    """
    order = np.argsort(p_values)
    number = np.arange(1, len(order) + 1)
    rates = np.array(p_values)[order] * len(order) / number * np.sum(1.0 / number)
    found = np.empty(len(order))
    found[order] = np.minimum(np.minimum.accumulate(rates[::-1])[::-1], 1.0)
    return found


def _pieces(part: Part, n_repeats: int) -> Iterator[_Piece]:
    n_blocks = part.blocks.shape[0]
    # Rows that read the features, in the units of their equations, from the whitened ones of a block.
    features = np.linalg.inv(part.whitener)

    def piece(key: _Key, probes: Floats, block: int | None = None) -> _Piece:
        return _Piece(key=key, block=block, probes=probes, common=part.common, n_repeats=n_repeats)

    for equation, place in part.layout.slices.items():
        whole = np.eye(part.layout.size)[None, place]
        yield piece(("operating_point", equation, (part.setting.operating_point,)), whole)
        if part.state.kind != "running":
            yield piece(("time", equation, ("start-up",)), whole)
            names = tuple(
                f"{1e3 * start_s:.0f} to {1e3 * stop_s:.0f} ms" for start_s, stop_s in pairwise(START_UP_EDGES_S)
            )
            yield piece(("start_up", equation, names), _unit(features[place])[:, None])
            continue
        for block in range(n_blocks):
            share = f"{100 * block // n_blocks} to {100 * (block + 1) // n_blocks} %"
            yield piece(("time", equation, (share,)), whole, block)
        for partition, names, probes in _over_the_stroke(features[place]):
            yield piece((partition, equation, names), probes)


def _over_the_stroke(features: Floats) -> Iterator[tuple[Partition, tuple[str, ...], Floats]]:
    """Names of cells and probes that read the residual in a sector or in a band of harmonics, over its noise there."""
    n = (len(features) - 1) // 2
    angle = (np.arange(N_SECTORS) + 0.5) * TWO_PI / N_SECTORS
    turns = np.outer(angle, np.arange(1, n + 1))
    waves = _unit(np.hstack([np.ones((N_SECTORS, 1)), np.cos(turns), np.sin(turns)]) @ features)
    width = 360 // N_SECTORS
    sectors = tuple(f"{k * width} to {(k + 1) * width} deg" for k in range(N_SECTORS))
    yield "crank_angle", sectors, waves[:, None]
    amplitudes = _unit(features)
    for low, high in pairwise(_BANDS):
        if low > n:
            return
        orders = np.arange(low, min(high, n + 1))
        rows = orders if low == 0 else np.concatenate([orders, n + orders])
        yield "harmonic", (str(low) if high - low == 1 else f"{low} to {high - 1}",), amplitudes[None, rows]


def _unit(rows: Floats) -> Floats:
    return rows / np.linalg.norm(rows, axis=1)[:, None]
