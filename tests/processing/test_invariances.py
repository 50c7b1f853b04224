"""What must not change the result: units of time's origin, sampling, noise, the starting angle."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sawbench.bench.config import BenchConfig
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.processing.crank_angle import track_crank_angle
from sawbench.processing.folding import find_cycles, fold_channels
from sawbench.processing.process import process_recording

pytestmark = pytest.mark.unit


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    rate_hz=st.floats(1.0, 40.0),
    start_rad=st.floats(0.0, 6.28),
    radius_m=st.floats(2e-3, 5e-2),
    offset_m=st.floats(-0.05, 0.05),
    ripple=st.floats(0.0, 0.1),
    samples_a_stroke=st.integers(40, 700),
    seed=st.integers(0, 10**6),
)
def test_any_crank_is_tracked(rate_hz, start_rad, radius_m, offset_m, ripple, samples_a_stroke, seed):
    t = np.arange(0, 12 / rate_hz, 1 / (rate_hz * samples_a_stroke))
    turns = 2 * np.pi * rate_hz * t
    angle = start_rad + turns + ripple * np.sin(turns)
    noise = 1e-3 * radius_m * np.random.default_rng(seed).standard_normal(len(t))
    track = track_crank_angle(t, offset_m + radius_m * (1 - np.cos(angle)) + noise)
    assert track is not None
    error = track.angle_rad - np.interp(track.time_s, t, angle)
    error -= 2 * np.pi * np.round(np.median(error) / (2 * np.pi))
    inner = (track.time_s > 1 / rate_hz) & (track.time_s < 11 / rate_hz)
    assert np.sqrt(np.mean(error[inner] ** 2)) < 5e-3
    assert abs(track.radius_m / radius_m - 1) < 3e-3


@settings(max_examples=20, deadline=None, derandomize=True)
@given(shift_s=st.floats(-1e3, 1e5), scale=st.floats(0.1, 10.0), seed=st.integers(0, 10**6))
def test_the_origin_of_time_and_the_gain_of_the_sensor_do_not_matter(shift_s, scale, seed):
    t = np.arange(0, 1.5, 1 / 2000)
    y = 10 * (1 - np.cos(2 * np.pi * 14 * t)) + 0.01 * np.random.default_rng(seed).standard_normal(len(t))

    def period(time, values):
        signal = Signal(channel="displacement_mm", unit="mm", time_s=time, values=values)
        recording = Recording(trial=Trial(trial_id="p"), signals={"displacement_mm": signal})
        return process_recording(recording, BenchConfig()).period

    first, second = period(t, y), period(t + shift_s, scale * y)
    assert first is not None
    assert second is not None
    assert abs(first.period_s - second.period_s) < 0.3 * first.period_std_s + 1e-9
    assert first.confidence == second.confidence


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), n_bins=st.sampled_from([16, 100, 256]), threads=st.integers(1, 2))
def test_folding_is_linear_and_keeps_constants(seed, n_bins, threads):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 3, 4000))
    angle = np.cumsum(rng.uniform(0.5, 1.5, 4000)) * 0.05
    turns = find_cycles(t, angle, [(t[0], t[-1])]).index
    values = rng.standard_normal((2, 4000))
    rows = np.stack([values[0], values[1], 2 * values[0] - 3 * values[1], np.full(4000, 4.2)])
    mean, std = fold_channels(t, angle, t, rows, turns, n_bins=n_bins, n_threads=threads)
    assert np.allclose(mean[2], 2 * mean[0] - 3 * mean[1], atol=1e-9)
    assert np.allclose(mean[3], 4.2)
    assert np.allclose(std[3], 0, atol=1e-6)
