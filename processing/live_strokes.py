"""Strokes from the streaming samples: where each begins and ends, and the time means over it.

A stroke runs from one dead centre at the smallest displacement to the next. The dead centre is the vertex of
a parabola through the samples around the minimum, found as soon as the blade has risen past the upper quarter:
half a stroke late, with nothing taken from the future.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats, SampleBlock
from sawbench.bench.units import BATTERY_CURRENT, BATTERY_VOLTAGE, CHANNEL_BY_NAME, DISPLACEMENT, FORCE, MOTOR_CURRENT

MEANS: Final = (FORCE.name, MOTOR_CURRENT.name, BATTERY_VOLTAGE.name, BATTERY_CURRENT.name)
# Share of the stroke, from the bottom, that the parabola is laid through.
NEAR_DEAD_CENTRE: Final = 0.12
FEWEST_AT_DEAD_CENTRE: Final = 5
# Two strokes whose periods differ by less begin the settled run; it ends where they differ by more.
SETTLED: Final = 0.01
UNSETTLED: Final = 0.25
# A stroke has no mean of a channel that was silent for this share of it.
LONGEST_SILENCE: Final = 0.1
# A channel this far behind the displacement is taken as lost, s.
LATEST_S: Final = 0.5
# The rest counts up to this long before the last block in which the blade stood, s.
REST_MARGIN_S: Final = 0.05


@dataclass(frozen=True, kw_only=True, slots=True)
class LiveStroke:
    """One stroke of the stream; means over time, None where a channel is missing or has a gap.

    Attributes
    ----------
    start_s, end_s : float
        Dead centres at the smallest displacement, on the recording's clock.
    is_settled : bool
        False while the saw spins up or down: then the current also moves the masses.
    mean_force_n, mean_current_a, battery_voltage_v, battery_current_a : float or None
    """

    start_s: float
    end_s: float
    is_settled: bool
    mean_force_n: float | None = None
    mean_current_a: float | None = None
    battery_voltage_v: float | None = None
    battery_current_a: float | None = None

    @property
    def period_s(self) -> float:
        """Duration."""
        return self.end_s - self.start_s


@dataclass(slots=True)
class _Stream:
    """The latest samples of one channel."""

    time_s: Floats = field(default_factory=lambda: np.empty(0))
    values: Floats = field(default_factory=lambda: np.empty(0))
    next_index: int | None = None

    def append(self, block: SampleBlock, si_factor: float) -> bool:
        """Take a block; True where it continues the one before."""
        follows = self.next_index is None or block.first_index == self.next_index
        self.next_index = block.first_index + len(block.time_s)
        self.time_s = np.concatenate((self.time_s, block.time_s))
        self.values = np.concatenate((self.values, si_factor * block.values))
        return follows

    def forget(self, before_s: float) -> None:
        """Drop samples before a time, but keep the last of them to interpolate from."""
        first = max(int(np.searchsorted(self.time_s, before_s)) - 1, 0)
        self.time_s, self.values = self.time_s[first:], self.values[first:]

    def mean(self, start_s: float, end_s: float) -> float | None:
        """Time mean by trapezoids; None where the samples leave a hole."""
        if not len(self.time_s) or self.time_s[0] > start_s or self.time_s[-1] < end_s:
            return None
        first, last = np.searchsorted(self.time_s, (start_s, end_s))
        time_s = np.concatenate(((start_s,), self.time_s[first:last], (end_s,)))
        around = self.time_s[max(first - 1, 0) : last + 1]
        if np.diff(around).max(initial=0.0) > LONGEST_SILENCE * (end_s - start_s):
            return None
        ends = np.interp((start_s, end_s), self.time_s, self.values)
        values = np.concatenate((ends[:1], self.values[first:last], ends[1:]))
        return float(np.trapezoid(values, time_s) / (end_s - start_s))


class LiveStrokeSplitter:
    """Find the strokes in the stream and take the means over each.

    Levels at a quarter and three quarters of the travel of the last `window_s` seconds part the upper from the
    lower half, so noise around one level makes no strokes.

    Bias and failure cases: uneven speed around the dead centre shifts all dead centres alike (below 0.3 % of a
    stroke at 20 % speed ripple), which the period does not notice. A gap in the displacement ends the stroke
    that it falls into without a result. A stroke slower than `window_s` is not found. Values that are not
    finite count as missing in every channel.

    Parameters
    ----------
    window_s : float
        Must hold at least one stroke, s.
    min_travel_m : float
        Travel below which the blade counts as standing, m.

    Attributes
    ----------
    rest_force_n : float or None
        Mean force while the blade stood before the first stroke, to zero the load cell with.
    has_displacement : bool
        Whether any displacement has come.
    newest_s : float
        Time of the newest sample of any channel, s.

    Examples
    --------
    >>> time_s = np.arange(6000) / 6000
    >>> splitter = LiveStrokeSplitter()
    >>> force = SampleBlock(device="cell", channel="force_n", unit="N", first_index=0, time_s=time_s,
    ...                     values=np.full(6000, 50.0))
    >>> stroke = SampleBlock(device="lvdt", channel="displacement_mm", unit="mm", first_index=0, time_s=time_s,
    ...                      values=10.0 - 10.0 * np.cos(2 * np.pi * 12.5 * time_s))
    >>> strokes = [*splitter.update(force), *splitter.update(stroke)]
    >>> len(strokes), f"{strokes[-1].period_s:.4f} s, {strokes[-1].mean_force_n:.1f} N"
    (11, '0.0800 s, 50.0 N')
    """

    def __init__(self, *, window_s: float = 1.0, min_travel_m: float = 1e-3) -> None:
        if not (window_s > 0 and min_travel_m > 0):
            raise InputError(f"window_s {window_s!r} and min_travel_m {min_travel_m!r} must be greater than 0")
        self._window_s, self._min_travel_m = window_s, min_travel_m
        self._streams: dict[str, _Stream] = {name: _Stream() for name in (DISPLACEMENT.name, *MEANS)}
        self._extremes: deque[tuple[float, float, float]] = deque()
        self._rest_until_s: float | None = None
        self._rest_sum = 0.0
        self._rest_count = 0
        self._has_moved = False
        self._boundaries: deque[tuple[float, float]] = deque()
        self._previous_period_s: float | None = None
        self._is_settled = False
        self.has_displacement = False
        self.newest_s = 0.0
        self._lose_the_stroke()

    def _lose_the_stroke(self) -> None:
        self._last_centre_s: float | None = None
        self._fell_s: float | None = None
        self._is_high: bool | None = None

    @property
    def rest_force_n(self) -> float | None:
        """Mean force at rest, N; None without a rest."""
        return self._rest_sum / self._rest_count if self._rest_count else None

    def update(self, block: SampleBlock) -> list[LiveStroke]:
        """Take the next block of any channel and return the strokes that it completes.

        Parameters
        ----------
        block : SampleBlock
            Channels that a stroke does not need are ignored.
        """
        stream = self._streams.get(block.channel)
        if stream is None or not len(block.time_s):
            return []
        follows = stream.append(_finite(block), CHANNEL_BY_NAME[block.channel].si_factor)
        self.newest_s = max(self.newest_s, float(block.time_s[-1]))
        if block.channel == DISPLACEMENT.name:
            self.has_displacement = True
            if not follows:
                self._lose_the_stroke()
            self._find_centres(stream, float(block.time_s[0]))
        if not self._has_moved:
            self._add_rest()
        strokes = self._finished_strokes()
        keep_s = self._boundaries[0][0] if self._boundaries else self._oldest_needed_s()
        for each in self._streams.values():
            each.forget(keep_s)
        return strokes

    def _oldest_needed_s(self) -> float:
        """Nothing before the last dead centre, or the last window, is needed any more."""
        oldest_s = self.newest_s - 2.0 * self._window_s
        return oldest_s if self._last_centre_s is None else max(oldest_s, self._last_centre_s)

    def _find_centres(self, stream: _Stream, block_start_s: float) -> None:
        is_new = stream.time_s >= block_start_s
        fresh = stream.values[is_new]
        if not len(fresh):
            return
        self._extremes.append((float(stream.time_s[-1]), float(fresh.min()), float(fresh.max())))
        while self._extremes[0][0] < stream.time_s[-1] - self._window_s:
            self._extremes.popleft()
        low = min(entry[1] for entry in self._extremes)
        travel = max(entry[2] for entry in self._extremes) - low
        if travel < self._min_travel_m:
            if not self._has_moved:
                self._rest_until_s = block_start_s - REST_MARGIN_S
            self._lose_the_stroke()
            self._previous_period_s, self._is_settled = None, False
            return
        self._has_moved = True
        self._follow(stream, stream.time_s[is_new], fresh, low, travel)

    def _follow(self, stream: _Stream, time_s: Floats, fresh: Floats, low: float, travel: float) -> None:
        """Follow the blade between the upper and the lower quarter; each rise after a fall ends a stroke."""
        side = np.where(fresh > low + 0.75 * travel, 1, np.where(fresh < low + 0.25 * travel, -1, 0))
        told = np.flatnonzero(side)
        for at, now_high in zip(told, side[told] > 0, strict=True):
            if self._is_high == bool(now_high):
                continue
            turned_s = float(time_s[at])
            if not now_high:
                self._fell_s = turned_s
            elif self._is_high is not None and self._fell_s is not None:
                self._close_stroke(stream, self._fell_s, turned_s, travel)
            self._is_high = bool(now_high)

    def _close_stroke(self, stream: _Stream, fell_s: float, rose_s: float, travel: float) -> None:
        """Note the dead centre between a fall and the rise after it."""
        centre_s = _vertex(stream, fell_s, rose_s, travel)
        if centre_s is None:
            self._last_centre_s = None
            return
        if self._last_centre_s is not None:
            self._boundaries.append((self._last_centre_s, centre_s))
        self._last_centre_s = centre_s

    def _finished_strokes(self) -> list[LiveStroke]:
        """Strokes whose every channel has arrived, or is so late that it must be lost."""
        out: list[LiveStroke] = []
        while self._boundaries:
            start_s, end_s = self._boundaries[0]
            is_waited_for = [s for s in self._streams.values() if s.next_index is not None]
            if any(not len(s.time_s) or s.time_s[-1] < end_s for s in is_waited_for) and (
                self.newest_s < end_s + LATEST_S
            ):
                break
            self._boundaries.popleft()
            means = [self._streams[name].mean(start_s, end_s) for name in MEANS]
            out.append(
                LiveStroke(
                    start_s=start_s,
                    end_s=end_s,
                    is_settled=self._settle(end_s - start_s),
                    mean_force_n=means[0],
                    mean_current_a=means[1],
                    battery_voltage_v=means[2],
                    battery_current_a=means[3],
                )
            )
        return out

    def _settle(self, period_s: float) -> bool:
        before_s, self._previous_period_s = self._previous_period_s, period_s
        if before_s is None:
            return False
        limit = UNSETTLED if self._is_settled else SETTLED
        self._is_settled = abs(period_s / before_s - 1.0) < limit
        return self._is_settled

    def _add_rest(self) -> None:
        """Add the force of the rest that the displacement has confirmed."""
        if self._rest_until_s is None:
            return
        force = self._streams[FORCE.name]
        n_rest = int(np.searchsorted(force.time_s, self._rest_until_s))
        self._rest_sum += float(force.values[:n_rest].sum())
        self._rest_count += n_rest
        force.time_s, force.values = force.time_s[n_rest:], force.values[n_rest:]


def _finite(block: SampleBlock) -> SampleBlock:
    """Leave out values that are not finite; their place in the count stays."""
    is_finite = np.isfinite(block.values)
    if is_finite.all():
        return block
    return replace(block, time_s=block.time_s[is_finite], values=block.values[is_finite], raw=None)


def _vertex(stream: _Stream, fell_s: float, rose_s: float, travel: float) -> float | None:
    """Time of the minimum between two times; None where too few samples lie around it."""
    first, last = np.searchsorted(stream.time_s, (fell_s, rose_s))
    time_s, values = stream.time_s[first:last], stream.values[first:last]
    if len(values) < FEWEST_AT_DEAD_CENTRE:
        return None
    near = np.flatnonzero(values < np.partition(values, 2)[2] + NEAR_DEAD_CENTRE * travel)
    part = slice(int(near[0]), int(near[-1]) + 1)
    if part.stop - part.start < FEWEST_AT_DEAD_CENTRE:
        return None
    middle_s = 0.5 * (time_s[part][0] + time_s[part][-1])
    curvature, slope, _ = np.polyfit(time_s[part] - middle_s, values[part], 2)
    if not curvature > 0.0:
        return None
    centre_s = float(middle_s - 0.5 * slope / curvature)
    return centre_s if fell_s < centre_s < rose_s else None
