"""Faults of sensors are listed with channel, size and unit; a clean bench has none."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.bench.config import BenchConfig
from sawbench.bench.recording import Recording, Signal, Trial
from sawbench.diagnosis.answer.signals import signal_findings
from sawbench.diagnosis.inference.gain_drift import GainDrift, gain_drifts
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.zero_wander import ZeroWander
from sawbench.diagnosis.signal_health import channel_health
from sawbench.processing.process import process_recording

pytestmark = pytest.mark.unit

RATE_HZ, SECONDS = 2000.0, 6.0
STILL = ZeroWander(density_n2_s=1e-5, density_std_n2_s=1e-5, white_n=0.05, memory_s=10.0, restart_n=0.05)


def findings(change=lambda rng, time_s, force_n: (time_s, force_n), wander=STILL, jitter=0.0):
    """Faults of three trials with displacement and force, by what was found in the force."""
    health = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        exact_s = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
        angle = 2.0 * np.pi * 15.0 * exact_s
        force_n = 60.0 * np.maximum(-np.sin(angle), 0.0) + 0.5 * rng.standard_normal(len(angle))
        travel_mm = 10.0 * (1.0 - np.cos(angle)) + 0.01 * rng.standard_normal(len(angle))
        time_s, force_n = change(rng, exact_s, force_n)
        if jitter:
            time_s = np.sort(time_s + jitter / RATE_HZ * rng.standard_normal(len(time_s)))
        signals = {
            "force_n": Signal(channel="force_n", unit="N", time_s=time_s, values=force_n),
            "displacement_mm": Signal(channel="displacement_mm", unit="mm", time_s=exact_s, values=travel_mm),
        }
        trial = process_recording(Recording(trial=Trial(trial_id=f"t{seed}"), signals=signals), BenchConfig())
        health += channel_health(trial)
    listed = signal_findings(
        SimpleNamespace(plant=SimpleNamespace(known=()), off_stroke=(), health=tuple(health)), wander
    )
    assert all(set(s) == {"channel", "finding", "frequency_hz", "magnitude", "unit", "words"} for s in listed)
    assert all(s["channel"] == "force_n" for s in listed)
    return {s["finding"]: s for s in listed}


def test_a_clean_bench_has_no_faults():
    assert findings() == {}
    assert findings(wander=None) == {}


def test_steps_coarser_than_the_noise():
    found = findings(lambda rng, t, f: (t, 2.0 * np.round(f / 2.0)))
    assert set(found) == {"quantisation"}
    assert found["quantisation"]["magnitude"] == pytest.approx(2.0)
    assert "quantisation" not in findings(lambda rng, t, f: (t, 0.1 * np.round(f / 0.1)))


def test_spikes_are_counted():
    def change(rng, time_s, force_n):
        force_n = force_n.copy()
        force_n[np.linspace(500, len(force_n) - 500, 9).astype(int)] += 200.0
        return time_s, force_n

    found = findings(change)
    assert set(found) == {"spikes"}
    assert (found["spikes"]["magnitude"], found["spikes"]["unit"]) == (pytest.approx(9.0 / SECONDS, rel=0.01), "1/s")


def test_spikes_at_one_crank_angle_are_impacts():
    def change(rng, time_s, force_n):
        force_n = force_n.copy()
        force_n[np.searchsorted(time_s, np.arange(0.2, SECONDS - 0.2, 1.0 / 15.0))] += 200.0
        return time_s, force_n

    found = findings(change)
    assert set(found) == {"impacts"}
    assert found["impacts"]["magnitude"] == pytest.approx(15.0 * (SECONDS - 0.4) / SECONDS, rel=0.02)


def test_missing_samples_are_counted():
    def change(rng, time_s, force_n):
        kept = rng.random(len(time_s)) > 0.02
        return time_s[kept], force_n[kept]

    found = findings(change)
    assert set(found) == {"missing_samples"}
    assert found["missing_samples"]["magnitude"] == pytest.approx(0.02, rel=0.15)


def test_times_that_scatter():
    found = findings(jitter=0.1)
    assert set(found) == {"jitter"}
    assert found["jitter"]["magnitude"] == pytest.approx(0.1 / RATE_HZ, rel=0.1)


def test_a_zero_that_wanders_and_one_that_restarts_elsewhere():
    wander = ZeroWander(density_n2_s=0.06, density_std_n2_s=0.01, white_n=0.05, memory_s=10.0, restart_n=1.5)
    found = findings(wander=wander)
    assert set(found) == {"zero_wander", "zero_steps"}
    assert found["zero_wander"]["magnitude"] == pytest.approx(np.sqrt(0.06 * SECONDS), rel=0.01)
    assert found["zero_steps"]["magnitude"] == 1.5


@pytest.mark.parametrize(("level_n", "is_named"), [(85.0, True), (-6.0, True), (1.2, False), (4.0, False)])
def test_a_load_cell_that_was_not_tared_is_named(level_n, is_named):
    """Forces that were 85 N too large in all trials were "no gap" without a word; a few restarts scatter by some N."""
    wander = ZeroWander(
        density_n2_s=1e-6, density_std_n2_s=1.0, white_n=0.05, memory_s=10.0, restart_n=1.5 if level_n == 4.0 else 0.3,
        level_n=level_n,
    )  # fmt: skip
    found = findings(wander=wander)
    assert ("zero_level" in found) == is_named
    if is_named:
        assert found["zero_level"]["magnitude"] == level_n
        assert f"{level_n:.2g} N in air" in found["zero_level"]["words"]


@pytest.mark.parametrize(
    ("change", "std", "is_named"), [(0.006, 0.001, True), (0.006, 0.004, False), (5e-4, 1e-5, False)]
)
def test_a_gain_that_drifts_is_named_where_it_is_certain_and_matters(change, std, is_named):
    clean = SimpleNamespace(plant=SimpleNamespace(known=()), off_stroke=(), health=())
    listed = signal_findings(clean, None, {"motor_current_gain": GainDrift(change=-change, std=std)})
    found = [(s["channel"], s["finding"], s["magnitude"], s["unit"]) for s in listed]
    assert found == ([("motor_current_a", "gain_drift", 0.006, "1")] if is_named else [])
    assert all("-0.6 %" in s["words"] for s in listed)


def test_the_drift_of_a_gain_is_estimated_beside_what_else_may_be_off():
    """One amplifier comes from +1.2 % to its final gain with a time constant of 600 s; another one is steady."""
    rng = np.random.default_rng(5)
    time_s = np.linspace(0.0, 1800.0, 400)
    names = ("force_gain", "force_gain, warm-up over 600 s", "motor_current_gain, warm-up over 600 s")
    std = np.array([0.01, 0.005, 0.005])
    load, current = 100.0 + 20.0 * rng.standard_normal(400), 50.0 + 10.0 * rng.standard_normal(400)
    left = (np.exp(-time_s / 600.0) - np.exp(-3.0)) / (1.0 - np.exp(-3.0))
    waves = 20.0 * np.stack([load, load * left, current * left], axis=1)
    problem = SimpleNamespace(
        names=names, prior_std=std, settings=SETTINGS, nuisance=waves * std,
        data=waves @ [0.02, 0.012, 0.0] + rng.standard_normal(400),
        campaign=SimpleNamespace(
            states=[SimpleNamespace(setting=SimpleNamespace(session_s=0.0), time_s=time_s[:, None])],
            plant=SimpleNamespace(model=SimpleNamespace(session_s=1800.0)),
        ),
    )  # fmt: skip
    found = gain_drifts(problem, Marginal(problem))
    assert set(found) == {"force_gain", "motor_current_gain"}
    true = -0.012
    assert abs(found["force_gain"].change - true) < 3.0 * found["force_gain"].std < 0.1 * abs(true)
    assert abs(found["motor_current_gain"].change) < 3.0 * found["motor_current_gain"].std < 0.003
