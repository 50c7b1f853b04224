"""Losses and their numbers, from synthetic arrivals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.devices.device import Chunk, Stream, StreamChannel
from sawbench.acquisition.stream_recorder import StreamRecorder
from sawbench.acquisition.stream_timing import Loss, StreamTimer, TimedBlock

pytestmark = pytest.mark.unit

RATE_HZ = 1000.0
CHANNEL = StreamChannel(name="force_n", unit="N", calibration=Calibration(), valid_range=(-1e9, 1e9))
STREAM = Stream(name="frames", rate_hz=RATE_HZ, channels=(CHANNEL,))


def chunk(first, n, *, late_s=0.0, n_lost=0, exact=True, start_s=100.0):
    """Samples `first`..`first + n - 1` of the instrument; the value is the sample's true number."""
    arrival = np.array([start_s + (first + n - 1) / RATE_HZ + late_s])
    raw = np.arange(first, first + n, dtype=float)[:, None]
    return Chunk(stream="frames", raw=raw, arrival_s=arrival, n_lost=n_lost, is_loss_exact=exact)


def run(chunks):
    timer = StreamTimer(STREAM)
    out = [item for c in chunks for item in timer.push(c)] + timer.flush()
    return timer, out


def blocks_of(out):
    return [item for item in out if isinstance(item, TimedBlock)]


def joined(out):
    blocks = blocks_of(out)
    time_s = np.concatenate([b.time_s for b in blocks])
    index = np.concatenate([b.first_index + np.arange(len(b.time_s)) for b in blocks])
    truth = np.concatenate([b.raw[:, 0] for b in blocks])
    return time_s, index, truth


def test_nothing_lost_nothing_changed():
    _, out = run(chunk(k, 10, late_s=0.002 * (k % 3)) for k in range(0, 3000, 10))
    time_s, index, truth = joined(out)
    assert not [x for x in out if isinstance(x, Loss)]
    assert np.array_equal(index, truth)
    assert time_s == pytest.approx(100.0 + truth / RATE_HZ, abs=1e-4)


def test_a_counted_loss_is_exact():
    _, out = run(
        [chunk(k, 10) for k in range(0, 1000, 10)]
        + [chunk(1007, 10, n_lost=7)]
        + [chunk(k, 10) for k in range(1017, 2017, 10)]
    )
    (loss,) = [x for x in out if isinstance(x, Loss)]
    time_s, index, truth = joined(out)
    assert loss.n_missing == 7
    assert (loss.start_s, loss.end_s) == pytest.approx((100.999, 101.007), abs=1e-4)
    assert np.array_equal(index, truth)
    assert time_s == pytest.approx(100.0 + truth / RATE_HZ, abs=1e-4)


def test_a_loss_nobody_counted_is_found_by_its_lateness():
    """The same block lost without any sign in the bytes: 120 samples."""
    _, out = run([chunk(k, 10) for k in range(0, 1000, 10)] + [chunk(k, 10) for k in range(1120, 4120, 10)])
    (loss,) = [x for x in out if isinstance(x, Loss)]
    time_s, index, truth = joined(out)
    assert loss.n_missing == pytest.approx(120, abs=1)
    assert np.abs(index - truth).max() <= 1
    assert time_s == pytest.approx(100.0 + truth / RATE_HZ, abs=1.5e-3)


def test_broken_bytes_say_where_and_the_clock_says_how_many():
    _, out = run(
        [chunk(k, 10) for k in range(0, 1000, 10)]
        + [chunk(1005, 10, n_lost=1, exact=False)]
        + [chunk(k, 10) for k in range(1015, 3015, 10)]
    )
    (loss,) = [x for x in out if isinstance(x, Loss)]
    assert loss.n_missing == pytest.approx(5, abs=1)
    assert loss.start_s == pytest.approx(100.999, abs=1e-3)


def test_a_stalled_host_loses_nothing():
    calm = [chunk(k, 10) for k in range(0, 1000, 10)]
    # Half a second late, then everything at once, then in time again.
    stalled = [chunk(k, 10, late_s=(1500 - k) / RATE_HZ) for k in range(1000, 1500, 10)]
    after = [chunk(k, 10) for k in range(1500, 2500, 10)]
    _, out = run(calm + stalled + after)
    time_s, index, truth = joined(out)
    assert not [x for x in out if isinstance(x, Loss)]
    assert np.array_equal(index, truth)
    assert time_s == pytest.approx(100.0 + truth / RATE_HZ, abs=1e-3)


def test_samples_are_given_out_soon():
    timer = StreamTimer(STREAM)
    n_in = n_out = 0
    for k in range(0, 3000, 10):
        n_out += sum(len(b.raw) for b in blocks_of(timer.push(chunk(k, 10))))
        n_in += 10
        if k > 600:
            assert n_in - n_out <= 0.2 * RATE_HZ + 10


def test_after_a_reconnect_the_outage_is_counted_by_time():
    timer, out = run(chunk(k, 10) for k in range(0, 1000, 10))
    out += timer.restart("cable pulled")
    # The instrument was switched off and on: it counts from 0 again, 0.6 s later.
    for k in range(0, 1000, 10):
        out += timer.push(chunk(k, 10, start_s=101.6))
    out += timer.flush()
    (loss,) = [x for x in out if isinstance(x, Loss)]
    time_s, index, _ = joined(out)
    assert loss.reason == "cable pulled"
    assert loss.n_missing == pytest.approx(600, abs=1)
    assert index[-1] == pytest.approx(2599, abs=1)
    assert np.all(np.diff(time_s) > 0)
    assert time_s[-1] == pytest.approx(101.6 + 0.999, abs=1e-3)


