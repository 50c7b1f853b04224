"""The streaming splitter on motions known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.errors import InputError
from sawbench.bench.recording import SampleBlock
from sawbench.processing.live_strokes import LiveStrokeSplitter

pytestmark = pytest.mark.unit

RIPPLE = 0.2


def crank_angle(time_s, period_s):
    """Uneven turn: the blade is slower on one half, as when it cuts."""
    turn = 2 * np.pi * time_s / period_s
    return turn + RIPPLE * np.sin(turn)


def blocks(channel, unit, time_s, values, n=300, first_index=0):
    for first in range(0, len(time_s), n):
        part = slice(first, first + n)
        yield SampleBlock(
            device="d",
            channel=channel,
            unit=unit,
            first_index=first_index + first,
            time_s=time_s[part],
            values=values[part],
        )


def stream(*, period_s=0.075, rest_s=0.5, run_s=2.0, noise_mm=0.01, seed=0, force_zero_n=3.0):
    """Blocks in order of time: rest, then strokes from the dead centre on."""
    rng = np.random.default_rng(seed)
    slow, fast = np.arange(0, rest_s + run_s, 1e-3), np.arange(0, rest_s + run_s, 1 / 6000)
    angle = crank_angle(np.maximum(fast - rest_s, 0), period_s)
    y_mm = 10 - 10 * np.cos(angle) + noise_mm * rng.normal(size=fast.size)
    force_n = force_zero_n + np.where(fast > rest_s, 100 * np.maximum(-np.sin(angle), 0), 0)
    current_a = np.where(slow > rest_s, 12 + 2 * np.sin(2 * np.pi * (slow - rest_s) / period_s), 0)
    parts = [
        *blocks("displacement_mm", "mm", fast, y_mm),
        *blocks("force_n", "N", fast, force_n),
        *blocks("motor_current_a", "A", slow, current_a, n=50),
    ]
    return sorted(parts, key=lambda block: block.time_s[-1])


def split(parts):
    splitter = LiveStrokeSplitter()
    return splitter, [stroke for block in parts for stroke in splitter.update(block)]


def test_periods_and_means_of_an_uneven_noisy_turn():
    splitter, strokes = split(stream())
    assert len(strokes) in {24, 25}
    settled = [s for s in strokes if s.is_settled]
    assert len(settled) >= 22
    np.testing.assert_allclose([s.period_s for s in settled], 0.075, rtol=1e-3)
    assert np.mean([s.period_s for s in settled]) == pytest.approx(0.075, rel=1e-4)
    # The dead centres themselves, to half a per cent of the stroke.
    phase = (np.array([s.start_s for s in settled]) - 0.5) / 0.075
    np.testing.assert_allclose(phase, np.round(phase), atol=5e-3)
    # Fine quadrature of the closed form over one stroke.
    fine = np.linspace(0, 0.075, 200_001)
    force = np.trapezoid(100 * np.maximum(-np.sin(crank_angle(fine, 0.075)), 0), fine) / 0.075
    assert splitter.rest_force_n == pytest.approx(3.0, abs=1e-12)
    for stroke in settled:
        assert stroke.mean_force_n == pytest.approx(3.0 + force, rel=1e-3)
        assert stroke.mean_current_a == pytest.approx(12.0, rel=1e-3)
        assert stroke.battery_voltage_v is None


def test_a_stroke_is_given_at_most_a_stroke_late():
    splitter = LiveStrokeSplitter()
    for block in stream():
        for stroke in splitter.update(block):
            assert block.time_s[-1] - stroke.end_s < 0.075 + 2 * 300 / 6000


def test_block_size_does_not_matter():
    whole = stream()
    _, coarse = split(whole)
    pieces = [
        SampleBlock(
            device="d", channel=b.channel, unit=b.unit, first_index=b.first_index + k,
            time_s=b.time_s[k : k + 37], values=b.values[k : k + 37],
        )
        for b in whole
        for k in range(0, len(b.time_s), 37)
    ]  # fmt: skip
    _, fine = split(pieces)
    by_start = {round(s.start_s, 3): s for s in fine}
    common = [s for s in coarse if round(s.start_s, 3) in by_start]
    assert len(common) >= 22
    for stroke in common:
        other = by_start[round(stroke.start_s, 3)]
        assert other.mean_force_n == pytest.approx(stroke.mean_force_n, rel=1e-3)


def test_a_gap_in_the_force_leaves_no_mean_and_no_stroke_too_few():
    parts = [b for b in stream() if not (b.channel == "force_n" and 1.5 <= b.time_s[0] < 1.55)]
    _, strokes = split(parts)
    hit = [s for s in strokes if s.mean_force_n is None]
    assert 1 <= len(hit) <= 2
    assert all(s.start_s < 1.56 and s.end_s > 1.5 for s in hit)
    assert all(s.mean_current_a is not None for s in hit)


def test_a_gap_in_the_displacement_makes_no_long_stroke():
    parts = [b for b in stream() if not (b.channel == "displacement_mm" and 1.5 <= b.time_s[0] < 1.7)]
    _, strokes = split(parts)
    assert max(s.period_s for s in strokes) < 0.08
    assert not any(s.start_s < 1.6 < s.end_s for s in strokes)
    assert sum(s.start_s > 1.7 for s in strokes) >= 8


def test_a_lost_channel_does_not_hold_the_strokes_back():
    parts = [b for b in stream() if b.channel != "motor_current_a" or b.time_s[-1] < 1.0]
    _, strokes = split(parts)
    assert strokes[-1].end_s > 1.8
    assert strokes[-1].mean_current_a is None
    assert strokes[-1].mean_force_n is not None


def test_noise_at_rest_makes_no_strokes():
    _, strokes = split(stream(run_s=0.0, rest_s=2.0, noise_mm=0.05))
    assert strokes == []


def test_buffers_stay_small_over_a_long_run():
    splitter = LiveStrokeSplitter()
    largest = 0
    for block in stream(run_s=10.0):
        splitter.update(block)
        largest = max(largest, *(len(s.time_s) for s in splitter._streams.values()))
    assert largest < 6000 * 3


def test_nonsense_settings_are_refused_by_name():
    with pytest.raises(InputError, match="window_s"):
        LiveStrokeSplitter(window_s=0.0)
