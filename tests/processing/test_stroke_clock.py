"""Samples lost or sent twice without notice: the strokes tell, in whichever channel it happened."""

import numpy as np
import pytest
from sawbench.bench.config import BenchConfig
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.processing.folding import Cycles
from sawbench.processing.process import process_recording
from sawbench.processing.stroke_clock import find_slips

pytestmark = pytest.mark.unit

STROKE_HZ, SECONDS = 14.0, 6.0


def tables(seed=0, *, load=None, drift_s=0.0):
    """Time and values of three channels of a saw in steady strokes; `load` scales the cut over time."""
    rng = np.random.default_rng(seed)

    def angle(t):
        return 0.7 + 2 * np.pi * STROKE_HZ * t

    slow, fast = np.arange(0, SECONDS, 1e-3), np.arange(0, SECONDS, 1 / 6000)
    # Wood varies from stroke to stroke by 5 %.
    wood = 1 + 0.05 * rng.standard_normal(int(STROKE_HZ * SECONDS) + 3)

    def cut(t, late=0.0):
        scale = np.ones_like(t) if load is None else load(t)
        return scale * wood[(angle(t) // (2 * np.pi)).astype(int)] * np.maximum(-np.sin(angle(t - late)), 0)

    return {
        "displacement_mm": (fast, 10 * (1 - np.cos(angle(fast))) + 0.01 * rng.standard_normal(len(fast))),
        "force_n": (fast, 240 * cut(fast, drift_s * fast / SECONDS) + 0.5 * rng.standard_normal(len(fast))),
        "motor_current_a": (slow, 9 + 2 * cut(slow) + 0.05 * rng.standard_normal(len(slow))),
    }


def shifted(table, seconds, *, at_s=3.0):
    """Lose (negative) or double the samples of so many seconds, the rest closing up."""
    t, values = table
    at, n = np.searchsorted(t, at_s), round(abs(seconds) / (t[1] - t[0]))
    kept = np.r_[values[:at], values[at + n :]] if seconds < 0 else np.r_[values[:at], values[at - n :]]
    n = min(len(kept), len(t))
    return t[:n], kept[:n]


def processed(channels):
    units = {"displacement_mm": "mm", "force_n": "N", "motor_current_a": "A"}
    signals = {name: Signal(channel=name, unit=units[name], time_s=t, values=v) for name, (t, v) in channels.items()}
    return process_recording(Recording(trial=Trial(trial_id="t", material="oak"), signals=signals), BenchConfig())


def doubts(trial):
    return {q.channel: q.doubts for q in trial.quality if q.doubts}


@pytest.mark.parametrize("channel", ["force_n", "motor_current_a", "displacement_mm"])
@pytest.mark.parametrize("seconds", [-0.005, -0.0245, 0.0107])
def test_a_silent_loss_or_doubling_is_found_in_its_channel(channel, seconds):
    channels = tables()
    channels[channel] = shifted(channels[channel], seconds)
    found = processed(channels)
    assert list(doubts(found)) == [channel]
    (said,) = doubts(found)[channel]
    sense, cause = ("earlier", "lost") if seconds < 0 else ("later", "sent twice")
    assert f"{sense} against the strokes" in said and f"samples were {cause}" in said
    at_s, moved_ms = float(said.split()[1]), float(said.split(" ms ")[0].split()[-1])
    assert at_s == pytest.approx(3.0, abs=1.5 / STROKE_HZ)
    assert moved_ms == pytest.approx(1e3 * abs(seconds), rel=0.1)
    assert any(w.startswith(f"{channel}: from") for w in found.warnings)


def test_two_losses_are_two():
    channels = tables()
    channels["force_n"] = shifted(shifted(channels["force_n"], -0.01, at_s=4.0), -0.01, at_s=2.0)
    assert len(doubts(processed(channels))["force_n"]) == 2


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"drift_s": 0.02},
        {"load": lambda t: np.where(t < 3.0, 1.0, 0.4)},
        {"load": lambda t: np.where(t < 3.0, 1.0, 0.0)},
        {"load": np.zeros_like},
    ],
    ids=["steady", "drifting clock", "softer wood", "out of the wood", "in air"],
)
def test_what_is_no_loss_is_not_called_one(options):
    assert not doubts(processed(tables(1, **options)))


def test_a_marked_gap_with_right_times_is_no_slip():
    channels = tables()
    t, values = channels["force_n"]
    there = (t < 3.0) | (t > 3.02)
    channels["force_n"] = t[there], values[there]
    assert not doubts(processed(channels))


def test_the_phase_of_noise_is_no_clock():
    """Without a cut little of a current follows the stroke, and a few strokes of noise agree now and then."""
    angle = CrankAngle(
        time_s=np.array([0.0, 40.0]), angle_rad=np.array([0.0, 80.0 * np.pi * 15.0]), speed_rad_s=np.full(2, 94.2),
        angle_std_rad=np.zeros(2), radius_m=0.01, source="displacement_mm", is_absolute=True,
    )  # fmt: skip
    time_s = np.arange(0.0, 40.0, 1e-3)
    turns = np.arange(600)
    cycles = Cycles(index=turns, start_s=turns / 15.0, end_s=(turns + 1) / 15.0)
    rng = np.random.default_rng(6)
    weak_a = 2.0 + 0.03 * np.cos(2.0 * np.pi * 15.0 * time_s)
    found = []
    for _ in range(60):
        current_a = weak_a + rng.normal(0.0, 0.05, len(time_s))
        found += find_slips(angle, {"motor_current_a": (time_s, current_a)}, {"motor_current_a": cycles})
    assert found == []
