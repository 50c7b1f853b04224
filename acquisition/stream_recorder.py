"""One stream of one device on its way into the recording: times, calibration, range, gaps, counters."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.devices.device import Chunk, Stream, StreamChannel
from sawbench.acquisition.recording_report import ChannelStatus
from sawbench.acquisition.stream_timing import Doubt, Loss, StreamTimer, Timed, TimedBlock
from sawbench.bench.recording import Event, SampleBlock

OUTSIDE = "outside the valid range of the instrument"
# So many periods without a sample are no jitter.
SILENT_PERIODS = 3.0
_SMALLEST_SILENCE_S = 0.25
_CUT_SHORT_S = 1.0


@dataclass(kw_only=True, slots=True)
class _Counter:
    n_samples: int = 0
    n_gaps: int = 0
    n_missing: int = 0
    latest: float | None = None
    first_s: float = 0.0
    last_s: float = 0.0
    # From the first sample to the last one: losses, and intervals between samples that arrived, out of range or not.
    gap_s: float = 0.0
    n_intervals: int = 0
    # Behind the last sample: they count once another one follows.
    gap_behind_s: float = 0.0
    n_intervals_behind: int = 0

    @property
    def rate_hz(self) -> float:
        span_s = self.last_s - self.first_s - self.gap_s
        return self.n_intervals / span_s if span_s > 0 else 0.0

    def take(self, time_s: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Count samples that follow each other."""
        if self.n_samples:
            self.gap_s += self.gap_behind_s
            self.n_intervals += self.n_intervals_behind + 1
        else:
            self.first_s = float(time_s[0])
        self.gap_behind_s, self.n_intervals_behind = 0.0, 0
        self.n_samples += len(time_s)
        self.n_intervals += len(time_s) - 1
        self.last_s, self.latest = float(time_s[-1]), float(values[-1])


