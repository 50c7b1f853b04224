"""Means of samples over cells of the crank angle or of time.

Everything that estimates from strokes takes its means here: the fit of k_Fc stroke by stroke, the states of the
diagnosis in units of strokes, the cutting coefficient of single strokes, what is asynchronous with the stroke. A cell
holds the mean of the samples that fall into it, so all of them count. The folded cycle that is shown (`folding`)
instead takes one interpolated value a stroke and bin: it has a value in every bin at any sample rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.recording import Floats

TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, kw_only=True, slots=True)
class AngleGrid:
    """Cells of the crank angle: rows of one or more whole turns, laid over one turn.

    Attributes
    ----------
    first_turn : int
        Turn number at which the first row starts.
    n_rows : int
    n_bins : int
        Cells a turn.
    turns_per_row : int

    Examples
    --------
    >>> t = np.arange(0, 1, 1e-3)
    >>> grid = AngleGrid(first_turn=2, n_rows=3, n_bins=4)
    >>> grid.means(grid.place(2 * np.pi * 10 * t), 10 * t)[:, 0].round(2).tolist()
    [2.12, 3.12, 4.12]
    """

    first_turn: int
    n_rows: int
    n_bins: int
    turns_per_row: int = 1

    @classmethod
    def over_one_turn(cls, angle_rad: Floats, n_bins: int) -> AngleGrid:
        """Give the grid that lays all whole turns of some angles over one another, in one row."""
        first, last = (int(np.floor(end / TWO_PI)) for end in (angle_rad.min(), angle_rad.max()))
        return cls(first_turn=first, n_rows=1, n_bins=n_bins, turns_per_row=last - first + 1)

    @property
    def middles_rad(self) -> Floats:
        """Middle of every cell within the turn, shape (n_bins,)."""
        return np.asarray((np.arange(self.n_bins) + 0.5) * TWO_PI / self.n_bins, dtype=np.float64)

    def place(self, angle_rad: Floats) -> NDArray[np.int64]:
        """Flat index row * n_bins + bin of each angle, -1 outside."""
        turns = angle_rad / TWO_PI - self.first_turn
        whole = np.floor(turns)
        row = whole.astype(np.int64) // self.turns_per_row
        cell = np.minimum(((turns - whole) * self.n_bins).astype(np.int64), self.n_bins - 1)
        return np.where((row >= 0) & (row < self.n_rows), row * self.n_bins + cell, -1)

    def place_samples(self, angle_time_s: Floats, angle_rad: Floats, time_s: Floats) -> NDArray[np.int64]:
        """Flat index of samples at given times, -1 also where no angle was measured."""
        placed = self.place(np.interp(time_s, angle_time_s, angle_rad))
        placed[(time_s < angle_time_s[0]) | (time_s > angle_time_s[-1])] = -1
        return placed

    def sums(self, placed: NDArray[np.int64], values: Floats) -> tuple[Floats, NDArray[np.int64]]:
        """Sum and number of the samples in each cell, each of shape (n_rows, n_bins)."""
        kept, size = placed >= 0, self.n_rows * self.n_bins
        total = np.bincount(placed[kept], weights=values[kept], minlength=size).astype(np.float64, copy=False)
        count = np.bincount(placed[kept], minlength=size).astype(np.int64, copy=False)
        return total.reshape(self.n_rows, self.n_bins), count.reshape(self.n_rows, self.n_bins)

    def means(self, placed: NDArray[np.int64], values: Floats) -> Floats:
        """Mean of the samples in each cell, NaN where there are none, shape (n_rows, n_bins)."""
        total, count = self.sums(placed, values)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    def coverage(self, placed: NDArray[np.int64]) -> Floats:
        """Share of the cells of each row that hold a sample, shape (n_rows,)."""
        return (self.sums(placed, np.zeros(len(placed)))[1] > 0).mean(axis=1)


def time_cell_means(time_s: Floats, values: Floats, edges_s: Floats) -> Floats:
    """Mean between neighbouring edges of the line through the samples, shape (len(edges_s) - 1,).

    With about one sample a cell, the mean of the samples alone would be that of another time.
    """
    before, after = min(time_s[0], edges_s[0]) - 1e-9, max(time_s[-1], edges_s[-1]) + 1e-9
    t = np.concatenate([[before], time_s, [after]])
    v = np.concatenate([values[:1], values, values[-1:]])
    area = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    k = np.clip(np.searchsorted(t, edges_s, side="right") - 1, 0, len(t) - 2)
    into = edges_s - t[k]
    slope = (v[k + 1] - v[k]) / np.maximum(t[k + 1] - t[k], 1e-12)
    return np.diff(area[k] + (v[k] + 0.5 * slope * into) * into) / np.diff(edges_s)
