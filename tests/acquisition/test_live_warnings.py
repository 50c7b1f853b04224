"""Warnings during a recording: every fault is said once, at its second; an intact trial is silent."""

from __future__ import annotations

import struct
from collections import namedtuple
from dataclasses import replace

import numpy as np
import pytest
import sawbench.acquisition.live_warnings as live
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.devices.device import Stream, StreamChannel
from sawbench.acquisition.devices.gsv8 import Gsv8, Gsv8Settings
from sawbench.acquisition.live_warnings import LiveWarnings
from sawbench.acquisition.recorder import record
from sawbench.bench.recording import Event, SampleBlock

from tests.acquisition.test_recorder import PATIENT, Clock, Scripted, Writer, run

pytestmark = pytest.mark.unit

RATES = {"force_n": 2000.0, "displacement_mm": 2000.0, "motor_current_a": 1000.0}
RANGES = {"force_n": (-500.0, 500.0), "displacement_mm": (0.0, 25.0), "motor_current_a": (-60.0, 60.0)}
NOISE = {"force_n": 0.5, "displacement_mm": 0.01, "motor_current_a": 0.05}
ON_S, FAULT_S, SECONDS = 0.7, 6.3, 10


def stream(channel):
    low_high, calibration = RANGES[channel], Calibration(source="test")
    own = StreamChannel(name=channel, unit=channel[-1], calibration=calibration, valid_range=low_high)
    return Stream(name=channel, rate_hz=RATES[channel], channels=(own,))


STREAMS = {(channel, channel): stream(channel) for channel in RATES}


def sensed(channel, t, rng):
    """A saw at 14 strokes a second, switched on at `ON_S`; cuts on half a stroke."""
    angle = 2.0 * np.pi * 14.0 * np.maximum(t - ON_S, 0.0)
    on = t >= ON_S
    clean = {
        "force_n": on * 250.0 * np.maximum(0.0, -np.sin(angle)),
        "displacement_mm": 1.0 + on * 10.0 * (1.0 - np.cos(angle)),
        "motor_current_a": on * (9.0 + 4.0 * np.maximum(0.0, -np.sin(angle - 0.5))),
    }[channel]
    return clean + NOISE[channel] * rng.standard_normal(len(t))


def warned(fault=None, *, drifts=None, **settings):
    """Events of ten seconds; `fault(channel, t, values)` gives what comes instead, or None for nothing."""
    watch, rng, events = LiveWarnings(STREAMS, **settings), np.random.default_rng(5), []
    for tenth in range(10 * SECONDS + 20):
        for channel, rate_hz in RATES.items():
            n = round(0.1 * rate_hz)
            t = (tenth * n + np.arange(n)) / rate_hz
            values = sensed(channel, t, rng)
            if fault is not None and t[0] >= FAULT_S:
                t, values = fault(channel, t, values)
            if tenth < 10 * SECONDS and len(t):
                watch.take(
                    SampleBlock(device=channel, channel=channel, unit="", first_index=0, time_s=t, values=values)
                )
        drift = drifts(0.1 * tenth) if drifts else None
        if tenth < 10 * SECONDS + 5:
            events += watch.check(0.1 * (tenth + 1), lambda drift=drift: dict.fromkeys(STREAMS, drift))
    return events, watch


def instead(channel, make):
    return lambda name, t, values: (t, make(t, values)) if name == channel else (t, values)


