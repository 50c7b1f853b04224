"""Measured cycles: binning against known curves, gaps kept, nonsense refused."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.modeling.measured_cycles import MeasuredCycles
from sawbench.processing.measured_cycles import cycles_from_samples

pytestmark = pytest.mark.unit

TWO_PI = 2.0 * np.pi


def turning(seconds: float = 3.0, rate_hz: float = 2000.0) -> tuple[np.ndarray, np.ndarray]:
    time_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    return time_s, TWO_PI * (8.0 * time_s + 0.1 * np.sin(5.0 * time_s) + 0.37)


def test_bins_hold_the_mean_of_the_curve_over_the_bin():
    time_s, angle = turning(rate_hz=20000.0)
    cycles = cycles_from_samples(time_s, angle, None, {"force_n": (time_s, np.sin(angle))}, n_bins=32)
    width = TWO_PI / 32
    expected = np.sin(cycles.angle_rad) * np.sinc(width / TWO_PI)
    np.testing.assert_allclose(cycles.mean("force_n"), expected, atol=2e-3)


def test_cycle_starts_and_periods_follow_the_angle():
    time_s, angle = turning()
    cycles = cycles_from_samples(time_s, angle, None, {}, n_bins=16)
    starts = np.interp(TWO_PI * np.arange(1, 1 + cycles.n_cycles), angle, time_s)
    np.testing.assert_allclose(cycles.cycle_start_s, starts, atol=1e-9)
    np.testing.assert_allclose(cycles.cycle_start_s[1:], cycles.cycle_start_s[:-1] + cycles.period_s[:-1])


def test_slow_channel_on_its_own_clock_leaves_marked_gaps():
    time_s, angle = turning()
    slow_s = np.arange(0.011, 2.9, 0.02)
    slow_current = np.interp(slow_s, time_s, np.cos(angle))
    cycles = cycles_from_samples(time_s, angle, None, {"motor_current_a": (slow_s, slow_current)}, n_bins=32)
    assert cycles.current_a is not None
    filled = np.isfinite(cycles.current_a)
    assert 0.1 < filled.mean() < 0.4
    np.testing.assert_allclose(
        cycles.current_a[filled], np.broadcast_to(np.cos(cycles.angle_rad), filled.shape)[filled], atol=0.12
    )


def test_only_complete_strokes_inside_the_stretch():
    time_s, angle = turning()
    cycles = cycles_from_samples(time_s, angle, None, {}, start_s=1.0, end_s=2.0, n_bins=16)
    assert cycles.cycle_start_s[0] >= 1.0
    assert cycles.cycle_start_s[-1] + cycles.period_s[-1] <= 2.0
    assert cycles.n_cycles in (6, 7, 8)


def test_battery_is_averaged_per_stroke():
    time_s, angle = turning()
    cycles = cycles_from_samples(time_s, angle, None, {"battery_voltage_v": (time_s, 18.0 - time_s)}, n_bins=16)
    middle = cycles.cycle_start_s + 0.5 * cycles.period_s
    assert cycles.battery_voltage_v is not None
    np.testing.assert_allclose(cycles.battery_voltage_v, 18.0 - middle, atol=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"period_s": [0.1, -0.1]}, "period_s"),
        ({"cycle_start_s": [0.1, 0.0]}, "cycle_start_s"),
        ({"force_n": [[1.0, 2.0]]}, "force_n"),
        ({"force_n": [[1.0, np.inf], [1.0, 1.0]]}, "force_n"),
        ({"duty": 43.75}, "duty"),
    ],
)
def test_nonsense_is_refused_by_name(change, message):
    good = {"angle_rad": [1.0, 3.0], "cycle_start_s": [0.0, 0.1], "period_s": [0.1, 0.1]}
    with pytest.raises(InputError, match=message):
        MeasuredCycles(**(good | change))


def test_angle_that_runs_backwards_and_trials_without_a_stroke_are_refused():
    time_s, angle = turning()
    with pytest.raises(InputError, match="not decrease"):
        cycles_from_samples(time_s, -angle, None, {})
    with pytest.raises(InputError, match="no complete stroke"):
        cycles_from_samples(time_s, 0.001 * angle, None, {})
