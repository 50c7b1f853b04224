"""Links that are late and lose nothing, and losses that no counter shows: synthetic arrivals with a known truth."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.devices.device import Chunk, Stream, StreamChannel
from sawbench.acquisition.stream_timing import Doubt, Loss, StreamTimer, TimedBlock

pytestmark = pytest.mark.unit

CHANNEL = StreamChannel(name="force_n", unit="N", calibration=Calibration(), valid_range=(-1e12, 1e12))
READ_EVERY_S = 0.0047
START_S = 100.0
PPM = 30.0
# The scatter of the smallest latency itself, where a sample is shorter than it.
SMALLEST_ERROR_S = 0.00015


def late(seconds, lasts_s, at_s=4.0):
    return lambda t: seconds if at_s <= t < at_s + lasts_s else 0.0


def stalled(lasts_s, at_s=4.0):
    return lambda t: at_s + lasts_s - t if at_s <= t < at_s + lasts_s else 0.0


def rising(seconds, lasts_s, at_s=4.0):
    return lambda t: seconds * (t - at_s) / lasts_s if at_s <= t < at_s + lasts_s else 0.0


def swelling(seconds, lasts_s, at_s=4.0):
    return lambda t: seconds * (1 - abs(2 * (t - at_s) / lasts_s - 1)) if at_s <= t < at_s + lasts_s else 0.0


LATE = {
    **{f"{ms} ms late for {s} s": late(ms / 1e3, s) for ms in (5, 20, 100, 300, 2000) for s in (0.1, 0.5, 1.5, 2.0)},
    **{f"stalled for {s} s": stalled(s) for s in (0.05, 0.2, 0.5, 1.0, 2.0)},
    **{f"rising to {s} s": rising(s, 2.0) for s in (0.05, 0.5)},
    **{f"swelling to {s} s": swelling(s, 2.0) for s in (0.05, 0.5)},
    "100 ms late, 1 s of every 3 s": lambda t: 0.1 if t > 2 and t % 3 < 1 else 0.0,
    "30 ms late, half of every second": lambda t: 0.03 if t > 2 and t % 1 < 0.5 and t < 10 else 0.0,
    "late as soon as it may be": late(0.1, 1.5, at_s=0.7),
}


def timed(rate_hz, lateness, *, lost=(), twice=(), seconds=11.0, jitter_s=1e-4):
    """Errors (s) and true times (s) of all samples, and what was said beside them.

    `lost`, `twice`: (time in s, number) of samples left out and repeated.
    """
    rng = np.random.default_rng(3)
    period_s = 1.0 / (rate_hz * (1.0 + PPM * 1e-6))
    sent = np.arange(int(seconds / period_s))
    for at_s, n in lost:
        sent = np.delete(sent, slice(int(at_s * rate_hz), int(at_s * rate_hz) + n))
    for at_s, n in twice:
        first = int(np.searchsorted(sent, at_s * rate_hz))
        sent = np.insert(sent, first, sent[first - n : first])
    sent_s = np.maximum.accumulate(sent) * period_s
    timer = StreamTimer(Stream(name="frames", rate_hz=rate_hz, channels=(CHANNEL,)))
    items, begin, arrival_s = [], 0, 0.0
    for read_s in np.arange(READ_EVERY_S, seconds, READ_EVERY_S):
        end = int(np.searchsorted(sent_s, read_s, side="right"))
        arrival_s = max(arrival_s, read_s + rng.exponential(jitter_s) + lateness(read_s))
        if end > begin:
            raw = sent[begin:end, None].astype(float)
            items += timer.push(Chunk(stream="frames", raw=raw, arrival_s=np.array([START_S + arrival_s])))
            begin = end
    items += timer.flush()
    blocks = [item for item in items if isinstance(item, TimedBlock)]
    time_s = np.concatenate([b.time_s for b in blocks]) - START_S
    true_s = np.concatenate([b.raw[:, 0] for b in blocks]) * period_s
    index = np.concatenate([b.first_index + np.arange(len(b.time_s)) for b in blocks])
    assert len(time_s) == begin
    assert np.all(np.diff(time_s) > 0)
    assert np.all(np.diff(index) >= 1)
    said = [[item for item in items if isinstance(item, kind)] for kind in (Loss, Doubt)]
    return time_s - true_s, true_s, *said


@pytest.mark.parametrize("rate_hz", [1000.0, 6000.0, 10_000.0])
@pytest.mark.parametrize("name", LATE)
def test_lateness_up_to_two_seconds_moves_no_time_and_loses_nothing(name, rate_hz):
    error_s, _, losses, doubts = timed(rate_hz, LATE[name])
    assert not losses
    assert not doubts
    assert np.abs(error_s).max() <= max(1.0 / rate_hz, SMALLEST_ERROR_S)


@pytest.mark.parametrize("lasts_ms", [5, 10, 60, 1000])
@pytest.mark.parametrize("name", ["100 ms late for 0.5 s", "30 ms late, half of every second", "stalled for 0.05 s"])
@pytest.mark.parametrize("rate_hz", [1000.0, 6000.0])
def test_a_loss_of_five_milliseconds_is_found_and_the_times_after_it_are_right(rate_hz, name, lasts_ms):
    n = round(lasts_ms * rate_hz / 1e3)
    error_s, true_s, losses, _ = timed(rate_hz, LATE[name], lost=[(7.0, n)])
    (loss,) = losses
    assert loss.n_missing == pytest.approx(n, abs=1)
    assert loss.start_s - START_S == pytest.approx(7.0, abs=0.6 if "half" in name else 0.01)
    assert np.abs(error_s[true_s > 7.6]).max() <= 1.0 / rate_hz + SMALLEST_ERROR_S


def test_a_link_late_for_longer_is_called_a_loss_and_taken_back():
    error_s, true_s, losses, doubts = timed(6000.0, late(0.1, 3.0))
    (loss,), (doubt,) = losses, doubts
    assert loss.n_missing == doubt.n_taken_back
    assert loss.n_missing == pytest.approx(600, abs=3)
    # The doubt covers every time that is wrong by more than a sample.
    wrong_s = true_s[np.abs(error_s) > 1.0 / 6000.0]
    assert doubt.start_s - START_S <= wrong_s.min() + 0.11
    assert doubt.end_s - START_S >= wrong_s.max()
    assert wrong_s.max() < 7.0 + 3.5


def test_a_link_late_while_its_clock_settles_is_said():
    error_s, true_s, _, doubts = timed(6000.0, late(0.1, 0.5, at_s=0.0))
    (doubt,) = doubts
    assert "earlier than possible" in doubt.text
    assert np.abs(error_s[true_s > doubt.end_s - START_S]).max() <= 1.0 / 6000.0


def test_frames_sent_twice_are_said_and_the_times_after_them_are_right():
    error_s, true_s, _, doubts = timed(6000.0, lambda _: 0.0, twice=[(5.0, 60)])
    (doubt,) = doubts
    assert "sent twice" in doubt.text
    assert np.abs(error_s[true_s > doubt.end_s - START_S]).max() <= 1.0 / 6000.0


def test_what_is_late_when_the_recording_ends_is_said():
    _, _, losses, doubts = timed(6000.0, late(0.05, 2.0, at_s=10.0))
    (doubt,) = doubts
    assert not losses
    assert "a late link, or 30" in doubt.text