FAULTS = {
    "clipped": (instead("force_n", lambda t, v: np.minimum(v, 180.0)), "force_n", "clipped at 180"),
    "near the end": (
        instead("displacement_mm", lambda t, v: 24.5 + 0.01 * (v - 11.0)), "displacement_mm", "of full scale"
    ),
    "flat line": (instead("force_n", lambda t, v: np.full(len(t), 3.0)), "force_n", "flat line"),
    "noise": (
        instead("force_n", lambda t, v: v + np.random.default_rng(1).normal(0, 4.0, len(t))), "force_n", "noise"
    ),
    "stroke": (
        instead("displacement_mm", lambda t, v: 5.0 + 0.01 * np.random.default_rng(2).standard_normal(len(t))),
        "displacement_mm",
        "stroke lost",
    ),
    "silent": (lambda name, t, v: (t[:0], v[:0]) if name == "motor_current_a" else (t, v), "", "is silent"),
    "rate": (
        lambda name, t, v: (FAULT_S + (t - FAULT_S) * 1.05, v) if name == "displacement_mm" else (t, v), "", "samples/s"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_said_once_within_two_seconds(name):
    fault, channel, words = FAULTS[name]
    events, watch = warned(fault)
    found = [event for event in events if words in event.text]
    assert len(found) == 1, [e.text for e in events]
    assert found[0].kind == "warning" and found[0].channel == channel
    # The second in which it begins may be half good; noise needs two.
    assert int(FAULT_S) <= found[0].time_s <= int(FAULT_S) + 2
    assert any(words in text for text in watch.active)


def test_an_intact_trial_is_silent_from_rest_to_cut():
    events, watch = warned(preload_n=400.0)
    assert events == [] and watch.active == ()


def test_preload_nearly_gone_is_said():
    (event,) = warned(preload_n=270.0)[0]
    assert event.channel == "force_n" and "of 270 N preload" in event.text
    assert event.time_s <= 1.0


def test_a_clock_that_drifts_is_said_and_taken_back():
    events, watch = warned(drifts=lambda t: (900.0, 20.0) if 3.0 < t < 6.0 else (40.0, 20.0))
    assert {e.text.partition("the clock")[0] for e in events} == {"", "over: "}
    assert len(events) == 2 * len(STREAMS) and watch.active == ()


def test_a_full_disk_is_said(monkeypatch, tmp_path):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(live.shutil, "disk_usage", lambda _: usage(1e12, 1e12, 1e8))
    (event,) = warned(folder=tmp_path)[0]
    assert "100 MB" in event.text and str(tmp_path) in event.text


def beside_the_saw(channel, rate_hz, values, seconds=SECONDS, resolution=0.0, **settings):
    """Events, and lights of every tenth, of an intact saw with one more channel: `values` gives those at its times."""
    unit, calibration = channel.rpartition("_")[2], Calibration(source="test")
    own = StreamChannel(
        name=channel, unit=unit, calibration=calibration, valid_range=(-500.0, 500.0), resolution=resolution
    )
    streams = {k: v for k, v in STREAMS.items() if k[0] != channel}
    streams["beside", "beside"] = Stream(name="beside", rate_hz=rate_hz, channels=(own,))
    watch, rng, events, spoilt = LiveWarnings(streams, **settings), np.random.default_rng(5), [], []
    for tenth in range(10 * seconds):
        end_s = 0.1 * (tenth + 1)
        for _, stream in streams.items():
            n_before, n = (int(np.ceil(stream.rate_hz * s - 1e-9)) for s in (0.1 * tenth, end_s))
            t = np.arange(n_before, n) / stream.rate_hz
            (one,) = stream.channels
            made = values(t) if one is own else sensed(one.name, t, rng)
            watch.take(SampleBlock(device="x", channel=one.name, unit="", first_index=n_before, time_s=t, values=made))
        events += watch.check(end_s, lambda: dict.fromkeys(streams))
        spoilt.append(watch.is_spoilt)
    return [event.text for event in events], spoilt


def test_a_battery_voltage_may_stay_within_its_resolution_while_the_tool_runs():
    def volts(t):
        return np.full(len(t), 17.8)

    assert beside_the_saw("battery_voltage_v", 100.0, volts, resolution=0.1)[0] == []
    (said,) = beside_the_saw("battery_voltage_v", 100.0, volts)[0]
    assert said.startswith("flat line")
    # A node that freezes: before, its voltage moved by many steps.
    (said,) = beside_the_saw(
        "battery_voltage_v", 100.0, lambda t: np.where(t < 6.0, 17.8 + 0.05 * np.sin(9.0 * t), 17.8), resolution=0.001
    )[0]
    assert said.startswith("flat line")
    # Every stroke moves the force: of that a resolution excuses nothing.
    assert "flat line" in beside_the_saw("force_n", 100.0, volts, resolution=0.1)[0][0]


@pytest.mark.parametrize("rate_hz", [10.0, 2.0, 0.5])
def test_a_slow_instrument_is_judged_by_every_sample(rate_hz):
    said, spoilt = beside_the_saw("force_n", rate_hz, lambda t: np.where(t < 3.0, 20.0, 200.0), preload_n=100.0)
    assert said == ["200 N of 100 N preload: above it the carriage lifts off its support"]
    assert not any(spoilt[:30]) and all(spoilt[60:])
    said, _ = beside_the_saw("force_n", rate_hz, lambda t: np.where(t < 3.0, 20.0, 490.0))
    assert len(said) == 1 and "of full scale" in said[0]


@pytest.mark.parametrize("rate_hz", [2.0, 0.5, 0.2])
def test_a_slow_instrument_is_silent_after_three_of_its_periods(rate_hz):
    seconds = round(6.0 / rate_hz) + 6

    def degrees(t):
        return 21.0 + 0.1 * np.sin(t)

    said, spoilt = beside_the_saw("board_temp_degc", rate_hz, degrees, seconds)
    assert said == [] and not any(spoilt)
    watch = LiveWarnings(STREAMS | {("slow", "slow"): replace(STREAMS["force_n", "force_n"], rate_hz=rate_hz)})
    last_s = 3.0 / rate_hz
    for channel, reached_s in (("motor_current_a", last_s + 3.0 / rate_hz + 3.0), ("force_n", last_s)):
        t = np.arange(0.0, reached_s, 0.001)
        watch.take(SampleBlock(device="x", channel=channel, unit="", first_index=0, time_s=t, values=np.sin(1e3 * t)))
    found = [e for e in watch.check(last_s + 3.0 / rate_hz + 3.0, dict) if e.device == "slow"]
    assert [e.text for e in found if e.text.endswith("is silent")]
    assert found[-1].time_s >= last_s


def test_frames_that_the_gsv8_marks_as_overloaded_are_said_and_spoil_the_trial():
    """Bit 0 of the second byte of a frame; the values of all its inputs stay."""
    clock, sent, lights = Clock(), [0], []
    channels = {
        "force_n": {"input": 1, "calibration": {"scale": 1.0, "source": "test"}},
        "displacement_mm": {"input": 2, "calibration": {"scale": 1.0, "source": "test"}},
    }
    settings = Gsv8Settings.model_validate({"driver": "gsv8", "port": "x", "rate_hz": 1000.0, "channels": channels})
    amplifier, writer = Gsv8("cell", settings, clock=clock), Writer()
    begun_s = clock.now_s

    def frame(n):
        is_overloaded = 4.0 < n / 1000.0 < 6.0 and n % 3 == 0
        return bytes([0xAA, 0x11, 0xB0 | is_overloaded]) + struct.pack(">2f", 100.0 + n % 7, 5.0 + n % 5) + b"\x85"

    def read():
        first, sent[0] = sent[0], round((clock.now_s - begun_s) * 1000.0)
        return amplifier.decode(b"".join(frame(n) for n in range(first, sent[0])), clock.now_s)

    def pass_time():
        clock.now_s += 0.02

    amplifier.open = amplifier.start = amplifier.stop = lambda: None
    amplifier.read = read
    summary = record(
        [amplifier], writer, seconds=10.0, clock=clock, between_rounds=pass_time,
        status=lambda now: lights.append((now.elapsed_s, now.is_spoilt)), limits=replace(PATIENT, status_every_s=0.0),
    )  # fmt: skip
    said, over = (event for event in writer.events("warning") if "overload of the amplifier" in event.text)
    assert said.device == "cell" and over.text.startswith("over: ")
    assert {is_spoilt for elapsed_s, is_spoilt in lights if elapsed_s < 3.0 or elapsed_s > 9.0} == {False}
    assert any(is_spoilt for _, is_spoilt in lights)
    assert [c.n_samples for c in summary.channels] == [10_000] * 2


def test_values_beyond_the_range_are_said():
    watch = LiveWarnings(STREAMS)
    text = f"about 30 samples missing: {live.OUTSIDE}, -500..500 N"
    watch.take(Event(kind="gap", time_s=0.2, end_s=0.3, text=text, device="force_n", channel="force_n"))
    (event,) = watch.check(1.6, dict)
    assert event.channel == "force_n" and "overloaded" in event.text


def test_the_recorder_keeps_warnings_as_events_and_shows_them():
    seen = []
    limits = replace(PATIENT, preload_n=100.0)
    _, writer = run(Scripted(), seconds=4.0, limits=limits, status=lambda s: seen.append(s.warnings))
    (event,) = writer.events("warning")
    assert event.channel == "force_n" and "100 N preload" in event.text
    assert any("100 N preload" in text for text in seen[-1])
