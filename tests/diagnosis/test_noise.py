"""The noise of a bench is known from its own strokes: in starts, in signatures, in what an intact machine leaves."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from sawbench.bench.recording import Signal
from sawbench.diagnosis.channel_defects import defect_of
from sawbench.diagnosis.inference.features import HARMONICS, START_UP_EDGES_S, Layout, harmonics, time_bins
from sawbench.diagnosis.inference.noise import contrast_misfit, noise_of, scatter_of
from sawbench.diagnosis.smooth_state import _signal_share, power_by_chance
from sawbench.modeling.state import TWO_PI

from tests.rigs.drawn_states import running, start_up

pytestmark = pytest.mark.unit

RATE_HZ = 12.0


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


@pytest.mark.parametrize("equation", ["converter", "supply", "electrical"])
def test_what_a_converter_chops_is_as_noisy_as_its_current_is_large(equation):
    """Ripple of 0.02 of the current, in an idle run of 0.5 A and a cut of 5 A; a start draws up to 40 A."""
    rng = np.random.default_rng(9)
    layout, share = Layout(kind="running", equations=(equation,)), 0.02
    trials = [
        (
            replace(one_stroke_units(running(is_idle=is_idle), 400), current_a=np.full((400, 128), current_a)), layout,
            harmonics(share * current_a * rng.standard_normal((400, 128)), HARMONICS[equation]),
        )
        for is_idle, current_a in ((True, 0.5), (False, 5.0))
    ]  # fmt: skip
    start = start_up()
    noise = noise_of(start, Layout(kind="start_up", equations=(equation,)), np.eye(1), scatter_of(trials), RATE_HZ)
    std_a = np.sqrt(np.diag(noise) * np.diff(START_UP_EDGES_S) * 128 * RATE_HZ)
    drawn_a = np.sqrt(time_bins(start.current_a**2)[0])
    # The motor's own balance has no chopped current: its noise is that of the idle run.
    assert np.allclose(std_a, share * (0.5 if equation == "electrical" else drawn_a), rtol=0.25)


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


@pytest.mark.parametrize("n_rows", [4, 6, 8, 20])
def test_noise_seldom_passes_for_a_motion_of_the_blade(n_rows):
    """In any of 27 harmonics of the mean of a trial, in one trial of twenty or less: the fewer rows, the less."""
    rng = np.random.default_rng(n_rows)
    least = power_by_chance(n_rows, 27)
    passed = 0
    for _ in range(1000):
        rows = rng.standard_normal((n_rows, 28)) + 1j * rng.standard_normal((n_rows, 28))
        passed += _signal_share(rows, least)[1:].any()
    assert 3 <= passed <= 70


def coarse_current(peak_a, top_a=np.inf):
    """A current in steps of 0.1 A: a second at rest, then strokes, then rest."""
    time_s = np.arange(20_000) / 2000.0
    runs = (time_s > 1.0) & (time_s < 9.5)
    values = np.where(runs, 3.0 + peak_a * np.sin(TWO_PI * 12.0 * time_s) ** 2, 0.0)
    values = np.minimum(np.round(values / 0.1) * 0.1, top_a)
    return Signal(channel="motor_current_a", unit="A", time_s=time_s, values=values)


def test_a_coarse_converter_at_rest_is_not_saturated():
    assert defect_of(coarse_current(8.0)) is None


def coarse_stroke(stops_s):
    """A displacement in steps of 0.05 mm that stands still from some time on."""
    time_s = coarse_current(8.0).time_s
    values = np.round(10.0 * np.cos(TWO_PI * 12.0 * np.minimum(time_s, stops_s)) / 0.05) * 0.05
    return Signal(channel="displacement_mm", unit="mm", time_s=time_s, values=values)


def test_sensors_of_a_machine_at_rest_are_not_dead():
    """The trigger is released at 6 s of 10 s, and the blade runs on for half a second."""
    alive, stroke = coarse_current(8.0), coarse_stroke(6.5)
    released = replace(alive, values=np.where(alive.time_s < 6.0, alive.values, 0.0))
    assert defect_of(stroke, [released]) is None
    assert defect_of(released, [stroke]) is None
    # While the other one still runs, it is.
    assert defect_of(stroke, [alive]) is not None
    assert defect_of(released, [coarse_stroke(10.0)]) is not None


def test_a_current_that_dies_is_found():
    alive = coarse_current(8.0)
    dead = replace(alive, values=np.where(alive.time_s < 3.0, alive.values, 0.0))
    assert defect_of(dead) is not None


def test_a_saturated_current_is_still_found():
    defect = defect_of(coarse_current(8.0, top_a=7.0))
    assert defect is not None and "7 A" in defect[0]
