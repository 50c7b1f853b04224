"""The measured radius where only some of many dead centres are fitted, and where each has few samples."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.processing.crank_angle import track_crank_angle

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("n_strokes", [150, 250, 420, 500, 810])
def test_radius_is_measured_however_many_strokes_there_are(n_strokes):
    rate_hz, stroke_hz, radius_m = 3000.0, 17.0, 0.00977
    time_s = np.arange(0.0, n_strokes / stroke_hz, 1.0 / rate_hz)
    angle = 2 * np.pi * stroke_hz * time_s
    noise = 1e-5 * np.random.default_rng(n_strokes).standard_normal(len(time_s))
    tracked = track_crank_angle(time_s, radius_m * (1 - np.cos(angle)) + noise, mechanism=Mechanism(radius_m=0.01))
    assert tracked is not None
    assert tracked.radius_m == pytest.approx(radius_m, rel=1e-3)
    middle = slice(len(tracked.time_s) // 4, 3 * len(tracked.time_s) // 4)
    assert np.ptp(tracked.speed_rad_s[middle]) < 0.05 * 2 * np.pi * stroke_hz


@pytest.mark.parametrize("samples_a_stroke", [28.0, 33.7, 35.5, 41.0])
@pytest.mark.parametrize("rod_share", [np.inf, 3.0])
def test_radius_is_measured_with_few_samples_a_stroke(samples_a_stroke, rod_share):
    """1 kHz and 28 strokes a second are 36: the nominal radius, 3 % off here, is no substitute for the measured one."""
    stroke_hz, radius_m = 28.0, 0.00977
    time_s = np.arange(0.0, 5.0, 1.0 / (samples_a_stroke * stroke_hz))
    angle = 2 * np.pi * stroke_hz * time_s + 0.03 * np.sin(4 * np.pi * stroke_hz * time_s)
    lean = np.sin(angle) / rod_share
    rod_m = 0.0 if np.isinf(rod_share) else rod_share * radius_m
    displacement_m = radius_m * (1 - np.cos(angle)) + rod_m * (1 - np.sqrt(1 - lean**2))
    noise = 2e-5 * np.random.default_rng(3).standard_normal(len(time_s))
    nominal = Mechanism(radius_m=0.01007, rod_length_m=rod_m or None)
    tracked = track_crank_angle(time_s, displacement_m + noise, mechanism=nominal)
    assert tracked.radius_m == pytest.approx(radius_m, rel=1e-3)
