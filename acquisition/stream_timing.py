"""Chunks of one stream -> blocks with times, and the losses between them.

A stream without a sample counter tells its losses only by arriving late for good: a host or a link that was busy
catches up, a stream that lost samples does not. Chunks that arrive late are therefore held back until one or
the other is certain; then they are numbered. No sample can arrive before it was taken: one that does says that a
loss was none, and takes it back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.clock import (
    LARGEST_SLEW,
    LATE_LINK_S,
    LATE_SAMPLES,
    LATENCY_STD_S,
    LINK_LATENCY_S,
    SLEW_SETTLED_S,
    ArrivalClock,
    ClockLine,
)
from sawbench.acquisition.devices.device import Chunk, Stream
from sawbench.acquisition.timed_items import Doubt, Loss, Timed, TimedBlock
from sawbench.bench.recording import Alignment

_SETTLE_S: Final = 0.4
_SETTLE_SAMPLES: Final = 5
# After this long a stream begins however irregularly it comes.
_SETTLE_LONGEST_S: Final = 5.0
_BLOCK_S: Final = 0.2
_LATE_S: Final = 0.004
_LATE_STDS: Final = 6.0
# Earlier than possible by more than this contradicts the count, not just the estimate of the clock.
_EARLY_S: Final = 0.002
_EARLY_SAMPLES: Final = 1.5
_EARLY_STEP_S: Final = 0.0005
# It is waited for the earliest one, but no longer than this where a link falls back into time little by little.
_EARLY_WAIT_S: Final = 0.25
_EARLY_WAIT_LONGEST_S: Final = 1.0
_HOLD_SUSPECT_S: Final = 0.5
_SUSPECT_LATE_S: Final = 0.025
# Said so early that a loss is known of within 2 s, although it is not certain yet.
_SAY_LATE_S: Final = 1.75
_QUARTER_S: Final = 0.25
_STEADY_QUARTERS: Final = 4
_HOLD_LONGEST_S: Final = 10.0
# A clock goes wrong by its uncertainty in about the time that it was watched.
_BEFORE_STDS: Final = 5.0
_LARGEST_RATE_ERROR: Final = 0.03


@dataclass(frozen=True, kw_only=True, slots=True)
class _Held:
    chunk: Chunk
    n_before: int
    """Samples of this run before the chunk, with `n_lost` of every chunk up to and including this one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _Hold:
    """Why and since when chunks are held back, what was said of it.

    `earliest_s` is the most negative lateness seen, at `earliest_at_s`.
    """

    kind: Literal["late", "suspect", "early"]
    since_s: float
    earliest_s: float = 0.0
    earliest_at_s: float = 0.0
    said: Doubt | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class _Inferred:
    """Samples called lost by the time alone: `n` of them, before sample `from_index`."""

    from_index: int
    n: int


@dataclass(frozen=True, kw_only=True, slots=True)
class _Before:
    """The clock as it was before a loss was inferred, and until when it is still known well enough."""

    line: ClockLine
    until_s: float


