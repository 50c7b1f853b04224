"""The thread that reads an instrument: samples gather, and lose neither order, count nor arrival."""

from __future__ import annotations

import queue
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.acquisition.device_reader import DeviceReader, LinkLost, Samples, _gather_s, _Lag
from sawbench.acquisition.devices.device import Chunk, Stream, joined
from sawbench.bench.errors import DeviceError

from tests.acquisition.test_recorder import Scripted
from tests.rigs.arrivals import CHANNEL

pytestmark = pytest.mark.unit


def chunk(first, last, arrival_s, **options):
    raw = np.arange(first, last, dtype=float)[:, None]
    return Chunk(stream="frames", raw=raw, arrival_s=np.atleast_1d(np.asarray(arrival_s, dtype=float)), **options)


def test_samples_that_follow_each_other_are_one_chunk_with_the_later_arrival():
    (both,) = joined([chunk(0, 3, 1.0, n_lost=2)], [chunk(3, 5, 1.1)])
    assert both.raw[:, 0].tolist() == [0, 1, 2, 3, 4]
    assert both.arrival_s.tolist() == [1.1]
    assert both.n_lost == 2


def test_every_sample_keeps_its_own_stamp():
    (both,) = joined([chunk(0, 2, [1.0, 1.1])], [chunk(2, 4, [1.2, 1.3])])
    assert both.arrival_s.tolist() == [1.0, 1.1, 1.2, 1.3]


@pytest.mark.parametrize("options", [{"n_lost": 1}, {"is_loss_exact": False}, {"time_s": np.array([1.1])}])
def test_a_break_between_two_reads_stays(options):
    assert [len(c.raw) for c in joined([chunk(0, 2, 1.0)], [chunk(2, 3, 1.1, **options)])] == [2, 1]


def test_streams_are_joined_each_with_its_own():
    other = replace(chunk(7, 8, 1.0), stream="other")
    found = joined([chunk(0, 1, 1.0), other], [replace(chunk(8, 9, 1.1), stream="other"), chunk(1, 2, 1.1)])
    assert [(c.stream, c.raw[:, 0].tolist()) for c in found] == [("frames", [0, 1]), ("other", [7, 8])]


@pytest.mark.parametrize(
    ("rate_hz", "n_channels", "gather_s"), [(6e3, 1, 0.04), (2e4, 1, 0.02), (1e4, 4, 0.025), (80, 1, 0)]
)
def test_fewer_samples_gather_where_each_holds_more(rate_hz, n_channels, gather_s):
    streams = (Stream(name="frames", rate_hz=rate_hz, channels=(CHANNEL,) * n_channels),)
    assert _gather_s(SimpleNamespace(streams=streams), 0.04) == pytest.approx(gather_s)


class Ending(Scripted):
    """Delivers so many reads, then breaks; to open it again ends the thread that reads it."""

    n_left = 1000
    reader: DeviceReader

    def open(self):
        if self.n_opened:
            self.reader.stop()
        super().open()

    def read(self):
        if not self.n_left:
            raise DeviceError("unplugged")
        self.n_left -= 1
        return super().read()


class EndingReceiver(Ending):
    """Decodes together what it received several times."""

    def __init__(self):
        super().__init__()
        self.received = []
        self.n_decoded = 0

    def receive(self):
        self.received = joined(self.received, super().read())

    def decoded(self):
        chunks, self.received = self.received, []
        self.n_decoded += 1
        return chunks


@pytest.mark.parametrize(("kind", "gather_s"), [(Ending, 0.0), (Ending, 1e-6), (EndingReceiver, 1e-6)])
def test_nothing_is_lost_where_samples_gather(kind, gather_s):
    device, messages = kind(), queue.Queue()
    device.open()
    device.reader = DeviceReader(device, messages, clock=device.clock, silence_s=1e6, gather_s=gather_s)
    device.reader.run()
    found = [messages.get() for _ in range(messages.qsize())]
    chunks = [c for m in found if isinstance(m, Samples) for c in m.chunks]
    assert np.concatenate([c.raw[:, 0] for c in chunks]).tolist() == list(range(10_000))
    # Every read is 10 ms: 3 s are read as they come, then three reads and the one behind them are one chunk.
    assert len(chunks) == (1000 if not gather_s else pytest.approx(300 + 700 / 4, abs=2))
    assert [m.reason for m in found if isinstance(m, LinkLost)] == ["unplugged"]
    # What was received before the link broke came through as well, decoded once for four reads.
    assert kind is Ending or (not device.received and device.n_decoded == pytest.approx(700 / 4, abs=2))


def test_samples_that_fall_behind_are_read_without_a_pause_until_they_have_caught_up():
    lag = _Lag(Scripted())
    behind = []
    # 1 kHz, a read every 10 ms; from 3 s on the reads bring a part of what was sent, from 4 s on all of the rest.
    for k in range(1, 600):
        n = 5 if 300 <= k < 400 else 10 + 500 * (k == 400)
        lag.take([chunk(0, n, 0.0)], 1000.0 + 0.01 * k)
        behind.append(lag.is_behind)
    assert not any(behind[:305])
    assert all(behind[320:398])
    assert not any(behind[400:])


def test_what_was_lost_is_not_waited_for_forever():
    lag = _Lag(Scripted())
    behind = []
    for k in range(1, 2000):
        lag.take([chunk(0, 0 if 300 <= k < 350 else 10, 0.0)], 1000.0 + 0.01 * k)
        behind.append(lag.is_behind)
    assert behind[400] and not any(behind[1400:])
