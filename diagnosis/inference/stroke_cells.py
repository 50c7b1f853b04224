"""A channel in cells of the crank angle, stroke by stroke, and what it has there beside its mean stroke."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.peaks import Peak
from sawbench.modeling.state import TWO_PI
from sawbench.processing.binning import AngleGrid

_CELLS, _FEWEST_CELLS, _SAMPLES_A_CELL = 64, 16, 1.5
_MOST_EMPTY: Final = 0.02
# Of the mean stroke: as fine as its samples allow, for they fall elsewhere in every stroke.
_MEAN_CELLS, _SAMPLES_A_MEAN = 128, 16


def beside_mean_stroke(
    turned_rad: Floats, values: Floats, first_turn: int, n_strokes: int
) -> tuple[Floats, Floats] | None:
    """What samples have beyond a linear trend and the mean of all strokes at their crank angle.

    The mean is taken off the samples, not off the means of cells: a few samples lie now in the first, now in the last
    half of a cell, and where the stroke is steep their means beat at orders that are not there.

    Parameters
    ----------
    turned_rad, values : ndarray, shape (n,)
    first_turn, n_strokes : int

    Returns
    -------
    tuple of ndarray, shapes (n,) and (n_strokes, n_cells), or None
        Of the samples, and their means over each cell of the crank angle, NaN where there is none. None where there are
        too few samples, or too many of the cells are empty.
    """
    inside = AngleGrid(first_turn=first_turn, n_rows=1, n_bins=1, turns_per_row=n_strokes).place(turned_rad) >= 0
    n_inside = np.count_nonzero(inside)
    n_cells = min(_CELLS, int(n_inside / n_strokes / _SAMPLES_A_CELL))
    if n_cells < _FEWEST_CELLS:
        return None
    level = values - _trend(turned_rad[inside], values[inside], turned_rad)
    for n_means in (max(min(_MEAN_CELLS, n_inside // _SAMPLES_A_MEAN), n_cells), n_cells):
        of_all = AngleGrid(first_turn=first_turn, n_rows=1, n_bins=n_means, turns_per_row=n_strokes)
        stroke = of_all.means(of_all.place(turned_rad), level)[0]
        if not np.isnan(stroke).any():
            break
    else:
        return None
    left = level - _periodic(stroke, turned_rad)
    grid = AngleGrid(first_turn=first_turn, n_rows=n_strokes, n_bins=n_cells)
    cells = grid.means(grid.place(turned_rad), left)
    return None if np.mean(np.isnan(cells)) > _MOST_EMPTY else (left, cells)


def _trend(turned_rad: Floats, values: Floats, at_rad: Floats) -> Floats:
    """Value at some angles of the straight line that fits best."""
    middle_rad, mean = turned_rad.mean(), values.mean()
    off_rad = turned_rad - middle_rad
    return mean + float(off_rad @ (values - mean)) / float(off_rad @ off_rad) * (at_rad - middle_rad)


def _periodic(stroke: Floats, turned_rad: Floats) -> Floats:
    """Value at some angles, by a cubic spline, of a wave that is given at the middles of even cells of the turn."""
    from scipy.ndimage import map_coordinates

    place = (turned_rad / TWO_PI % 1.0) * len(stroke) - 0.5
    return np.asarray(map_coordinates(stroke, [place], order=3, mode="grid-wrap"), dtype=np.float64)


def filled(cells: Floats) -> Floats:
    """Interpolate empty cells."""
    flat = cells.ravel()
    known = np.flatnonzero(~np.isnan(flat))
    return np.interp(np.arange(flat.size), known, flat[known]).reshape(cells.shape)


def is_read(cells: Floats | None, n_strokes: int) -> np.ndarray:
    """Strokes without an empty cell, in them or in those beside them; all where the channel is not there."""
    if cells is None:
        return np.ones(n_strokes, dtype=bool)
    is_broken = np.asarray(np.isnan(cells).any(axis=1))
    beside = np.zeros_like(is_broken)
    beside[1:] |= is_broken[:-1]
    beside[:-1] |= is_broken[1:]
    return ~(is_broken | beside)


def without_strokes(cells: Floats) -> Floats:
    """Take the mean stroke and its linear trend out."""
    number = np.linspace(-1.0, 1.0, len(cells))[:, None]
    left = cells - cells.mean(axis=0)
    return left - number * (number * left).sum(axis=0) / float((number**2).sum())


def without_lines(left: Floats, at_s: Floats, lines: Sequence[Peak]) -> Floats:
    """Take out lines at fixed frequencies, each of which is known to half the resolution of its spectrum."""
    if not lines:
        return left
    phase = TWO_PI * np.outer(at_s, [line.place + off * line.width for line in lines for off in (-0.5, 0.0, 0.5)])
    waves = np.hstack([np.cos(phase), np.sin(phase)])
    return left - (waves @ np.linalg.lstsq(waves, left.ravel())[0]).reshape(left.shape)
