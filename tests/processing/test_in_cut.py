"""Strokes in air before and behind a cut are left out; wood of any kind, and sensors of any kind, are no air."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.config import BenchConfig
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.processing.in_cut import find_cut
from sawbench.processing.process import process_recording

pytestmark = pytest.mark.unit

SECONDS, STROKES_HZ, SAMPLES_HZ = 8.0, 14.0, 3000.0
T = np.arange(0.0, SECONDS, 1.0 / SAMPLES_HZ)


def depth(into_s, out_s, ramp_s=0.2):
    """How far the blade is in the wood, 0 to 1."""
    return np.clip((T - into_s) / ramp_s, 0.0, 1.0) * np.clip((out_s - T) / ramp_s, 0.0, 1.0)


def turning(spin_up_s=0.05):
    """Crank that starts at once."""
    turned = 2.0 * np.pi * STROKES_HZ * (T - spin_up_s * (1.0 - np.exp(-T / spin_up_s)))
    return CrankAngle(
        time_s=T, angle_rad=turned, speed_rad_s=np.gradient(turned, T), angle_std_rad=np.zeros(len(T)),
        radius_m=0.01, source="displacement_mm", is_absolute=True,
    )  # fmt: skip


def force_of(angle, cuts, noise_n=2.0, seed=5):
    half = np.maximum(-np.sin(angle.angle_rad), 0.0) * angle.speed_rad_s / angle.speed_rad_s.max()
    return 150.0 * cuts * half + noise_n * np.random.default_rng(seed).standard_normal(len(T))


@pytest.mark.parametrize("zero_n", [0.0, -40.0, 60.0])
def test_strokes_in_air_are_none_of_the_cut(zero_n):
    angle = turning()
    cut = find_cut(angle, T, force_of(angle, depth(2.0, 6.5)) + zero_n)
    assert 2.0 < cut.start_s < 2.5
    assert 6.1 < cut.end_s < 6.5


def test_only_one_end_is_in_air():
    angle = turning()
    late, early = (find_cut(angle, T, force_of(angle, depth(*of))) for of in ((2.0, 20.0), (-1.0, 6.5)))
    assert late.end_s is None
    assert 2.0 < late.start_s < 2.5
    assert early.start_s is None
    assert 6.1 < early.end_s < 6.5


@pytest.mark.parametrize("out_s", [SECONDS + 0.02, SECONDS + 0.1])
def test_a_recording_that_ends_while_the_blade_comes_out(out_s):
    """No stroke of it is wholly in air."""
    angle = turning()
    cut = find_cut(angle, T, force_of(angle, depth(-1.0, out_s, ramp_s=0.4)))
    assert cut.start_s is None
    assert out_s - 0.7 < cut.end_s < out_s - 0.25


@pytest.mark.parametrize(
    "cuts",
    [
        pytest.param(np.ones(len(T)), id="from the first stroke to the last"),
        pytest.param(1.0 + 0.5 * np.sin(2.0 * np.pi * 0.7 * T), id="grain"),
        pytest.param(np.exp(-T / SECONDS), id="softer and softer"),
        pytest.param(1.0 - (np.abs(T - 4.0) < 0.5 / STROKES_HZ), id="a crack of the wood"),
        pytest.param((np.floor(STROKES_HZ * T) % 2), id="every second stroke"),
        pytest.param(np.zeros(len(T)), id="all in air"),
    ],
)
def test_what_cuts_all_along_or_never_has_no_air(cuts):
    angle = turning()
    assert find_cut(angle, T, force_of(angle, cuts)) is None


@pytest.mark.parametrize("seed", range(10))
def test_noise_is_no_cut(seed):
    angle = turning()
    assert find_cut(angle, T, 30.0 * np.random.default_rng(seed).standard_normal(len(T))) is None


def processed(cuts, **trial):
    angle = turning()
    force_n = force_of(angle, cuts)
    values = {
        "force_n": ("N", force_n),
        "displacement_mm": ("mm", 10.0 * (1.0 - np.cos(angle.angle_rad))),
        "motor_current_a": ("A", 3.0 + 0.05 * force_n),
    }
    signals = {n: Signal(channel=n, unit=unit, time_s=T, values=v) for n, (unit, v) in values.items()}
    recording = Recording(trial=Trial(trial_id="t", duty=0.4, **trial), signals=signals, path="x.mcap")
    return process_recording(recording, BenchConfig(), source_sha256="ab")


def test_a_trial_is_processed_by_its_strokes_in_the_wood():
    whole, part = processed(np.ones(len(T))), processed(depth(2.0, 6.5))
    assert part.peak_force_n == pytest.approx(whole.peak_force_n, rel=0.01)
    assert part.mean_values["motor_current_a"] == pytest.approx(whole.mean_values["motor_current_a"], rel=0.01)
    assert [p.kind for p in part.phases][-3:] == ["in_air", "running", "in_air"]
    assert any("the strokes in air are left out" in warning for warning in part.warnings)
    assert part.period.confidence == whole.period.confidence == "high"
    assert part.steady.settled_s > 2.4
    assert part.steady.end_s < 6.5
    assert not any("in air" in warning for warning in whole.warnings)


def test_an_idle_trial_has_no_cut():
    assert processed(np.zeros(len(T)), material="none").steady.cut is None
