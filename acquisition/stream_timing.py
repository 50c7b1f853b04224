"""Chunks of one stream -> blocks with times, and the losses between them.

A stream without a sample counter tells its losses only by arriving late for good: a host that was busy
catches up, a stream that lost samples does not. Chunks that arrive late are therefore held back until one or
the other is certain; then they are numbered.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from acquisition.clock import ArrivalClock
from acquisition.devices.device import Chunk, Stream

_SETTLE_S: Final = 0.4
_SETTLE_SAMPLES: Final = 5
_BLOCK_S: Final = 0.1
_LATE_S: Final = 0.025
_LATE_SAMPLES: Final = 3
_HOLD_SUSPECT_S: Final = 0.5
_HOLD_LATE_S: Final = 1.0
_LARGEST_RATE_ERROR: Final = 0.03


@dataclass(frozen=True, kw_only=True, slots=True)
class TimedBlock:
    """Samples with times on the monotonic clock.

    Attributes
    ----------
    first_index : int
    time_s : ndarray, shape (n,), s
    period_s : float, optional
        Spacing, where it is constant.
    raw : ndarray, shape (n, n_channels)
    """

    first_index: int
    time_s: NDArray[np.float64]
    period_s: float | None
    raw: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class Loss:
    """Samples that never came.

    Attributes
    ----------
    start_s, end_s : float
        Last sample before and first one after, monotonic clock, s.
    n_missing : int
    reason : str
    """

    start_s: float
    end_s: float
    n_missing: int
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class _Held:
    chunk: Chunk
    n_before: int
    """Samples of this session before the chunk, with `n_lost` of every chunk up to and including this one."""


class StreamTimer:
    """Number and time the samples of one stream.

    Parameters
    ----------
    stream : Stream

    Notes
    -----
    A loss that no counter and no broken byte shows is found once it is longer than 25 ms (3 samples at low
    rates); a shorter one moves the times by less than that, until the clock has followed. Losses with broken
    bytes are resolved to about the smallest latency scatter, see `ArrivalClock.uncertainty_s`.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self._base = 0
        self._last_time_s: float | None = None
        self._reason_before_restart = ""
        self._last_polled = 0
        self._begin_session()

    @property
    def is_settled(self) -> bool:
        """Whether enough arrivals were seen to give times."""
        return self._settled

    @property
    def has_data(self) -> bool:
        """Whether anything came since the (re)start."""
        return self._n_seen > 0

    @property
    def last_time_s(self) -> float | None:
        """Time of the last sample given out, monotonic clock, s."""
        return self._last_time_s

    def rate_error(self) -> str:
        """Say what is wrong with the measured rate; empty if nothing is."""
        if self.stream.rate_hz <= 0 or not self._settled:
            return ""
        measured_hz = self._clock.measured_rate_hz()
        # Over the short settling time the rate is only known to the scatter of the arrivals.
        allowed = _LARGEST_RATE_ERROR + 0.03 / max(self._clock.span_s, 1e-3)
        if abs(measured_hz / self.stream.rate_hz - 1.0) <= allowed:
            return ""
        return f"{self.stream.name} sends {measured_hz:.4g} samples/s, configured are {self.stream.rate_hz:g}"

    def drift_ppm(self) -> tuple[float, float] | None:
        """See `ArrivalClock.drift_ppm`; None for polled instruments."""
        return self._clock.drift_ppm() if self.stream.rate_hz > 0 else None

    def statement(self) -> str:
        """How the times were made, in words."""
        if self.stream.rate_hz <= 0:
            return "middle between question and answer of each sample"
        return self._clock.statement() if self._n_seen else "no samples"

    def push(self, chunk: Chunk) -> list[TimedBlock | Loss]:
        """Take one chunk; return what has become certain, in order of time."""
        n = len(chunk.raw)
        if not n:
            return []
        if chunk.time_s is not None:
            return self._polled(chunk, chunk.time_s)
        self._count += chunk.n_lost
        self._held.append(_Held(chunk=chunk, n_before=self._count))
        self._n_seen += n
        self._count += n
        newest_s = float(chunk.arrival_s[-1])
        if not self._settled:
            self._observe(self._held[-1])
            if self._clock.span_s < max(_SETTLE_S, _SETTLE_SAMPLES / self.stream.rate_hz):
                return []
            self._settled = True
            return self._release()
        return self._judge(newest_s)

    def flush(self) -> list[TimedBlock | Loss]:
        """Give out what is held, however uncertain (end of the recording, link lost)."""
        if not self._held or not self._n_seen:
            return []
        if self._settled:
            for held in self._held[self._n_observed :]:
                self._observe(held)
        return self._release()

    def restart(self, reason: str) -> list[TimedBlock | Loss]:
        """Give out what is held, as the link was lost; the next chunk begins a new count."""
        out = self.flush()
        self._reason_before_restart = reason
        self._base += self._count
        self._begin_session()
        return out

    def _begin_session(self) -> None:
        self._settled = self.stream.rate_hz <= 0
        self._clock = ArrivalClock(rate_hz=self.stream.rate_hz or 1.0)
        self._held: list[_Held] = []
        self._n_observed = 0
        self._count = 0
        self._n_seen = 0
        self._hold_since_s: float | None = None
        self._hold_limit_s = 0.0
        self._is_first = True

    def _judge(self, newest_s: float) -> list[TimedBlock | Loss]:
        held = self._held[-1]
        late_s = self._late_s(held)
        tolerance_s = max(_LATE_S, _LATE_SAMPLES / self.stream.rate_hz)
        is_suspect = held.chunk.n_lost > 0 and not held.chunk.is_loss_exact
        if self._hold_since_s is None:
            if not is_suspect and late_s <= tolerance_s:
                self._observe(held)
                self._n_observed = len(self._held)
                return self._release() if self._held_s() >= _BLOCK_S else []
            self._hold_since_s = newest_s
            self._hold_limit_s = _HOLD_SUSPECT_S if is_suspect else _HOLD_LATE_S
            return []
        is_waiting_for_bytes = self._hold_limit_s == _HOLD_SUSPECT_S
        if late_s <= tolerance_s and not is_waiting_for_bytes:
            return self._end_hold(0)
        if newest_s - self._hold_since_s < self._hold_limit_s:
            return []
        smallest_s = min(self._late_s(h) for h in self._held[self._n_observed :])
        n_extra = round((smallest_s - self._clock.uncertainty_s) * self.stream.rate_hz)
        return self._end_hold(max(0, n_extra))

    def _end_hold(self, n_extra: int) -> list[TimedBlock | Loss]:
        first = self._n_observed
        if n_extra:
            chunk = self._held[first].chunk
            self._held[first] = replace(
                self._held[first], chunk=replace(chunk, n_lost=chunk.n_lost + n_extra, is_loss_exact=False)
            )
        for k in range(first, len(self._held)):
            self._held[k] = replace(self._held[k], n_before=self._held[k].n_before + n_extra)
            self._observe(self._held[k])
        self._count += n_extra
        self._hold_since_s = None
        return self._release()

    def _late_s(self, held: _Held) -> float:
        last = held.n_before + len(held.chunk.raw) - 1
        return self._clock.residual_s(last, float(held.chunk.arrival_s[-1]))

    def _observe(self, held: _Held) -> None:
        arrival_s = held.chunk.arrival_s
        n = len(held.chunk.raw)
        if len(arrival_s) == n:
            # Time stamps of the bus: each sample has its own; the least late one is as good as all.
            index = np.arange(n)
            best = int(np.argmin(arrival_s - index / self.stream.rate_hz))
            self._clock.observe(held.n_before + best, float(arrival_s[best]))
            if best != n - 1:
                self._clock.observe(held.n_before + n - 1, float(arrival_s[-1]))
        else:
            self._clock.observe(held.n_before + n - 1, float(arrival_s[-1]))

    def _held_s(self) -> float:
        return sum(len(h.chunk.raw) for h in self._held) / self.stream.rate_hz

    def _release(self) -> list[TimedBlock | Loss]:
        out: list[TimedBlock | Loss] = []
        group: list[_Held] = []
        for held in self._held:
            if group and held.chunk.n_lost:
                out += self._stamp(group)
                group = []
            group.append(held)
        out += self._stamp(group)
        self._held = []
        self._n_observed = 0
        return out

    def _stamp(self, group: list[_Held]) -> list[TimedBlock | Loss]:
        raw = np.concatenate([h.chunk.raw for h in group])
        first, n_lost = group[0].n_before, group[0].chunk.n_lost
        first_time_s, period_s = self._clock.stamp(first, len(raw))
        reason = "counted" if group[0].chunk.is_loss_exact else "lost on the way, their number from the time"
        if self._is_first and self._last_time_s is not None:
            # First block after the link came back: how many samples the outage cost follows from the time.
            first_time_s = max(first_time_s, self._last_time_s + period_s)
            n_lost = max(0, round((first_time_s - self._last_time_s) / period_s) - 1)
            self._base += n_lost - first
            reason = self._reason_before_restart
        elif self._is_first:
            self._base -= first
            n_lost = 0
        self._is_first = False
        time_s = first_time_s + period_s * np.arange(len(raw), dtype=np.float64)
        out: list[TimedBlock | Loss] = []
        if n_lost and self._last_time_s is not None:
            out.append(Loss(start_s=self._last_time_s, end_s=first_time_s, n_missing=n_lost, reason=reason))
        out.append(TimedBlock(first_index=self._base + first, time_s=time_s, period_s=period_s, raw=raw))
        self._last_time_s = float(time_s[-1])
        return out

    def _polled(self, chunk: Chunk, time_s: NDArray[np.float64]) -> list[TimedBlock | Loss]:
        out: list[TimedBlock | Loss] = []
        self._n_seen += len(time_s)
        if self._last_time_s is not None:
            later = time_s > self._last_time_s
            chunk, time_s = replace(chunk, raw=chunk.raw[later]), time_s[later]
            if not len(time_s):
                return []
            if self._reason_before_restart:
                out.append(
                    Loss(
                        start_s=self._last_time_s,
                        end_s=float(time_s[0]),
                        n_missing=0,
                        reason=self._reason_before_restart,
                    )
                )
                self._reason_before_restart = ""
        out.append(TimedBlock(first_index=self._base + self._count, time_s=time_s, period_s=None, raw=chunk.raw))
        self._count += len(time_s)
        self._last_time_s = float(time_s[-1])
        return out
