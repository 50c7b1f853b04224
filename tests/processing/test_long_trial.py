"""The measured radius of a trial with so many strokes that only some dead centres are fitted."""

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
