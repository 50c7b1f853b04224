"""What `check` reads off values alone, where the truth is put in."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.devices.device import StreamChannel
from sawbench.acquisition.preflight import received_rate_hz
from sawbench.acquisition.preflight_values import channel_findings, std_about_line

pytestmark = pytest.mark.unit

TIME_S = np.arange(6000) / 2000.0


def channel(**changes):
    known = {"name": "force_n", "unit": "N", "calibration": Calibration(), "valid_range": (-875.0, 875.0)}
    return StreamChannel(**{**known, **changes})


def codes(values, *, is_running=False, **changes):
    found = channel_findings(channel(**changes), TIME_S, values, is_running=is_running)
    return [(f.severity, f.code) for f in found]


@pytest.fixture
def noise():
    return np.random.default_rng(2).standard_normal(len(TIME_S))


def test_a_sound_channel_has_no_finding(noise):
    assert codes(0.3 * noise) == []
    # Coarse steps, most of them equal, are sound too.
    assert codes(np.round(0.3 * noise)) == []


def test_noise_is_held_against_what_was_stated(noise):
    assert codes(2.0 * noise) == []
    assert codes(2.0 * noise, noise_std=0.3) == [("fault", "noisy")]
    assert codes(2.0 * noise, noise_std=0.5) == []
    assert codes(6.0 * noise) == [("fault", "noisy")]
    assert codes(6.0 * noise, is_running=True) == []


@pytest.mark.parametrize("line_hz", [50.0, 60.0])
def test_hum_is_told_by_its_frequency(noise, line_hz):
    values = 20.0 * np.sin(2 * np.pi * line_hz * TIME_S + 1.0) + noise
    (finding,) = channel_findings(channel(), TIME_S, values)
    assert f"{line_hz:g} Hz hum" in finding.what
    (finding,) = channel_findings(channel(), TIME_S, 20.0 * np.sin(2 * np.pi * 37.0 * TIME_S) + noise)
    assert "hum" not in finding.what


def test_every_way_to_the_end_of_the_range_is_saturated(noise):
    sine = 400.0 * np.sin(2 * np.pi * 15.0 * TIME_S) + noise
    assert codes(sine, is_running=True) == []
    assert codes(np.minimum(sine, 300.0), is_running=True) == [("fault", "saturated")]
    assert codes(np.maximum(sine, -300.0), is_running=True) == [("fault", "saturated")]
    assert codes(850.0 + noise) == [("fault", "saturated")]
    assert codes(0.3 * noise + 900.0 * (TIME_S == 1.0)) == [("fault", "saturated")]


def test_frozen_or_at_rest():
    still = np.full(len(TIME_S), 17.5)
    bus = {"name": "battery_voltage_v", "unit": "V", "valid_range": (0.0, 65.0), "resolution": 0.001}
    assert codes(still) == [("fault", "frozen")]
    assert codes(still, **bus) == [("note", "not_moving")]
    assert codes(still, is_running=True, **bus) == [("fault", "frozen")]


def test_a_zero_that_is_off_is_a_note(noise):
    assert codes(12.0 + 0.3 * noise) == [("note", "not_zero")]
    assert codes(12.0 + 0.3 * noise, name="displacement_mm", unit="mm") == []


def test_std_about_line_ignores_drift_and_spikes(noise):
    values = 0.5 * noise + 3.0 * TIME_S
    values[::500] += 40.0
    assert std_about_line(TIME_S, values) == pytest.approx(0.5, rel=0.1)


def test_a_gap_moves_the_overall_rate_only():
    arrival_s = np.concatenate([np.arange(0.0, 1.0, 0.01), np.arange(1.5, 3.0, 0.01)])
    overall, steady = received_rate_hz(arrival_s, 10.0 * np.arange(len(arrival_s)))
    assert steady == pytest.approx(1000.0, rel=0.01)
    assert overall < 900.0


@pytest.mark.parametrize("rate_hz", [3.0, 13.3, 31.0])
def test_a_running_tool_is_told_from_noise(noise, rate_hz):
    stroke = 10.0 * (1.0 - np.cos(2 * np.pi * rate_hz * TIME_S))
    cutting = 200.0 * np.maximum(0.0, np.sin(2 * np.pi * rate_hz * TIME_S))
    for values in (stroke + 0.02 * noise, cutting + noise):
        found = channel_findings(channel(noise_std=0.01), TIME_S, values)
        (finding,) = [f for f in found if f.severity == "fault"]
        assert finding.code == "tool_running"
        assert f"{rate_hz:.0f}." in finding.what or f"{rate_hz:.1f}" in finding.what
        assert "shield" not in finding.remedy
    for values in (6.0 * noise, 20.0 * np.sin(2 * np.pi * 50.0 * TIME_S) + noise):
        assert codes(values, noise_std=0.1) == [("fault", "noisy")]
