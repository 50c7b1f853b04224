"""A counter against the time of arrival."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.devices.dbc_can import DbcCan, DbcCanSettings
from sawbench.acquisition.sample_counter import CountedStream, SampleCounter
from sawbench.acquisition.stream_recorder import StreamRecorder
from sawbench.acquisition.transports.can_batch import CanBatch
from sawbench.bench.recording import Event, SampleBlock

pytestmark = pytest.mark.unit

RATE_HZ = 1000.0


def recorded(counts, *, per_read=7, at_s=None, sent=None, dbc="jigsaw_bench.dbc"):
    """Blocks, events and summary of a stream; `counts` is what it sends, `sent` its values, by default different."""
    given = {"port": "x", "dbc": str(dbc), "signals": {"motor_current_a": "MotorStatus.MotorCurrent"}}
    settings = DbcCanSettings.model_validate(given)
    device = DbcCan("power", settings)
    recorder = StreamRecorder("power", device.streams[0])
    recorder.begin(50.4, None)
    at_s = 50.0 + np.arange(len(counts)) / RATE_HZ if at_s is None else at_s
    sent = np.arange(len(counts)) % 1000 if sent is None else sent
    items = []
    for k in range(0, len(counts), per_read):
        part = slice(k, k + per_read)
        values = sent[part]
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
    _, events, status = recorded(counts, at_s=at_s, sent=counts % 1000)
    (gap,) = [e for e in events if e.kind == "gap"]
    assert gap.time_s == pytest.approx(1.0995, abs=2e-3)
    assert status.n_missing == 37
    assert status.n_samples == pytest.approx(3600 - 37, abs=1)


def test_an_equal_count_is_a_repeat_only_where_the_values_are_equal_too():
    stream = CountedStream("frames", modulus=256, rate_hz=RATE_HZ)
    counts, values = np.array([4.0, 5, 5, 6, 6, 7, 8]), np.array([1.0, 2, 2, 3, 4, np.nan, 5])
    chunks = stream.chunks(values[:, None], counts, np.arange(7) / RATE_HZ)
    assert np.concatenate([chunk.raw[:, 0] for chunk in chunks]).tolist() == pytest.approx(
        [1, 2, 3, 4, np.nan, 5], nan_ok=True
    )
    assert [(chunk.n_lost, chunk.is_loss_exact) for chunk in chunks] == [(0, True)]


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("never counts", np.zeros(6000, dtype=int)),
        ("stops at its largest value", np.minimum(np.arange(6000) + 65535 - 3000, 65535)),
    ],
)
@pytest.mark.parametrize("per_read", [1, 7, 50])
def test_a_counter_that_stands_still_is_none(name, counts, per_read):
    # Every third value is that of the sample before, as where a coarse current hardly changes.
    sent = np.arange(6000) // 3 * 2 % 1000
    blocks, events, status = recorded(counts, per_read=per_read, sent=sent + np.arange(6000) % 3 // 2)
    # The first equal value may be a repeat, the last sample waits for the next one, and either end may fall outside.
    assert 5597 <= status.n_samples <= 5600 and status.n_missing == 0
    (warning,) = [e for e in events if e.kind == "warning"]
    assert "the sample counter stands still" in warning.text
    assert np.concatenate([b.time_s for b in blocks])[-1] == pytest.approx(5.599, abs=3.1e-3)


def test_a_bench_at_rest_whose_counter_never_counts_has_samples():
    _, _, status = recorded(np.zeros(3000, dtype=int), sent=np.zeros(3000, dtype=int))
    assert (status.n_samples, status.n_missing) == (pytest.approx(2600, abs=1), 0)


def test_losses_of_a_counter_with_a_range_of_its_own_are_counted(tmp_path):
    """AUTOSAR E2E profile 1: four bits that count from 0 to 14."""
    dbc = tmp_path / "e2e.dbc"
    dbc.write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 256 MotorStatus: 8 A\n'
        ' SG_ SampleCounter : 0|4@1+ (1,0) [0|14] "" A\n SG_ MotorCurrent : 16|16@1- (0.01,0) [-300|300] "A" A\n'
        'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 1000;\nBA_DEF_DEF_ "GenMsgCycleTime" 1;\n'
    )
    numbers = np.delete(np.arange(4000), [1500, 1501, 1502, 2203])
    _, events, status = recorded(numbers % 15, at_s=50.0 + numbers / RATE_HZ, sent=numbers % 1000, dbc=dbc)
    assert [round(e.time_s, 2) for e in events if e.kind == "gap"] == [1.1, 1.8]
    assert (status.n_samples, status.n_missing) == (pytest.approx(3596, abs=1), 4)


def test_a_counter_that_begins_anew_is_followed():
    counter = SampleCounter(modulus=65536, rate_hz=RATE_HZ)
    counted = counter.take(np.array([500, 501, 0, 1, 2]), np.arange(5) / RATE_HZ)
    assert counted.n_lost.tolist() == [0, 0, 0, 0, 0]
    assert counted.is_exact.tolist() == [True, True, False, True, True]


def test_a_jump_waits_for_the_next_frame():
    counter = SampleCounter(modulus=65536, rate_hz=RATE_HZ)
    assert counter.take(np.array([7, 8, 12]), np.array([0.0, 1e-3, 5e-3])).n_ready == 2
    counted = counter.take(np.array([12, 13]), np.array([5e-3, 6e-3]))
    assert counted.n_lost.tolist() == [3, 0]