def test_each_frame_with_its_own_time_stamp():
    timer = StreamTimer(STREAM)
    rng = np.random.default_rng(3)
    out = []
    for k in range(0, 2000, 20):
        index = np.arange(k, k + 20)
        stamps = 50.0 + index / RATE_HZ + rng.exponential(2e-4, 20)
        out += timer.push(
            Chunk(stream="frames", raw=index[:, None].astype(float), arrival_s=np.maximum.accumulate(stamps))
        )
    time_s, _, truth = joined(out)
    assert time_s == pytest.approx(50.0 + truth / RATE_HZ, abs=2e-4)


def test_polled_samples_keep_their_own_times():
    timer = StreamTimer(Stream(name="values", rate_hz=0.0, channels=(CHANNEL,)))
    times = np.array([1.0, 1.0031, 1.0069])
    out = []
    for t in times:
        out += timer.push(Chunk(stream="values", raw=np.array([[t]]), arrival_s=np.array([t]), time_s=np.array([t])))
    out += timer.restart("cable pulled")
    out += timer.push(Chunk(stream="values", raw=np.array([[2.0]]), arrival_s=np.array([2.0]), time_s=np.array([2.0])))
    assert joined(out)[0].tolist() == [*times.tolist(), 2.0]
    assert [x.reason for x in out if isinstance(x, Loss)] == ["cable pulled"]


@pytest.mark.parametrize(("true_hz", "is_said"), [(1000.0, False), (1004.0, False), (800.0, True), (1250.0, True)])
def test_a_wrong_rate_is_said(true_hz, is_said):
    timer = StreamTimer(STREAM)
    for k in range(0, int(3.0 * true_hz), 10):
        arrival = np.array([5.0 + (k + 9) / true_hz])
        timer.push(Chunk(stream="frames", raw=np.zeros((10, 1)), arrival_s=arrival))
        if timer.is_settled:
            break
    assert bool(timer.rate_error()) is is_said


@pytest.mark.parametrize(("speed", "is_said"), [(1.0, False), (1.1, True), (0.9, True)])
def test_samples_that_come_late_at_first_are_no_wrong_rate(speed, is_said):
    """A busy machine hands out the first 0.4 s at once, 0.4 s after the first sample was taken."""
    timer = StreamTimer(STREAM)
    for first in range(0, 3000, 10):
        taken_s = 100.0 + (first + 9) / (speed * RATE_HZ)
        timer.push(replace(chunk(first, 10), arrival_s=np.array([max(taken_s, 100.4)])))
    assert bool(timer.rate_error()) is is_said


def test_what_gathered_before_the_first_read_comes_as_one_chunk():
    """The machine was busy for 3 s: what the link kept is read at once, then samples come as they are taken."""
    timer = StreamTimer(STREAM)
    out = timer.push(replace(chunk(0, 3000), arrival_s=np.array([103.0])))
    for first in range(3000, 5000, 10):
        out += timer.push(replace(chunk(first, 10), arrival_s=np.array([100.0 + (first + 9) / RATE_HZ])))
    time_s = np.concatenate([block.time_s for block in blocks_of(out)])
    assert np.abs(time_s - 100.0 - np.arange(len(time_s)) / RATE_HZ).max() < 1e-3
    assert not [item for item in out if not isinstance(item, TimedBlock)]


def test_a_lost_row_of_an_instrument_with_times_of_its_own_is_a_loss():
    timer = StreamTimer(Stream(name="values", rate_hz=0.0, channels=(CHANNEL,)))
    out = []
    for at_s, n_lost in ((1.0, 0), (1.1, 0), (1.4, 2)):
        arrival_s = np.array([at_s])
        out += timer.push(
            Chunk(stream="values", raw=np.ones((1, 1)), arrival_s=arrival_s, time_s=arrival_s, n_lost=n_lost)
        )
    (loss,) = [x for x in out if isinstance(x, Loss)]
    assert (loss.start_s, loss.end_s, loss.n_missing) == (1.1, 1.4, 2)
    assert [block.first_index for block in blocks_of(out)] == [0, 1, 4]


def test_a_gap_behind_which_nothing_came_does_not_raise_the_rate():
    recorder = StreamRecorder("cell", STREAM)
    recorder.push(chunk(0, 500))
    recorder.begin(100.5, 3.0)
    for k in range(500, 2500, 10):
        recorder.push(chunk(k, 10))
    # A second is lost, and what follows lies behind the end of the recording.
    recorder.push(chunk(3600, 10, n_lost=1100))
    recorder.finish(3.0, "lost")
    (status,) = recorder.status()
    assert status.n_missing > 900
    assert status.rate_hz == pytest.approx(RATE_HZ, rel=0.01)


def test_equally_spaced_samples_have_no_rounding_that_each_would_store():
    recorder = StreamRecorder("cell", STREAM)
    for k in range(0, 1000, 40):
        recorder.push(chunk(k, 40, late_s=1e-4 * np.sin(k)))
    recorder.begin(zero_s := 100.0 + 1.0 / 3.0, None)
    blocks = [item for k in range(1000, 3000, 40) for item in recorder.push(chunk(k, 40, late_s=1e-4 * np.sin(k)))]
    assert len(blocks) > 5
    for block in blocks:
        assert np.array_equal(block.time_s, block.time_s[0] + block.period_s * np.arange(len(block.time_s)))
        assert block.time_s == pytest.approx(100.0 + block.raw / RATE_HZ - zero_s, abs=1e-3)
