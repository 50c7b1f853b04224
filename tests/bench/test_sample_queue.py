"""What waits for a slower reader is bounded by its samples, and what does not fit is counted."""

from __future__ import annotations

import queue

import numpy as np
import pytest
from sawbench.bench.recording import Event, SampleBlock
from sawbench.bench.sample_queue import SampleQueue

pytestmark = pytest.mark.unit


def block(n):
    return SampleBlock(
        device="cell", channel="force_n", unit="N", first_index=0, time_s=np.arange(n) / 1e4, values=np.zeros(n)
    )


def taken(waiting):
    item = waiting.get()
    assert item is not None
    return item


@pytest.mark.parametrize(("n", "fits"), [(100, 50), (2400, 4), (100_000, 1)])
def test_what_waits_is_bounded_by_its_samples_however_they_are_cut(n, fits):
    waiting = SampleQueue(most_samples=10_000)
    assert [waiting.put(block(n)) for _ in range(60)] == [True] * fits + [False] * (60 - fits)
    assert waiting.n_dropped == 60 - fits


def test_what_was_taken_makes_room():
    waiting = SampleQueue(most_samples=1000)
    for _ in range(100):
        assert waiting.put(block(900))
        assert not waiting.put(block(1))
        assert len(taken(waiting).time_s) == 900
    assert waiting.n_dropped == 100


def test_events_that_wait_are_bounded_too():
    waiting = SampleQueue(most_samples=1000)
    for k in range(50):
        waiting.put(Event(kind="note", time_s=float(k), text="x"))
    assert waiting.n_dropped == 40
    waiting.end()
    assert [taken(waiting).time_s for _ in range(10)] == list(range(10))
    assert waiting.get() is None
    with pytest.raises(queue.Empty):
        waiting.get(0.0)