class StreamTimer:
    """Number and time the samples of one stream.

    Notes
    -----
    A loss that no counter and no broken byte shows is found once it is longer than 4 ms (3 samples at low rates,
    6 standard deviations of the smallest latency) and nothing has come in time for 2.1 s; until then a late link and
    a loss are confounded, and the samples wait; that they do is said after 1.75 s. A shorter loss moves the times by
    less than that. A link that is late for longer is called a loss; when it comes in time again, the loss is taken back
    and the stretch is marked.
    Losses with broken bytes are resolved to about the smallest latency scatter, see `ArrivalClock.uncertainty_s`.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self._base = 0
        self._last_time_s: float | None = None
        self._reason_before_restart = ""
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

    def overdue(self, waited_s: float, *, first_sample_s: float, settle_s: float) -> str:
        """Say what has been waited for too long since the start; empty if nothing is.

        Parameters
        ----------
        waited_s : float
        first_sample_s, settle_s : float
            How long the first sample and a settled clock may take, beside the samples that they need.
        """
        first_sample_s += self.stream.period_s
        if not self.has_data and waited_s > first_sample_s:
            return f"opens, but sent no sample of {self.stream.name} within {first_sample_s:g} s"
        settle_s += (1 + _SETTLE_SAMPLES) * self.stream.period_s
        if not self._settled and waited_s > settle_s:
            return f"the samples of {self.stream.name} arrive too irregularly to be time-stamped within {settle_s:g} s"
        return ""

    def drift_ppm(self) -> tuple[float, float] | None:
        """See `ArrivalClock.drift_ppm`; None for polled instruments."""
        return self._clock.drift_ppm() if self.stream.rate_hz > 0 else None

    @property
    def alignment(self) -> Alignment | None:
        """How well the times are known; None for polled instruments and before any sample came."""
        if self.stream.rate_hz <= 0 or not self._n_seen:
            return None
        return Alignment(std_s=self._clock.uncertainty_s, latency_s=LINK_LATENCY_S)

    def statement(self) -> str:
        """How the times were made, in words."""
        if self.stream.rate_hz <= 0:
            return self.stream.own_time
        return self._clock.statement() if self._n_seen else "no samples"

    def push(self, chunk: Chunk) -> list[Timed]:
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
            steady = self._steady_clock()
            if steady is None:
                return []
            self._clock = steady
            self._settled = True
            self._session_start_s = self._clock.line.time_of(0)
            return self._release()
        return self._judge(newest_s)

    def _steady_clock(self) -> ArrivalClock | None:
        """The clock by which to begin; None while the latest samples may just be coming back into time."""
        for window_s in (max(_SETTLE_S, _SETTLE_SAMPLES * self.stream.period_s), LATE_LINK_S):
            if self._clock.span_s < window_s:
                return None
            clock = self._clock.of_latest(window_s)
            if clock.is_steady and self._clock.least_late_s(clock.line) >= self._early_limit_s():
                return clock
        return clock if self._clock.span_s >= _SETTLE_LONGEST_S else None

    def flush(self) -> list[Timed]:
        """Give out what is held, however uncertain (end of the recording, link lost)."""
        if not self._held or not self._n_seen:
            return []
        late = self._held[self._n_observed :] if self._settled else []
        late_s = min((self._late_s(held) for held in late), default=0.0)
        doubt = self._doubt_at_end(late_s) if self._hold is not None and late_s > self._tolerance_s() else []
        for held in late:
            self._observe(held)
        self._hold = None
        return [*self._release(), *doubt]

    def _doubt_at_end(self, late_s: float) -> list[Timed]:
        end_s = float(self._held[-1].chunk.arrival_s[-1])
        first = self._held[self._n_observed]
        start_s = min(end_s, self._clock.line.time_of(first.n_before))
        n = round(late_s * self.stream.rate_hz)
        text = f"the last samples came {late_s * 1e3:.0f} ms late: a late link, or {n} samples lost before them"
        return [Doubt(start_s=start_s, end_s=end_s, text=text)]

    def restart(self, reason: str) -> list[Timed]:
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
        self._hold: _Hold | None = None
        self._inferred: list[_Inferred] = []
        self._before: _Before | None = None
        self._session_start_s = 0.0
        self._is_first = True

    def _tolerance_s(self) -> float:
        return max(_LATE_S, LATE_SAMPLES / self.stream.rate_hz, _LATE_STDS * self._clock.uncertainty_s)

    def _early_limit_s(self) -> float:
        return -max(_EARLY_S, _EARLY_SAMPLES / self.stream.rate_hz)

    def _judge(self, newest_s: float) -> list[Timed]:
        held = self._held[-1]
        late_s = self._late_s(held)
        least_late_s = self._least_late_s(held)
        if self._hold is not None:
            return self._go_on_holding(self._hold, newest_s, late_s, least_late_s)
        if least_late_s < self._early_limit_s():
            self._hold = _Hold(kind="early", since_s=newest_s, earliest_s=least_late_s, earliest_at_s=newest_s)
        elif held.chunk.n_lost > 0 and not held.chunk.is_loss_exact:
            self._hold = _Hold(kind="suspect", since_s=newest_s)
        elif late_s > self._tolerance_s():
            self._hold = _Hold(kind="late", since_s=newest_s)
        else:
            self._observe(held)
            self._n_observed = len(self._held)
            return self._release() if self._held_s() >= _BLOCK_S else []
        return []

    def _go_on_holding(self, hold: _Hold, newest_s: float, late_s: float, least_late_s: float) -> list[Timed]:
        if least_late_s < min(self._early_limit_s(), hold.earliest_s - _EARLY_STEP_S):
            since_s = hold.since_s if hold.kind == "early" else newest_s
            hold = replace(hold, kind="early", since_s=since_s, earliest_s=least_late_s, earliest_at_s=newest_s)
            self._hold = hold
        if hold.kind == "early":
            is_over = newest_s - hold.earliest_at_s > _EARLY_WAIT_S or newest_s - hold.since_s > _EARLY_WAIT_LONGEST_S
            return self._contradicted(-hold.earliest_s) if is_over else []
        if hold.kind == "late" and late_s <= self._tolerance_s():
            said = hold.said
            over = [] if said is None else [replace(said, end_s=newest_s, text=f"over: {said.text}: nothing was lost")]
            return [*over, *self._end_hold()]
        lost_s = self._lost_in_hold_s(hold, newest_s)
        if lost_s is None:
            return self._say_late(hold, newest_s, late_s)
        n_extra = max(0, round((lost_s - self._clock.uncertainty_s) * self.stream.rate_hz))
        # The loss is behind the last chunk that was less late than it.
        less_late = [k for k, held in self._waiting() if self._late_s(held) < lost_s - self._tolerance_s()]
        at = less_late[-1] + 1 if less_late else self._n_observed
        return [*self._doubt_before(at), *self._end_hold(n_extra, at=at)]

    def _doubt_before(self, at: int) -> list[Timed]:
        """Say that samples were late for long before a loss at place `at`: part of the loss may have been there."""
        before = self._held[self._n_observed : at]
        if not before or before[-1].chunk.arrival_s[-1] - before[0].chunk.arrival_s[-1] < _QUARTER_S:
            return []
        late_s = max(self._late_s(held) for held in before)
        start_s, end_s = (self._clock.line.time_of(held.n_before) for held in (before[0], self._held[at]))
        text = f"samples came up to {late_s * 1e3:.0f} ms late before a loss: times here are early by up to as much"
        return [Doubt(start_s=start_s, end_s=end_s, text=f"{text} where part of it was here")]

    def _say_late(self, hold: _Hold, newest_s: float, late_s: float) -> list[Timed]:
        """Say once that samples wait, before it is certain whether any were lost."""
        if hold.said is not None or newest_s - hold.since_s < _SAY_LATE_S:
            return []
        text = f"samples come {late_s * 1e3:.0f} ms late since {newest_s - hold.since_s:.1f} s: a late link, or a loss"
        said = Doubt(start_s=hold.since_s, end_s=newest_s, text=text, is_decided=False)
        self._hold = replace(hold, said=said)
        return [said]

    def _waiting(self) -> list[tuple[int, _Held]]:
        """Held chunks that the clock has not observed, with their place."""
        return list(enumerate(self._held))[self._n_observed :]

    def _lost_in_hold_s(self, hold: _Hold, newest_s: float) -> float | None:
        """How much is missing for good, s; None while it may just be late."""
        waited_s = newest_s - hold.since_s
        is_suspect = hold.kind == "suspect"
        if waited_s < (_HOLD_SUSPECT_S if is_suspect else LATE_LINK_S):
            return None
        quarters: dict[int, float] = {}
        for _, held in self._waiting():
            quarter = int((newest_s - float(held.chunk.arrival_s[-1])) / _QUARTER_S)
            quarters[quarter] = min(self._late_s(held), quarters.get(quarter, np.inf))
        recent = [quarters[k] for k in range(2 if is_suspect else _STEADY_QUARTERS) if k in quarters]
        # Beyond what broken bytes explain, the link may be late on top.
        if is_suspect and min(recent) > _SUSPECT_LATE_S and waited_s < LATE_LINK_S:
            return None
        # What was lost stays away: a lateness that still changes is a link that is busy.
        is_steady = max(recent) - min(recent) <= self._tolerance_s()
        return min(recent) if is_steady or waited_s >= _HOLD_LONGEST_S else None

    def _contradicted(self, early_s: float) -> list[Timed]:
        """Handle samples that came before they can have been taken: they were counted as later ones than they are."""
        n_back, start_s = self._take_back(round(early_s * self.stream.rate_hz))
        if n_back:
            text = (
                f"{n_back} samples reported as lost arrived late; times here are late by up to {early_s * 1e3:.0f} ms"
            )
        else:
            text = (
                f"samples came {early_s * 1e3:.1f} ms earlier than possible: some were sent twice, or all earlier "
                "ones were late; times here are late by up to as much"
            )
        # What waits is stamped as one: the error fades over all of it, and behind it where it is too large for that.
        last_s = (self._last_time_s or 0.0) + max(early_s / LARGEST_SLEW, self._held_s())
        end_s = max(start_s, last_s + SLEW_SETTLED_S)
        return [Doubt(start_s=start_s, end_s=end_s, text=text, n_taken_back=n_back), *self._end_hold()]

    def _take_back(self, n_early: int) -> tuple[int, float]:
        """Number the samples as if up to `n_early` of those inferred as lost, the latest first, were none.

        Returns
        -------
        n_back : int
        start_s : float
            Where the earliest of them was, monotonic clock, s; the begin of the session where there is none.
        """
        n_back, start_s = 0, self._session_start_s
        while self._inferred and n_back < n_early:
            latest = self._inferred.pop()
            n = min(n_early - n_back, latest.n)
            if (latest.n - n) / self.stream.rate_hz <= -self._early_limit_s():
                # What is left of it is too little to be told from none.
                n = latest.n
            else:
                self._inferred.append(replace(latest, n=latest.n - n))
            start_s = self._clock.line.time_of(latest.from_index)
            # What waits is numbered again with the rest, so that it can be stamped behind what was given out.
            self._clock.renumber(latest.from_index, -n)
            n_back += n
            if n < latest.n:
                break
        self._held = [replace(h, n_before=h.n_before - n_back) for h in self._held]
        self._count -= n_back
        self._base += n_back
        if not self._inferred:
            self._before = None
        return n_back, start_s

    def _end_hold(self, n_extra: int = 0, *, at: int = 0) -> list[Timed]:
        """Let the held chunks go, with `n_extra` samples lost before the chunk at place `at`."""
        if n_extra:
            chunk = self._held[at].chunk
            chunk = replace(chunk, n_lost=chunk.n_lost + n_extra, is_loss_exact=False)
            self._held[at] = replace(self._held[at], chunk=chunk)
            self._inferred.append(_Inferred(from_index=self._held[at].n_before + n_extra, n=n_extra))
            self._count += n_extra
            now_s = float(self._held[-1].chunk.arrival_s[-1])
            if self._before is None or now_s > self._before.until_s:
                std_s = max(self._clock.uncertainty_s, LATENCY_STD_S)
                good_for_s = self._clock.span_s * -self._early_limit_s() / (_BEFORE_STDS * std_s)
                self._before = _Before(line=self._clock.line, until_s=now_s + good_for_s)
        for k, held in self._waiting():
            if n_extra and k >= at:
                self._held[k] = replace(held, n_before=held.n_before + n_extra)
            self._observe(self._held[k])
        self._hold = None
        return self._release()

    def _late_s(self, held: _Held) -> float:
        last = held.n_before + len(held.chunk.raw) - 1
        return self._clock.residual_s(last, float(held.chunk.arrival_s[-1]))

    def _least_late_s(self, held: _Held) -> float:
        """Lateness by the present clock or by the one before an inferred loss, whichever is less.

        A link that falls back into time little by little takes the present clock along.
        """
        arrival_s = float(held.chunk.arrival_s[-1])
        if self._before is None or arrival_s > self._before.until_s:
            return self._late_s(held)
        last = held.n_before + len(held.chunk.raw) - 1
        return min(self._late_s(held), arrival_s - self._before.line.time_of(last))

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

    def _release(self) -> list[Timed]:
        out: list[Timed] = []
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

    def _stamp(self, group: list[_Held]) -> list[Timed]:
        raw = np.concatenate([h.chunk.raw for h in group])
        first, n_lost = group[0].n_before, group[0].chunk.n_lost
        first_time_s, period_s = self._clock.stamp(first, len(raw))
        reason = "counted" if group[0].chunk.is_loss_exact else "lost in transmission; number derived from the time"
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
        out: list[Timed] = []
        if n_lost and self._last_time_s is not None:
            out.append(Loss(start_s=self._last_time_s, end_s=first_time_s, n_missing=n_lost, reason=reason))
        out.append(TimedBlock(first_index=self._base + first, time_s=time_s, period_s=period_s, raw=raw))
        self._last_time_s = float(time_s[-1])
        return out

    def _polled(self, chunk: Chunk, time_s: NDArray[np.float64]) -> list[Timed]:
        out: list[Timed] = []
        self._n_seen += len(time_s)
        if self._last_time_s is not None:
            later = time_s > self._last_time_s
            chunk, time_s = replace(chunk, raw=chunk.raw[later]), time_s[later]
            if not len(time_s):
                return []
            reason = self._reason_before_restart or ("lost in transmission" if chunk.n_lost else "")
            if reason:
                end_s = float(time_s[0])
                out.append(Loss(start_s=self._last_time_s, end_s=end_s, n_missing=chunk.n_lost, reason=reason))
                self._count += chunk.n_lost
                self._reason_before_restart = ""
        out.append(TimedBlock(first_index=self._base + self._count, time_s=time_s, period_s=None, raw=chunk.raw))
        self._count += len(time_s)
        self._last_time_s = float(time_s[-1])
        return out
