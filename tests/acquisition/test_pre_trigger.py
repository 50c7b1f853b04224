"""Recording that begins when the blade touches, on emulated instruments in simulated time."""

from __future__ import annotations

import os

import numpy as np
import pytest
from sawbench.acquisition.devices import build_devices
from sawbench.acquisition.pre_trigger import Touch
from sawbench.acquisition.recorder import RecorderLimits, record
from sawbench.bench.config import load_config
from sawbench.bench.errors import InputError
from sawbench.bench.recording import SampleBlock

from tests.rigs.resting import CONFIG, resting_bench

pytestmark = [pytest.mark.unit, pytest.mark.skipif(os.name != "posix", reason="this system has no pty")]

# The force steps, and the displacement says what the bench's time is.
TOUCHED_S, SPEED_MM_S = 4.0, 0.5
BENCH = {
    "force_n": lambda time_s, noise: np.where(time_s >= TOUCHED_S, 150.0, 0.0) + 0.3 * noise,
    "displacement_mm": lambda time_s, _: 4.0 + SPEED_MM_S * time_s,
}


def recorded(touch, seconds):
    items = []

    class Writer:
        write_block = write_event = staticmethod(items.append)

        def close(self, **_):
            pass

    with resting_bench(BENCH) as rig:
        devices = build_devices(load_config(CONFIG).config, rig.ports, clock=rig.clock)
        limits = RecorderLimits(queue_length=1, touch=touch)
        summary = record(devices, Writer(), seconds=seconds, clock=rig.clock, limits=limits)
    channels = {}
    for name in ("force_n", "displacement_mm", "motor_current_a"):
        own = [item for item in items if isinstance(item, SampleBlock) and item.channel == name]
        channels[name] = tuple(np.concatenate([getattr(b, key) for b in own]) for key in ("time_s", "values"))
    return channels, [item for item in items if not isinstance(item, SampleBlock)], summary


@pytest.mark.parametrize("before_s", [0.0, 1.5])
def test_it_begins_before_the_touch_and_nothing_is_missing(before_s):
    channels, events, summary = recorded(Touch(above=50.0, before_s=before_s), 2.5)
    assert summary.is_complete and not summary.losses
    (trigger,) = [event for event in events if event.kind == "trigger"]
    assert trigger.time_s == pytest.approx(before_s, abs=1e-6)
    time_s, force_n = channels["force_n"]
    # Half of a sample, and the scatter of the alignment of two links.
    assert time_s[np.argmax(force_n > 50.0)] == pytest.approx(before_s, abs=1e-3)
    time_s, displacement_mm = channels["displacement_mm"]
    assert np.interp(before_s, time_s, displacement_mm) == pytest.approx(4.0 + SPEED_MM_S * TOUCHED_S, abs=2e-3)
    for name, rate_hz in (("force_n", 6000.0), ("displacement_mm", 6000.0), ("motor_current_a", 1000.0)):
        time_s, _ = channels[name]
        assert time_s[0] == pytest.approx(0.0, abs=1.0 / rate_hz)
        assert len(time_s) == pytest.approx(2.5 * rate_hz, abs=2)


def test_a_touch_that_comes_too_soon_keeps_what_there_is():
    channels, events, _ = recorded(Touch(above=50.0, before_s=30.0), 8.0)
    (trigger,) = [event for event in events if event.kind == "trigger"]
    # The clocks settle within the first seconds.
    assert 1.0 < trigger.time_s < TOUCHED_S
    time_s, force_n = channels["force_n"]
    assert time_s[np.argmax(force_n > 50.0)] == pytest.approx(trigger.time_s, abs=1e-3)


def test_without_the_channel_it_is_refused():
    with pytest.raises(InputError, match="no instrument provides torque_n_m"):
        recorded(Touch(above=50.0, channel="torque_n_m"), 1.0)


@pytest.mark.parametrize("values", [{"above": 0.0}, {"above": float("nan")}, {"above": 5.0, "before_s": -1.0}])
def test_numbers_out_of_range_are_refused(values):
    with pytest.raises(InputError, match="allowed is"):
        Touch(**values)
