"""Whose fault late samples are: the watch of this computer, with a clock and waits that the test makes."""

from __future__ import annotations

import pytest
from sawbench.acquisition.busy_watch import BusyWatch
from sawbench.acquisition.devices.device import Stream
from sawbench.acquisition.live_warnings import LiveWarnings
from sawbench.acquisition.recorder import RecorderLimits, _Run
from sawbench.bench.recording import Event

from tests.acquisition.test_recorder import Clock, Scripted

pytestmark = pytest.mark.unit


class Busy:
    """Waits last as long as they are asked to, and `extra_s` on top; `load` programs want each processor."""

    def __init__(self):
        self.now_s, self.extra_s, self.load = 50.0, 0.0, 0.5

    def clock(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds + self.extra_s


def test_a_wait_that_is_too_long_is_said_for_four_seconds():
    machine = Busy()
    watch = BusyWatch(clock=machine.clock, sleep=machine.sleep, load=lambda: machine.load)
    watch.look()
    assert watch.words() == ""
    machine.extra_s = 0.7
    watch.look()
    machine.extra_s = 0.01
    for _ in range(30):
        watch.look()
    assert watch.late_s == pytest.approx(0.7)
    assert "this computer is too busy: the recorder waited 0.7 s" in watch.words()
    for _ in range(10):
        watch.look()
    assert watch.words() == ""


def test_many_programs_are_said_although_the_recorder_itself_is_served():
    machine = Busy()
    watch = BusyWatch(clock=machine.clock, sleep=machine.sleep, load=lambda: machine.load)
    machine.load = 14.6
    assert watch.words() == ""
    watch.look()
    assert watch.words() == "this computer is too busy: 15 programs want each processor; end other programs"
    machine.load = 1.5
    watch.look()
    assert watch.words() == ""


def test_what_is_late_while_the_computer_is_busy_is_blamed_on_it():
    machine = Busy()
    run = _Run([Scripted()], (), Clock(), RecorderLimits(), lambda: None)
    run._busy = BusyWatch(clock=machine.clock, sleep=machine.sleep, load=lambda: machine.load)
    gap = Event(kind="gap", time_s=1.0, text="about 5 samples missing")
    assert run._blamed(gap) == gap
    machine.extra_s = 1.2
    run._busy.look()
    why = "this computer is too busy: the recorder waited 1.2 s for its turn; end other programs"
    assert run._blamed(gap).text == f"about 5 samples missing ({why})"


def test_a_busy_computer_is_a_live_warning_and_a_silent_instrument_may_be_none():
    said = ["this computer is too busy: ..."]
    streams = {
        ("a", "frames"): Scripted("a").streams[0],
        ("b", "frames"): Stream(name="frames", rate_hz=1e3, channels=()),
    }
    watch = LiveWarnings(streams, busy=lambda: said[-1])
    watch._reached_s["a", "frames"] = 5.0
    texts = [event.text for event in watch.check(1.6, dict)]
    assert "this computer is too busy: ..." in texts
    assert "frames is silent, or its samples wait: this computer is too busy" in texts
    said.append("")
    assert "over: this computer is too busy: ..." in [event.text for event in watch.check(2.6, dict)]
