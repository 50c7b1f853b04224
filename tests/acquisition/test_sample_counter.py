"""A counter against the time of arrival."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.devices.dbc_can import DbcCan, DbcCanSettings
from sawbench.acquisition.sample_counter import SampleCounter
from sawbench.acquisition.stream_recorder import StreamRecorder
from sawbench.acquisition.transports.can_batch import CanBatch
from sawbench.bench.recording import Event, SampleBlock

pytestmark = pytest.mark.unit

RATE_HZ = 1000.0


def recorded(counts, *, per_read=7, at_s=None):
    """Blocks, events and summary of a stream whose value is the frame's true number; `counts` is what it sends."""
    settings = DbcCanSettings.model_validate({"port": "x", "signals": {"motor_current_a": "MotorStatus.MotorCurrent"}})
    device = DbcCan("power", settings)
    recorder = StreamRecorder("power", device.streams[0])
    recorder.begin(50.4, None)
    at_s = 50.0 + np.arange(len(counts)) / RATE_HZ if at_s is None else at_s
    items = []
    for k in range(0, len(counts), per_read):
        part = slice(k, k + per_read)
        values = np.arange(len(counts))[part] % 1000
        payload = np.zeros((len(values), 8), dtype=np.uint8)
        payload[:, 0], payload[:, 1] = counts[part] & 0xFF, counts[part] >> 8 & 0xFF
        payload[:, 2], payload[:, 3] = values & 0xFF, values >> 8
        batch = CanBatch(
            identifier=np.full(len(values), 0x100, dtype=np.uint32),
            length=np.full(len(values), 8, dtype=np.uint8),
            payload=payload,
            arrival_s=at_s[part],
        )
        for chunk in device.decode(batch):
            items += recorder.push(chunk)
    items += recorder.finish(float(at_s[-1]) - 50.4, "over")
    blocks = [i for i in items if isinstance(i, SampleBlock)]
    return blocks, [i for i in items if isinstance(i, Event)], recorder.status()[0]


@pytest.mark.parametrize("bit", range(16))
@pytest.mark.parametrize("frame", [2000, 2001, 2005, 2006, 2007])
def test_one_flipped_bit_in_a_counter_costs_nothing(bit, frame):
    counts = np.arange(4000) % 65536
    counts[frame] ^= 1 << bit
    blocks, events, status = recorded(counts)
    assert not [e for e in events if e.kind == "gap"]
    assert status.n_missing == 0
    assert status.n_samples == pytest.approx(3600, abs=1)
    time_s = np.concatenate([b.time_s for b in blocks])
    assert time_s[-1] == pytest.approx(3.599, abs=1e-3)


def test_a_bit_that_stays_set_moves_no_time():
    counts = np.arange(6000) % 65536
    counts[2003:] |= 1 << 14
    blocks, _, status = recorded(counts)
    assert status.n_missing <= 1
    assert np.concatenate([b.time_s for b in blocks])[-1] == pytest.approx(5.599, abs=2e-3)


def test_a_loss_is_still_counted_and_a_repeat_dropped():
    counts = np.delete(np.arange(4000), slice(1500, 1537))
    counts = np.insert(counts, 2200, counts[2199])
    at_s = 50.0 + counts / RATE_HZ
    _, events, status = recorded(counts, at_s=at_s)
    (gap,) = [e for e in events if e.kind == "gap"]
    assert gap.time_s == pytest.approx(1.0995, abs=2e-3)
    assert status.n_missing == 37
    assert status.n_samples == pytest.approx(3600 - 37, abs=1)


def test_a_counter_that_begins_anew_is_followed():
    counter = SampleCounter(n_bits=16, rate_hz=RATE_HZ)
    counted = counter.take(np.array([500, 501, 0, 1, 2]), np.arange(5) / RATE_HZ)
    assert counted.n_lost.tolist() == [0, 0, 0, 0, 0]
    assert counted.is_exact.tolist() == [True, True, False, True, True]


def test_a_jump_waits_for_the_next_frame():
    counter = SampleCounter(n_bits=16, rate_hz=RATE_HZ)
    assert counter.take(np.array([7, 8, 12]), np.array([0.0, 1e-3, 5e-3])).n_ready == 2
    counted = counter.take(np.array([12, 13]), np.array([5e-3, 6e-3]))
    assert counted.n_lost.tolist() == [3, 0]
