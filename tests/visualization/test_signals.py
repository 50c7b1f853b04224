"""The pure parts of the display: the envelope and the live stroke rate."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.visualization.envelope import envelope_indices
from sawbench.visualization.stroke_rate import LiveStrokeRate

pytestmark = pytest.mark.unit


def test_envelope_keeps_every_lonely_peak():
    time_s = np.arange(50_000) / 5000.0
    values = np.zeros(50_000)
    peaks = np.arange(137, 50_000, 997)
    values[peaks] = np.where(np.arange(len(peaks)) % 2, 1.0, -1.0)
    kept = envelope_indices(time_s, values, max_rate_hz=200.0)
    assert set(peaks) <= set(kept)
    assert len(kept) <= 200.0 * 10.0 + 2


def test_envelope_is_increasing_and_leaves_slow_signals_alone():
    rng = np.random.default_rng(7)
    time_s = np.cumsum(rng.uniform(0.5e-3, 1.5e-3, 2000))
    values = rng.normal(size=2000)
    kept = envelope_indices(time_s, values, max_rate_hz=100.0)
    assert np.all(np.diff(kept) > 0)
    assert values[kept].max() == values.max()
    assert values[kept].min() == values.min()
    assert len(envelope_indices(time_s, values, max_rate_hz=5000.0)) == 2000


@pytest.mark.parametrize("n", [0, 1, 2])
def test_envelope_of_hardly_anything(n):
    assert len(envelope_indices(np.arange(n) / 10.0, np.ones(n), max_rate_hz=1000.0)) == n


@pytest.mark.parametrize("block", [1, 7, 250, 10_000])
@pytest.mark.parametrize("rate_hz", [3.0, 13.9, 42.0])
def test_stroke_rate_does_not_depend_on_the_blocks(block, rate_hz):
    rng = np.random.default_rng(3)
    time_s = np.arange(10_000) / 5000.0
    values = 10.0 * (1.0 - np.cos(2.0 * np.pi * rate_hz * time_s)) + rng.normal(0.0, 0.05, len(time_s))
    estimator, found = LiveStrokeRate(), []
    for first in range(0, len(time_s), block):
        found += estimator.update(time_s[first : first + block], values[first : first + block])
    settled = np.array([rate for at_s, rate in found if at_s > 1.0])
    assert len(settled) in {int(rate_hz) - 1, int(rate_hz), int(rate_hz) + 1}
    # One sample of noise moves a crossing by 0.05 mm over the slope at mid-stroke.
    crossing_std_s = 0.05 / (10.0 * 2.0 * np.pi * rate_hz)
    tolerance_hz = 6.0 * rate_hz**2 * crossing_std_s + 1e-3 * rate_hz
    assert np.abs(settled - rate_hz).max() < tolerance_hz


def test_stroke_rate_is_silent_at_rest():
    rng = np.random.default_rng(5)
    assert LiveStrokeRate().update(np.arange(5000) / 5000.0, rng.normal(0.0, 0.05, 5000)) == []


def test_stroke_rate_does_not_bridge_a_pause():
    time_s = np.arange(5000) / 5000.0
    values = 10.0 - 10.0 * np.cos(2.0 * np.pi * 10.0 * time_s)
    estimator = LiveStrokeRate()
    estimator.update(time_s, values)
    after = estimator.update(time_s + 5.0, values)
    assert after
    assert min(at_s for at_s, _ in after) > 5.0
    np.testing.assert_allclose([rate for _, rate in after], 10.0, rtol=1e-3)
