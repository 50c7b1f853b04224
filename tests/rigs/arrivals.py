"""Arrivals of a stream at a host, with a known truth: late links, losses, frames sent twice.

Shares no code with the clock that it tests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.devices.device import Chunk, Stream, StreamChannel
from sawbench.acquisition.stream_timing import Doubt, Loss, StreamTimer, TimedBlock

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


@dataclass(frozen=True, kw_only=True)
class Found:
    """What a `StreamTimer` made of arrivals.

    Attributes
    ----------
    error_s, true_s : ndarray, shape (n,), s
        Of every sample, in the order of their true times.
    losses, doubts : list
        `doubts` without those that were about to be decided.
    undecided : list of Doubt
        What was said of samples that are late and wait: at the beginning, and where nothing was lost at the end.
    loss_said_s : list of float
        When the host was told of each loss, s.
    first_said_s : list of float
        When it was told that there is one, or that samples are late and may be lost, s.
    """

    error_s: np.ndarray
    true_s: np.ndarray
    losses: list[Loss]
    doubts: list[Doubt]
    undecided: list[Doubt]
    loss_said_s: list[float]
    first_said_s: list[float]

    @property
    def n_late(self) -> int:
        """How often it was said that samples are late."""
        return sum(not doubt.text.startswith("over") for doubt in self.undecided)


def timed(
    rate_hz,
    lateness,
    *,
    lost=(),
    twice=(),
    seconds=11.0,
    jitter_s=1e-4,
    ppm=PPM,
    seed=3,
    read_every_s=READ_EVERY_S,
):
    """Send a stream through a link that is late by `lateness` (a function of time, s) and have it timed.

    `lost`, `twice`: (time in s, number) of samples left out and repeated.
    """
    rng = np.random.default_rng(seed)
    period_s = 1.0 / (rate_hz * (1.0 + ppm * 1e-6))
    sent = np.arange(int(seconds / period_s))
    for at_s, n in lost:
        sent = np.delete(sent, slice(int(at_s * rate_hz), int(at_s * rate_hz) + n))
    for at_s, n in twice:
        first = int(np.searchsorted(sent, at_s * rate_hz))
        sent = np.insert(sent, first, sent[first - n : first])
    sent_s = np.maximum.accumulate(sent) * period_s
    timer = StreamTimer(Stream(name="frames", rate_hz=rate_hz, channels=(CHANNEL,)))
    items, said_s, begin, arrival_s = [], [], 0, 0.0
    for read_s in np.arange(read_every_s, seconds, read_every_s):
        end = int(np.searchsorted(sent_s, read_s, side="right"))
        arrival_s = max(arrival_s, read_s + rng.exponential(jitter_s) + lateness(read_s))
        if end > begin:
            raw = sent[begin:end, None].astype(float)
            items += timer.push(Chunk(stream="frames", raw=raw, arrival_s=np.array([START_S + arrival_s])))
            said_s += [arrival_s] * (len(items) - len(said_s))
            begin = end
    items += timer.flush()
    said_s += [arrival_s] * (len(items) - len(said_s))
    blocks = [item for item in items if isinstance(item, TimedBlock)]
    time_s = np.concatenate([b.time_s for b in blocks]) - START_S
    true_s = np.concatenate([b.raw[:, 0] for b in blocks]) * period_s
    index = np.concatenate([b.first_index + np.arange(len(b.time_s)) for b in blocks])
    assert len(time_s) == begin
    assert np.all(np.diff(time_s) > 0)
    assert np.all(np.diff(index) >= 1)
    said = list(zip(items, said_s, strict=True))
    undecided = [(item, at_s) for item, at_s in said if isinstance(item, Doubt) and not item.is_decided]
    begun_s = [at_s for item, at_s in undecided if not item.text.startswith("over")]
    loss_said_s = [at_s for item, at_s in said if isinstance(item, Loss)]
    return Found(
        error_s=time_s - true_s,
        true_s=true_s,
        losses=[item for item in items if isinstance(item, Loss)],
        doubts=[item for item in items if isinstance(item, Doubt) and item.is_decided],
        undecided=[item for item, _ in undecided],
        loss_said_s=loss_said_s,
        first_said_s=sorted(loss_said_s + begun_s),
    )
