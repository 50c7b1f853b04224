"""Signals with a known stroke: an instrument that stops sending, and samples that are missing one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.bench.config import BenchConfig
from sawbench.bench.recording import Gap, Recording, Signal, Trial
from sawbench.diagnosis.channel_defects import defect_of
from sawbench.processing.process import process_recording

RATE_HZ, STROKE_HZ, SECONDS, PEAK_N = 1000.0, 14.0, 3.0, 200.0
UNITS = {"displacement_mm": "mm", "force_n": "N", "motor_current_a": "A", "battery_voltage_v": "V"}


def recording(noise=1.0):
    rng = np.random.default_rng(2)
    time_s = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    phase = 2.0 * np.pi * STROKE_HZ * time_s
    values = {
        "displacement_mm": 10.0 * (1.0 - np.cos(phase)) + noise * 0.01 * rng.normal(size=len(time_s)),
        "force_n": PEAK_N * np.maximum(-np.sin(phase), 0.0) + noise * 0.5 * rng.normal(size=len(time_s)),
        "motor_current_a": 10.0 + 3.0 * np.cos(2.0 * phase) + noise * 0.03 * rng.normal(size=len(time_s)),
        # In steps of 50 mV.
        "battery_voltage_v": 0.05 * np.round((17.8 - 0.01 * time_s) / 0.05),
    }
    signals = {k: Signal(channel=k, unit=UNITS[k], time_s=time_s, values=v) for k, v in values.items()}
    return Recording(trial=Trial(trial_id="t", material="oak", duty=0.44), signals=signals)


def with_values(found, channel, change):
    signal = found.signals[channel]
    return replace(found, signals={**found.signals, channel: replace(signal, values=change(signal.values.copy()))})


def stop_after(n, until=None):
    def change(values):
        values[n:until] = values[n]
        return values

    return change


@pytest.mark.parametrize("channel", ["force_n", "motor_current_a"])
@pytest.mark.parametrize("until", [None, 1500])
def test_an_instrument_that_stops_while_the_crank_turns_is_doubted(channel, until):
    found = process_recording(with_values(recording(), channel, stop_after(1000, until)), BenchConfig())
    [doubt] = found.doubts(channel)
    assert doubt.startswith(f"{channel}: stands at ")
    assert f"from 1.00 s to {3.0 if until is None else 1.5:.2f} s" in doubt


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_what_may_stand_still_is_not_doubted(noise):
    # Without noise the force of every return stroke is one value, the voltage of the battery moves in coarse steps.
    found = process_recording(recording(noise), BenchConfig())
    assert not found.doubts(*UNITS)


def test_a_stop_shorter_than_three_strokes_is_not_doubted():
    found = process_recording(with_values(recording(), "motor_current_a", stop_after(1000, 1150)), BenchConfig())
    assert not found.doubts("motor_current_a")


def test_a_rest_before_the_start_is_not_doubted():
    running = recording()
    still = {"displacement_mm": 0.0, "force_n": 0.0, "motor_current_a": 0.0, "battery_voltage_v": 18.0}
    signals = {}
    for name, signal in running.signals.items():
        values = np.concatenate([np.full(1000, still[name]), signal.values])
        signals[name] = replace(signal, time_s=np.arange(len(values)) / RATE_HZ, values=values)
    assert not process_recording(replace(running, signals=signals), BenchConfig()).doubts("motor_current_a", "force_n")


@pytest.mark.parametrize("channel", ["force_n", "displacement_mm"])
def test_samples_that_are_missing_one_by_one_cost_no_stroke(channel):
    whole = recording()
    signal = whole.signals[channel]
    # Every seventeenth of 71 samples a stroke: each stroke lacks some.
    kept = np.arange(len(signal.values)) % 17 != 3
    time_s = signal.time_s[kept]
    before = np.flatnonzero(np.diff(time_s) > 1.5 / RATE_HZ)
    gaps = tuple(Gap(start_s=float(time_s[k]), end_s=float(time_s[k + 1]), n_missing=1) for k in before)
    fewer = replace(signal, time_s=time_s, values=signal.values[kept], gaps=gaps)
    found = process_recording(replace(whole, signals={**whole.signals, channel: fewer}), BenchConfig())
    assert found.peak_force_n == pytest.approx(PEAK_N, rel=0.005)
    assert found.period.confidence == "high"
    assert found.period.n_cycles >= 40
    assert any("samples are missing" in text for text in found.warnings)


def test_a_saw_that_coasts_without_current_is_not_doubted():
    running = recording()
    time_s = running.signals["force_n"].time_s
    # From 2.3 s on the rate falls from 14 Hz by 9 Hz in a second: eight strokes without current.
    coasting = np.maximum(time_s - 2.3, 0.0)
    phase = 2.0 * np.pi * (STROKE_HZ * time_s - 4.5 * coasting**2)
    rng = np.random.default_rng(3)
    driven = np.where(coasting > 0.0, 0.0, 10.0 + 0.03 * rng.normal(size=len(time_s)))
    values = {"displacement_mm": 10.0 * (1.0 - np.cos(phase)), "motor_current_a": driven}
    signals = {name: replace(running.signals[name], values=v) for name, v in values.items()}
    found = process_recording(Recording(trial=Trial(trial_id="t", material="none"), signals=signals), BenchConfig())
    assert not found.doubts("motor_current_a")
    assert defect_of(signals["motor_current_a"], [signals["displacement_mm"]]) is None


@pytest.mark.parametrize("channel", ["force_n", "motor_current_a"])
def test_diagnose_leaves_out_a_channel_that_stops_for_a_part_of_the_trial(channel):
    found = with_values(recording(), channel, stop_after(900, 2100)).signals
    others = [signal for name, signal in found.items() if name != channel]
    defect = defect_of(found[channel], others)
    assert defect is not None
    assert "from 0.900 s to 2.10 s while the crank turns" in defect[0]
    whole = recording().signals
    assert defect_of(whole[channel], others) is None
