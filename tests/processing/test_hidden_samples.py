"""Samples of a slow instrument whose period other recordings tell, in one where the last digit hides them."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.processing.hidden_samples import hidden_period, is_hidden_by, samples_at_period
from sawbench.processing.interpolated_rows import own_samples

pytestmark = pytest.mark.unit

ROW_S, DIGIT_A = 1.0 / 2000.0, 0.01
SPEED_RAD_S = 2 * np.pi * 17.3


def idle_current(slow_hz, *, kind, ripple_a=0.05, phase=0.37, rate_error=0.0):
    """Battery current of an idle run, of a slow instrument, and what a table with two digits makes of it."""
    rng = np.random.default_rng(7)
    at_s = (phase + np.arange(int(6.0 * slow_hz))) / slow_hz * (1.0 + rate_error)
    current = 0.5 + ripple_a * np.sin(SPEED_RAD_S * at_s) + 0.2 * ripple_a * rng.standard_normal(len(at_s))
    time_s = np.arange(at_s[0] + 0.3 * ROW_S, at_s[-1], ROW_S)
    held = current[np.searchsorted(at_s, time_s, side="right") - 1]
    rows = held if kind == "steps" else np.interp(time_s, at_s, current)
    return at_s, current, time_s, np.round(np.round(rows / DIGIT_A) * DIGIT_A, 2)


@pytest.mark.parametrize("slow_hz", [50.0, 100.0, 200.0])
@pytest.mark.parametrize("kind", ["steps", "lines"])
def test_each_sample_comes_back_at_its_time_though_the_digits_hide_it(kind, slow_hz):
    at_s, current, time_s, rows = idle_current(slow_hz, kind=kind)
    found = samples_at_period(time_s, rows, 1.0 / slow_hz, DIGIT_A)
    assert found is not None
    found_s, samples = found
    assert abs(len(samples) - len(at_s)) <= 2
    nearest = np.argmin(np.abs(found_s[:, None] - at_s), axis=1)
    assert np.abs(found_s - at_s[nearest]).max() <= ROW_S
    # A sample is read from its rows at least as well as one row says it.
    assert np.std(samples - current[nearest]) < DIGIT_A / np.sqrt(12.0) * 1.1


def test_what_lines_take_off_the_ripple_is_there_again():
    """Lines between samples of 50 Hz keep 0.68 of a ripple of 17.3 Hz: (sin(x) / x)^2 at x = pi 17.3 / 50."""
    _, _, time_s, rows = idle_current(50.0, kind="lines")

    def ripple(at_s, values):
        waves = np.column_stack([np.ones_like(at_s), np.cos(SPEED_RAD_S * at_s), np.sin(SPEED_RAD_S * at_s)])
        return np.hypot(*np.linalg.lstsq(waves, values, rcond=None)[0][1:])

    assert own_samples(time_s, rows)[1] is rows
    assert ripple(time_s, rows) == pytest.approx(0.05 * np.sinc(17.3 / 50.0) ** 2, rel=0.03)
    assert ripple(*samples_at_period(time_s, rows, 0.02, DIGIT_A)) == pytest.approx(0.05, rel=0.03)


@pytest.mark.parametrize("period_s", [0.02, 0.01, 0.005])
@pytest.mark.parametrize("noise_a", [0.004, 0.02])
def test_rows_that_are_samples_themselves_stay(noise_a, period_s):
    rng = np.random.default_rng(11)
    time_s = ROW_S * np.arange(12_000)
    current = 0.5 + 0.05 * np.sin(SPEED_RAD_S * time_s) + noise_a * rng.standard_normal(len(time_s))
    assert samples_at_period(time_s, np.round(current, 2), period_s, DIGIT_A) is None


def test_a_hole_in_the_rows_makes_no_samples():
    at_s, _, time_s, rows = idle_current(100.0, kind="lines")
    is_there = (time_s < 2.0) | (time_s > 2.5)
    found_s, _ = samples_at_period(time_s[is_there], rows[is_there], 0.01, DIGIT_A)
    assert not np.any((found_s > 2.0 + 0.01) & (found_s < 2.5 - 0.01))
    assert abs(len(found_s) - np.sum((at_s < 2.0) | (at_s > 2.5))) <= 4


@pytest.mark.parametrize("slow_hz", [50.0, 100.0, 200.0, 500.0])
@pytest.mark.parametrize(("ripple_a", "row_hz"), [(0.3, 2000.0), (2.0, 5000.0)])
def test_the_period_of_lines_is_found_though_no_corner_is_seen(ripple_a, row_hz, slow_hz):
    rng = np.random.default_rng(5)
    at_s = (0.37 + np.arange(int(8.0 * slow_hz))) / slow_hz
    current = 6.0 + ripple_a * np.sin(SPEED_RAD_S * at_s) + 0.1 * ripple_a * rng.standard_normal(len(at_s))
    time_s = np.arange(at_s[0], at_s[-1], 1.0 / row_hz)
    rows = np.round(np.interp(time_s, at_s, current), 2)
    assert is_hidden_by(rows, DIGIT_A)
    # As closely as a phase stays known over the trial.
    assert hidden_period(time_s, rows, DIGIT_A) * slow_hz == pytest.approx(1.0, abs=0.1 / (8.0 * slow_hz))


def test_noise_above_the_last_digit_hides_nothing():
    rng = np.random.default_rng(5)
    time_s = ROW_S * np.arange(12_000)
    assert not is_hidden_by(
        np.round(6.0 + np.sin(SPEED_RAD_S * time_s) + 0.02 * rng.standard_normal(12_000), 2), DIGIT_A
    )
    assert not is_hidden_by(np.sin(time_s), 0.0)


@pytest.mark.parametrize("step", [0.001, 0.02, 0.1])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_smooth_signal_that_is_sampled_at_every_row_has_at_most_the_period_of_its_strokes(noise, step):
    """The corners that rounding makes come once a stroke or more: another stroke rate has other ones."""
    rng, found = np.random.default_rng(5), []
    for rate_hz in (12.3, 17.1, 22.9):
        time_s = ROW_S * np.arange(16_000)
        smooth = 18.0 - 0.02 * time_s - 0.08 * np.sin(4.0 * np.pi * rate_hz * time_s)
        rows = np.round(np.round((smooth + noise * step * rng.standard_normal(16_000)) / step) * step, 3)
        found.append(hidden_period(time_s, rows, step))
    periods_s = [period_s for period_s in found if period_s is not None]
    assert len(set(np.round(periods_s, 4))) == len(periods_s)


@pytest.mark.parametrize("n", [3, 60, 110, 140, 160])
def test_a_short_channel_has_no_period_and_no_warning(n):
    """Fifty periods of three rows are the least: in a shorter one there is no spectrum to look at."""
    time_s = 0.05 * np.arange(n)
    assert hidden_period(time_s, np.round(18.0 - 0.01 * time_s, 2), DIGIT_A) is None
