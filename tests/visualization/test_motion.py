"""What moves with the crank in the view: geometry of the mechanisms, and the mean stroke as it grows."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Signal
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.visualization.motion import cycle_as_it_grows, frame_times, mechanism_strips

pytestmark = pytest.mark.unit


def make_angle(n_turns=4.0, start_rad=0.0, rate_hz=10.0):
    time_s = 0.2 + np.arange(round(n_turns / rate_hz * 1000.0) + 1) / 1000.0
    angle_rad = start_rad + 2.0 * np.pi * rate_hz * (time_s - 0.2)
    return CrankAngle(
        time_s=time_s, angle_rad=angle_rad, speed_rad_s=np.gradient(angle_rad, time_s),
        angle_std_rad=np.full(len(time_s), 1e-3), radius_m=0.01, source="displacement_mm", is_absolute=True,
    )  # fmt: skip


@pytest.mark.parametrize("rod_length_m", [None, 0.025])
def test_a_mechanism_keeps_its_lengths_and_moves_the_blade_by_the_stroke(rod_length_m):
    angle_rad = np.linspace(0.0, 4.0 * np.pi, 101)
    strips = mechanism_strips(Mechanism(radius_m=0.01, rod_length_m=rod_length_m), angle_rad)
    crank, link, blade = strips["crank"], strips["link"], strips["blade"]
    np.testing.assert_allclose(np.linalg.norm(crank[:, 1] - crank[:, 0], axis=1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(link[:, 1] - link[:, 0], axis=1), 2.5)
    np.testing.assert_allclose(blade[:, :, 1], 0.0)
    head = blade[:, 0, 0]
    # The displacement is smallest at angle 0: a yoke moves away from there, a slider towards the crank.
    assert head[0] == (head.min() if rod_length_m is None else head.max())
    assert np.ptp(head) == pytest.approx(2.0)
    if rod_length_m is None:
        # The pin stays in the slot of the yoke.
        np.testing.assert_allclose(link[:, 0, 0], crank[:, 1, 0])
    else:
        np.testing.assert_allclose(link[:, 0], crank[:, 1])
        np.testing.assert_allclose(link[:, 1], blade[:, 0])


def test_frames_are_equally_many_in_every_stroke():
    angle = make_angle(n_turns=3.0)
    at_rad = np.interp(frame_times(angle), angle.time_s, angle.angle_rad)
    assert np.diff(at_rad).max() < 2.0 * np.pi / 45
    assert np.ptp(np.diff(at_rad)) < 1e-6


def test_the_mean_stroke_holds_the_strokes_that_are_complete():
    angle = make_angle(n_turns=4.5, start_rad=np.pi)
    time_s = np.arange(0.0, 1.0, 1e-4)
    turn = np.floor(np.interp(time_s, angle.time_s, angle.angle_rad) / (2.0 * np.pi))
    signal = Signal(channel="force_n", unit="N", time_s=time_s, values=turn)
    end_s, means = cycle_as_it_grows(angle, signal, 10)
    # Half a turn, then turns 1 to 4 whole: 0.1 s each from 0.25 s on.
    np.testing.assert_allclose(end_s, [0.35, 0.45, 0.55, 0.65], atol=1e-3)
    np.testing.assert_allclose(means, np.array([1.0, 1.5, 2.0, 2.5])[:, None] * np.ones(10), atol=0.02)


def test_no_whole_stroke_is_no_step():
    angle = make_angle(n_turns=0.6, start_rad=0.5)
    signal = Signal(channel="force_n", unit="N", time_s=angle.time_s, values=angle.time_s)
    end_s, means = cycle_as_it_grows(angle, signal, 10)
    assert len(end_s) == len(means) == 0
