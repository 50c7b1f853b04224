"""Means over cells of time and of the crank angle."""

import numpy as np
import pytest
from sawbench.processing.binning import AngleGrid, time_cell_means

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("rate_hz", [1000.0, 1300.0, 5000.0])
def test_the_mean_of_a_cell_is_that_of_the_cells_time(rate_hz):
    """A straight line has its mean at the middle, wherever in the cell the samples lie."""
    time_s = 0.00037 + np.arange(int(0.5 * rate_hz)) / rate_hz
    edges = np.arange(0.1, 0.4, 1e-3)
    expected = 3.0 + 20.0 * 0.5 * (edges[1:] + edges[:-1])
    assert np.allclose(time_cell_means(time_s, 3.0 + 20.0 * time_s, edges), expected, atol=1e-9)


def test_a_gap_in_the_samples_is_bridged():
    time_s = np.concatenate([np.arange(0.0, 0.2, 1e-3), np.arange(0.3, 0.5, 1e-3)])
    edges = np.arange(0.1, 0.4, 0.01)
    assert np.allclose(time_cell_means(time_s, 5.0 * time_s, edges), 5.0 * 0.5 * (edges[1:] + edges[:-1]), atol=1e-9)


def turning(rate_hz, seconds, sample_hz):
    time_s = np.arange(int(seconds * sample_hz)) / sample_hz
    return time_s, 2.0 * np.pi * rate_hz * time_s


@pytest.mark.parametrize("turns_per_row", [1, 3])
def test_a_wave_of_the_crank_angle_is_the_same_in_every_row(turns_per_row):
    angle = turning(11.7, 2.0, 20_000.0)
    grid = AngleGrid(first_turn=2, n_rows=6, n_bins=48, turns_per_row=turns_per_row)
    time_s = 0.013 + np.arange(9_000) / 4_700.0
    wave = 3.0 + np.cos(2.0 * np.pi * 11.7 * time_s - 0.4)
    means = grid.means(grid.place_samples(*angle, time_s), wave)
    # The mean of a cosine over a cell of width w is sinc(w / 2 pi) times its value at the middle, if the cell is full.
    expected = 3.0 + np.sinc(1.0 / 48) * np.cos(grid.middles_rad - 0.4)
    assert means.shape == (6, 48)
    assert np.nanmax(np.abs(means - expected)) < 0.07
    assert np.nanmax(np.abs(np.nanmean(means, axis=0) - expected)) < 0.02


def test_samples_outside_the_rows_or_the_measured_angle_count_nowhere():
    angle = turning(10.0, 1.0, 1_000.0)
    grid = AngleGrid(first_turn=-2, n_rows=20, n_bins=8)
    placed = grid.place_samples(*angle, np.array([-0.05, 0.05, 0.9985, 1.5]))
    assert placed.tolist() == [-1, 2 * 8 + 4, 11 * 8 + 7, -1]
    total, count = grid.sums(placed, np.array([np.inf, 2.0, 3.0, np.inf]))
    assert total.sum() == 5.0 and count.sum() == 2
    assert np.isnan(grid.means(placed, np.ones(4))).sum() == 20 * 8 - 2


def test_every_sample_of_whole_turns_counts_once():
    rng = np.random.default_rng(5)
    angle = turning(9.3, 3.0, 5_000.0)
    grid = AngleGrid(first_turn=1, n_rows=8, n_bins=31, turns_per_row=3)
    time_s = np.sort(rng.uniform(0.0, 2.99, 4_000))
    values = rng.standard_normal(4_000)
    total, count = grid.sums(grid.place_samples(*angle, time_s), values)
    turns = 9.3 * time_s
    inside = (turns >= 1.0) & (turns < 25.0)
    assert count.sum() == inside.sum()
    assert total.sum() == pytest.approx(values[inside].sum())
    assert grid.coverage(grid.place_samples(*angle, time_s)).min() == 1.0
