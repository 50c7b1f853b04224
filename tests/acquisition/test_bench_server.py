"""The simulated bench gives no instrument the time that another one takes."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from sawbench.acquisition.simulation.bench_server import SimulatedBench

pytestmark = pytest.mark.unit

NAMES = ("force", "displacement", "power")


class Noted:
    """An instrument and its port that note what happens in which order."""

    is_streaming = True
    address = "nowhere"

    def __init__(self, name, events):
        self.name, self.events = name, events

    def advance(self, now_s):
        self.events.append(("made", self.name))
        return b"bytes"

    def write(self, data):
        self.events.append(("sent", self.name))

    def read(self):
        return b""

    def plug(self):
        pass


def test_all_bytes_are_made_before_any_is_sent_and_each_instrument_is_first_in_its_turn():
    events = []
    noted = {name: Noted(name, events) for name in NAMES}
    bench = SimulatedBench(SimpleNamespace(trigger=lambda now_s: now_s), noted, noted)
    bench.plug_in()
    first = []
    for step in range(3):
        events.clear()
        bench.step(0.005 * step)
        assert events[:3] == [("made", name) for name in NAMES]
        assert sorted(events[3:]) == sorted(("sent", name) for name in NAMES)
        first.append(events[3][1])
    assert sorted(first) == sorted(NAMES)
