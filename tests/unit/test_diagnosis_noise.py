"""The noise of a bench is known from its own strokes: in starts, in signatures, in what an intact machine leaves."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from bench.processed import CrankAngle
from bench.recording import Signal
from diagnosis.features import HARMONICS, START_UP_EDGES_S, Layout, harmonics
from diagnosis.noise import contrast_misfit, noise_of, scatter_of
from diagnosis.reduction import _signal_share, bin_means
from diagnosis.screening import _defect_of
from diagnosis.state import TWO_PI
from diagnosis.stroke_ripple import N_RIPPLE, restore_ripple
from tests.contract.test_effects import running, start_up

RADIUS_M = 0.01
RATE_HZ = 12.0


@pytest.mark.parametrize("rate_hz", [1000.0, 1300.0, 5000.0])
def test_the_mean_of_a_cell_is_that_of_the_cells_time(rate_hz):
    """A straight line has its mean at the middle, wherever in the cell the samples lie."""
    time_s = 0.00037 + np.arange(int(0.5 * rate_hz)) / rate_hz
    edges = np.arange(0.1, 0.4, 1e-3)
    expected = 3.0 + 20.0 * 0.5 * (edges[1:] + edges[:-1])
    assert np.allclose(bin_means(time_s, 3.0 + 20.0 * time_s, edges), expected, atol=1e-9)


def test_a_gap_in_the_samples_is_bridged():
    time_s = np.concatenate([np.arange(0.0, 0.2, 1e-3), np.arange(0.3, 0.5, 1e-3)])
    edges = np.arange(0.1, 0.4, 0.01)
    assert np.allclose(bin_means(time_s, 5.0 * time_s, edges), 5.0 * 0.5 * (edges[1:] + edges[:-1]), atol=1e-9)


def tracked(ripple_rad=0.01, order=2, noise_m=50e-6, seconds=6.0, rate_hz=5000.0):
    """A crank with a ripple, and a tracker that saw it turn evenly."""
    time_s = np.arange(int(seconds * rate_hz)) / rate_hz
    even = TWO_PI * RATE_HZ * time_s
    true = even + ripple_rad * np.sin(order * even)
    noise = noise_m * np.random.default_rng(1).standard_normal(len(time_s))
    angle = CrankAngle(
        time_s=time_s,
        angle_rad=even,
        speed_rad_s=np.full(len(time_s), TWO_PI * RATE_HZ),
        angle_std_rad=np.full(len(time_s), 1e-3),
        radius_m=RADIUS_M,
        source="displacement_mm",
        is_absolute=True,
    )
    return angle, true, RADIUS_M * (1.0 - np.cos(true)) + noise


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_ripple_that_a_tracker_missed_comes_back(order):
    angle, true, displacement_m = tracked(order=order)
    found, std_rad = restore_ripple(angle, angle.time_s, displacement_m)
    late = angle.time_s > 2.0
    before, after = (np.std((a.angle_rad - true)[late]) for a in (angle, found))
    assert before == pytest.approx(0.01 / np.sqrt(2.0), rel=0.02)
    assert after < 0.1 * before
    speed = np.gradient(true, angle.time_s)
    assert np.std((found.speed_rad_s - speed)[late]) < 0.15 * np.std((angle.speed_rad_s - speed)[late])
    assert std_rad.shape == (N_RIPPLE,) and 0.0 < std_rad[order - 1] < 1e-3


def test_the_stated_uncertainty_of_the_ripple_holds():
    errors = []
    for seed in range(40):
        angle, _, displacement_m = tracked(ripple_rad=0.0, noise_m=0.0, seconds=3.0)
        noise = 2e-4 * np.random.default_rng(seed).standard_normal(len(displacement_m))
        found, std_rad = restore_ripple(angle, angle.time_s, displacement_m + noise)
        late = angle.time_s > 2.0
        wave = (found.angle_rad - angle.angle_rad)[late]
        turns = angle.angle_rad[late]
        errors.append([2.0 * np.mean(wave * np.cos(k * turns)) / std_rad[k - 1] for k in (1, 2, 3)])
    assert 0.7 < np.std(errors) < 1.3


def test_a_short_trial_keeps_its_angle():
    angle, _, displacement_m = tracked(seconds=1.0)
    found, std_rad = restore_ripple(angle, angle.time_s, displacement_m)
    assert found is angle
    assert not std_rad.any()


def test_a_blade_that_stands_says_nothing_of_the_ripple():
    angle, _, displacement_m = tracked(ripple_rad=0.0)
    still = angle.time_s > 3.0
    stopped = float(angle.angle_rad[~still][-1])
    halted = replace(
        angle,
        angle_rad=np.where(still, stopped, angle.angle_rad),
        speed_rad_s=np.where(still, 0.0, angle.speed_rad_s),
    )
    displacement_m = np.where(still, displacement_m[~still][-1] + 3e-4, displacement_m)
    found, _ = restore_ripple(halted, angle.time_s, displacement_m)
    assert np.abs((found.angle_rad - halted.angle_rad)[~still]).max() < 5e-4


def noisy_strokes(n_units, std, slow_std, rng):
    """Features of strokes that hold white noise of one standard deviation a sample, and a mean that drifts."""
    n_points = 128
    waves = std * rng.standard_normal((n_units, n_points)) + slow_std * rng.standard_normal((n_units, 1))
    return harmonics(waves, HARMONICS["converter"])


def test_the_noise_of_a_start_follows_from_the_strokes():
    """White noise: a bin's variance is the samples' over their number, at the same sample rate."""
    rng = np.random.default_rng(3)
    layout = Layout(kind="running", equations=("converter",))
    state = running(is_idle=True)
    features = noisy_strokes(400, 0.5, 0.0, rng)
    pooled = scatter_of([(one_stroke_units(state, 400), layout, features)])
    sample_s = 1.0 / RATE_HZ / 128
    start = Layout(kind="start_up", equations=("converter",))
    found = np.diag(noise_of(start_up(), start, np.eye(1), pooled, RATE_HZ))
    widths = np.array([b - a for a, b in pairwise(START_UP_EDGES_S)])
    assert np.allclose(found, 0.5**2 * sample_s / widths, rtol=0.25)


def test_a_mean_that_drifts_is_alike_in_neighbouring_bins_of_a_start():
    rng = np.random.default_rng(4)
    layout = Layout(kind="running", equations=("converter",))
    features = noisy_strokes(400, 0.01, 0.3, rng)
    pooled = scatter_of([(one_stroke_units(running(is_idle=True), 400), layout, features)])
    found = noise_of(start_up(), Layout(kind="start_up", equations=("converter",)), np.eye(1), pooled, RATE_HZ)
    assert np.allclose(np.diag(found), 0.3**2, rtol=0.2)
    assert found[0, 1] / found[0, 0] > 0.9 > found[0, -1] / found[0, 0]


def test_idle_trials_too_short_to_scatter_take_that_of_the_others():
    rng = np.random.default_rng(8)
    layout = Layout(kind="running", equations=("converter",))
    cutting, idle = one_stroke_units(running(), 50), running(is_idle=True)
    pooled = scatter_of([(cutting, layout, noisy_strokes(50, 0.5, 0.0, rng))])
    assert noise_of(idle, layout, np.full((1, 3), 1.0 / 3.0), pooled, RATE_HZ).any()


def one_stroke_units(state, n_units):
    return replace(state, n_strokes=np.ones(n_units))


def test_without_scatter_a_start_has_no_noise_of_its_own():
    start = Layout(kind="start_up", equations=("converter",))
    assert not noise_of(start_up(), start, np.eye(1), {}, RATE_HZ).any()


@pytest.mark.parametrize("trend", [0.0, 5.0])
def test_contrasts_see_noise_and_neither_mean_nor_trend(trend):
    rng = np.random.default_rng(5)
    rows = [2.0 * rng.standard_normal((4, 50)) + 7.0 + trend * np.arange(4)[:, None] for _ in range(40)]
    assert contrast_misfit(rows) == pytest.approx(4.0, rel=0.1)


def test_contrasts_of_short_trials_say_nothing():
    assert contrast_misfit([np.ones((3, 5))]) == 0.0


def test_noise_is_taken_out_of_signatures_and_signals_stay():
    rng = np.random.default_rng(6)
    angle = np.arange(128) * TWO_PI / 128
    rows = np.fft.rfft(5.0 * np.cos(3 * angle) + rng.standard_normal((16, 128)), axis=1)
    share = _signal_share(rows)
    assert share[3] > 0.99
    assert share[0] == 1.0
    assert np.mean(share[10:]) < 0.1


def coarse_current(peak_a, top_a=np.inf):
    """A current in steps of 0.1 A: a second at rest, then strokes, then rest."""
    time_s = np.arange(20_000) / 2000.0
    runs = (time_s > 1.0) & (time_s < 9.5)
    values = np.where(runs, 3.0 + peak_a * np.sin(TWO_PI * 12.0 * time_s) ** 2, 0.0)
    values = np.minimum(np.round(values / 0.1) * 0.1, top_a)
    return Signal(channel="motor_current_a", unit="A", time_s=time_s, values=values)


def test_a_coarse_converter_at_rest_is_not_saturated():
    assert _defect_of(coarse_current(8.0)) is None


def test_a_current_that_dies_is_found():
    alive = coarse_current(8.0)
    dead = replace(alive, values=np.where(alive.time_s < 3.0, alive.values, 0.0))
    assert _defect_of(dead) is not None


def test_a_saturated_current_is_still_found():
    defect = _defect_of(coarse_current(8.0, top_a=7.0))
    assert defect is not None and "7 A" in defect[0]