class StreamRecorder:
    """Chunks in, sample blocks and gap events on the recording's clock out. Starts no thread, reads no clock."""

    def __init__(self, device: str, stream: Stream) -> None:
        self.device = device
        self.stream = stream
        self.timer = StreamTimer(stream)
        self._zero_s: float | None = None
        self._end_s = np.inf
        self._counters = {channel.name: _Counter() for channel in stream.channels}
        self._reached_s = -np.inf
        self._is_cut_short = False
        self._keep_s = 0.0
        self._kept: deque[Timed] = deque()
        self._warnings: list[str] = []

    @property
    def reached_s(self) -> float:
        """Recording time up to which samples were given out, s."""
        return self._reached_s

    @property
    def is_cut_short(self) -> bool:
        """Whether the samples ended over a second before the recording did; known after `finish`."""
        return self._is_cut_short

    def keep(self, seconds: float) -> None:
        """From now on, keep samples of the latest `seconds` for a recording that begins in the past."""
        self._keep_s = seconds

    @property
    def kept(self) -> tuple[TimedBlock, ...]:
        """What is kept, the latest last."""
        return tuple(item for item in self._kept if isinstance(item, TimedBlock))

    def begin(self, zero_s: float, duration_s: float | None) -> list[SampleBlock | Event]:
        """Let samples from monotonic time `zero_s` on into the recording, for `duration_s`; return those kept."""
        self._zero_s = zero_s
        self._end_s = np.inf if duration_s is None else duration_s
        kept = list(self._kept)
        self._kept.clear()
        return self._to_recording(kept) + self._warned()

    def push(self, chunk: Chunk) -> list[SampleBlock | Event]:
        """Take one chunk; return what belongs into the recording now."""
        if chunk.warning:
            self._warnings.append(chunk.warning)
        return self._to_recording(self.timer.push(chunk)) + self._warned()

    def link_lost(self, reason: str) -> list[SampleBlock | Event]:
        """Note that the link broke; the next chunk is the first after the gap."""
        return self._to_recording(self.timer.restart(reason))

    def finish(self, end_s: float, reason: str) -> list[SampleBlock | Event]:
        """Give out what is held, and a gap event where the stream ended before `end_s` (recording time)."""
        out = self._to_recording(self.timer.flush())
        silence_s = max(_SMALLEST_SILENCE_S, SILENT_PERIODS * self.stream.period_s if self.stream.rate_hz > 0 else 1.0)
        last_s = max(0.0, self._reached_s)
        if self._zero_s is not None and end_s - last_s > silence_s:
            n_missing = round((end_s - last_s) * self.stream.rate_hz)
            out += self._gaps(last_s, end_s, n_missing, reason, is_inside=False)
            self._is_cut_short = end_s - last_s > _CUT_SHORT_S
        return out

    def status(self) -> tuple[ChannelStatus, ...]:
        """Counters of every channel."""
        return tuple(self._status(channel) for channel in self.stream.channels)

    def _status(self, channel: StreamChannel) -> ChannelStatus:
        c = self._counters[channel.name]
        return ChannelStatus(
            device=self.device,
            channel=channel.name,
            unit=channel.unit,
            n_samples=c.n_samples,
            rate_hz=c.rate_hz,
            n_gaps=c.n_gaps,
            n_missing=c.n_missing,
            latest=c.latest,
        )

    def _warned(self) -> list[SampleBlock | Event]:
        """Give out what the driver warned of, once the recording has begun."""
        if self._zero_s is None:
            return []
        texts, self._warnings = self._warnings, []
        at_s = max(0.0, self._reached_s)
        return [Event(kind="warning", time_s=at_s, text=text, device=self.device) for text in texts]

    def _to_recording(self, items: list[Timed]) -> list[SampleBlock | Event]:
        if self._zero_s is None:
            self._keep(items)
            return []
        out: list[SampleBlock | Event] = []
        for item in items:
            if isinstance(item, Loss):
                out += self._loss(item, self._zero_s)
            elif isinstance(item, Doubt):
                out += self._doubt(item, self._zero_s)
            else:
                out += self._block(item, self._zero_s)
        return out

    def _keep(self, items: list[Timed]) -> None:
        if not self._keep_s:
            return
        self._kept.extend(items)
        newest_s = max((float(block.time_s[-1]) for block in self.kept[-1:]), default=-np.inf)
        while self._kept and _end_of(self._kept[0]) < newest_s - self._keep_s:
            self._kept.popleft()

    def _loss(self, loss: Loss, zero_s: float) -> list[Event]:
        start_s, end_s = loss.start_s - zero_s, loss.end_s - zero_s
        if end_s <= 0 or start_s >= self._end_s:
            return []
        inside = (min(end_s, self._end_s) - max(start_s, 0.0)) / (end_s - start_s)
        return self._gaps(max(start_s, 0.0), min(end_s, self._end_s), round(loss.n_missing * inside), loss.reason)

    def _doubt(self, doubt: Doubt, zero_s: float) -> list[Event]:
        start_s, end_s = max(doubt.start_s - zero_s, 0.0), min(doubt.end_s - zero_s, self._end_s)
        for counter in self._counters.values():
            counter.n_missing -= min(doubt.n_taken_back, counter.n_missing)
        if end_s < start_s:
            return []
        text = f"{self.stream.name}: {doubt.text}"
        return [Event(kind="warning", time_s=start_s, end_s=end_s, text=text, device=self.device)]

    def _gaps(
        self, start_s: float, end_s: float, n_missing: int, reason: str, *, is_inside: bool = True
    ) -> list[Event]:
        events = []
        for channel in self.stream.channels:
            counter = self._counters[channel.name]
            counter.n_gaps += 1
            counter.n_missing += n_missing
            if is_inside:
                counter.gap_behind_s += end_s - start_s
                counter.n_intervals_behind -= 1
            events.append(self._gap_event(channel, start_s, end_s, n_missing, reason))
        return events

    def _gap_event(self, channel: StreamChannel, start_s: float, end_s: float, n_missing: int, reason: str) -> Event:
        return Event(
            kind="gap",
            time_s=start_s,
            end_s=end_s,
            text=f"about {n_missing} samples missing: {reason}",
            device=self.device,
            channel=channel.name,
        )

    def _block(self, block: TimedBlock, zero_s: float) -> list[SampleBlock | Event]:
        time_s = _recording_time_s(block, zero_s)
        inside = (time_s >= 0.0) & (time_s < self._end_s)
        self._reached_s = max(self._reached_s, float(time_s[-1]))
        if not inside.any():
            return []
        first = int(np.argmax(inside))
        time_s, raw = time_s[inside], block.raw[inside]
        out: list[SampleBlock | Event] = []
        for column, channel in enumerate(self.stream.channels):
            out += self._channel(channel, block, block.first_index + first, time_s, raw[:, column])
        return out

    def _channel(
        self,
        channel: StreamChannel,
        block: TimedBlock,
        first_index: int,
        time_s: NDArray[np.float64],
        raw: NDArray[np.float64],
    ) -> list[SampleBlock | Event]:
        with np.errstate(over="ignore", invalid="ignore"):
            values = channel.calibration.apply(raw)
            low, high = channel.valid_range
            is_valid = np.isfinite(raw) & (values >= low) & (values <= high)
        counter = self._counters[channel.name]
        out: list[SampleBlock | Event] = []
        if not is_valid.all():
            bad = np.flatnonzero(~is_valid)
            counter.n_gaps += 1
            counter.n_missing += len(bad)
            reason = f"{OUTSIDE}, {low:g}..{high:g} {channel.unit}"
            out.append(self._gap_event(channel, float(time_s[bad[0]]), float(time_s[bad[-1]]), len(bad), reason))
        end = 0
        for a, b in _runs(is_valid):
            out.append(
                SampleBlock(
                    device=self.device,
                    channel=channel.name,
                    unit=channel.unit,
                    first_index=first_index + a,
                    time_s=time_s[a:b],
                    values=values[a:b],
                    raw=raw[a:b],
                    period_s=block.period_s,
                )
            )
            counter.n_intervals_behind += a - end
            counter.take(time_s[a:b], values[a:b])
            end = b
        counter.n_intervals_behind += len(time_s) - end
        return out


def _recording_time_s(block: TimedBlock, zero_s: float) -> NDArray[np.float64]:
    """Times since `zero_s`, s; equally spaced ones without a rounding of their own, which would be stored with each."""
    if block.period_s is None:
        return block.time_s - zero_s
    return (float(block.time_s[0]) - zero_s) + block.period_s * np.arange(len(block.time_s), dtype=np.float64)


def _end_of(item: Timed) -> float:
    """Monotonic time at which it ends, s."""
    return float(item.time_s[-1]) if isinstance(item, TimedBlock) else item.end_s


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Half-open index ranges where `mask` is true."""
    edges = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))
