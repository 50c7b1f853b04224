"""The common clock: sample counts and arrival times of one instrument -> times on the clock of this machine.

An instrument samples by its own quartz, t = t0 + n * period. This machine sees sample n at a_n = t_n +
latency, and latency is one-sided: bytes can be late, never early. So the line that touches the arrivals from
below is the instrument's clock, up to the smallest latency, which no receiver can see.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

_WINDOW_S: Final = 30.0
_SLOT_S: Final = 0.1
# The line is fitted with every slot until it is this long, then with every fifth: a quartz does not change so fast.
_EVERY_SLOT_S: Final = 5.0
_FIT_SLOTS: Final = 5
# Slots whose least late arrival lies further above the line than this were late as a whole and bound nothing.
_LATE_SLOT_S: Final = 0.003
LATE_SAMPLES: Final = 3
# Share of the slots in time by which a line describes them.
_MOST: Final = 0.75
# Smallest latency of a link is not repeatable to better than this, however little the slots scatter.
LATENCY_STD_S: Final = 1e-4
# Latency of a USB link that is the same for every sample, at most: full-speed devices are asked once a millisecond.
LINK_LATENCY_S: Final = 1e-3
# Standard deviation of the quartz of an instrument; a rate further off than this explains was rounded by it.
_QUARTZ_STD: Final = 5e-5
_ROUNDED_SIGMAS: Final = 5.0
_STEADY_SIGMAS: Final = 3.0
_SLEW_TIME_S: Final = 1.0
_USUAL_SLEW: Final = 0.01
_LARGE_ERROR_S: Final = 0.001
LARGEST_SLEW: Final = 0.1
# Time in which what is left of a large error fades.
SLEW_SETTLED_S: Final = 2.0
# Quartz errors are below 1e-4; a data rate that the instrument rounded can be off by a few percent.
_LARGEST_RATE_ERROR: Final = 0.03
# Over less than this a link that falls back into time, or out of it, looks like a rate that was rounded.
LATE_LINK_S: Final = 2.1


@dataclass(frozen=True, kw_only=True, slots=True)
class ClockLine:
    """t = `offset_s` + n * `period_s`."""

    offset_s: float
    period_s: float

    def time_of(self, index: float) -> float:
        """Time of sample `index`, s."""
        return self.offset_s + index * self.period_s


class ArrivalClock:
    """Estimate of one instrument's clock from arrivals; causal, never going backwards.

    Parameters
    ----------
    rate_hz : float
        Nominal sample rate.
    window_s : float
        Arrivals older than this are forgotten, so that drift is followed.
    can_be_rounded : bool
        The instrument may have rounded its rate, so that a slope far beyond a quartz is believed.

    Notes
    -----
    Every arrival is the latest possible time of its sample. Estimator: the edge of the lower convex hull of
    (sample index, arrival) under the mean index, the least total latency among all lines below the arrivals
    (Moon, Skelly, Towsley 1999, "Estimation and removal of clock skew from network delay measurements"), without
    stretches in which every arrival was late. The slope is weighed against a quartz of 50 ppm, unless it lies far
    outside: then the instrument rounded its rate. Bias: late by the smallest latency of the link (USB: up to 1 ms;
    not observable). Fails where every arrival of the window is late by a growing amount, which looks like a slow
    clock.

    Examples
    --------
    >>> clock = ArrivalClock(rate_hz=1000.0)
    >>> for index in range(0, 1000, 10):
    ...     clock.observe(index, 5.0 + index * 1e-3)
    >>> t0, period = clock.stamp(1000, 10)
    >>> round(t0, 6), round(period, 9)
    (6.0, 0.001)
    """

    def __init__(self, *, rate_hz: float, window_s: float = _WINDOW_S, can_be_rounded: bool = True) -> None:
        if not rate_hz > 0:
            raise ValueError(f"rate_hz must be greater than 0, got {rate_hz!r}")
        self._nominal_period_s = 1.0 / rate_hz
        self._can_be_rounded = can_be_rounded
        self._n_slots = max(4, round(window_s / _SLOT_S))
        self._lowest: deque[tuple[int, float]] = deque(maxlen=self._n_slots)
        self._slot = -1
        self._origin: tuple[int, float] | None = None
        self._line: ClockLine | None = None
        self._last: tuple[int, float] | None = None
        self._spread_s = 0.0
        self._learnt: tuple[float, float] = (0.0, 0.0)
        self._hull_slope = 0.0
        self._n_observed = 0

    @property
    def span_s(self) -> float:
        """Time between the first and the last arrival it still remembers, s."""
        return (self._lowest[-1][0] - self._lowest[0][0]) * self._nominal_period_s if self._lowest else 0.0

    @property
    def is_steady(self) -> bool:
        """Whether one rate explains the remembered arrivals: a quartz's, or over 2.1 s a rounded one.

        Samples that gathered while this machine was busy come faster than they were taken.
        """
        if self.span_s <= 0:
            return False
        index, arrival_s = np.array(self._lowest, dtype=np.float64).T
        period_s = _hull_slope_below_mean(index, arrival_s - arrival_s[0])
        above_s = arrival_s - period_s * index
        in_time = above_s <= above_s.min() + max(_LATE_SLOT_S, LATE_SAMPLES * self._nominal_period_s)
        off_stds = abs(period_s / self._nominal_period_s - 1.0) / _rate_std(self.span_s, _spread_s(above_s))
        return bool(np.mean(in_time) >= _MOST) and (off_stds < _STEADY_SIGMAS or self.span_s >= LATE_LINK_S)

    @property
    def line(self) -> ClockLine:
        """The present estimate.

        Raises
        ------
        ValueError
            If nothing was observed yet.
        """
        if self._line is None:
            if not self._lowest:
                raise ValueError("no arrival observed yet")
            self._line = self._fit(None)
        return self._line

    @property
    def uncertainty_s(self) -> float:
        """Standard uncertainty of the alignment from the scatter of the smallest latencies, s."""
        if not self._lowest:
            return float("inf")
        _ = self.line
        return max(self._spread_s, 0.25 * self._nominal_period_s)

    def observe(self, index: int, arrival_s: float) -> None:
        """Note that sample `index` had arrived by `arrival_s`.

        Parameters
        ----------
        index : int
            Of the newest sample of a read.
        arrival_s : float
            Monotonic clock of this machine, s.
        """
        if self._origin is None:
            self._origin = (index, arrival_s)
        self._n_observed += 1
        slot = int((index - self._origin[0]) * self._nominal_period_s / _SLOT_S)
        if slot != self._slot:
            self._slot = slot
            self._lowest.append((index, arrival_s))
            is_below = self._line is not None and arrival_s < self._line.time_of(index)
            if is_below or slot % _FIT_SLOTS == 0 or self.span_s < _EVERY_SLOT_S:
                self._line = self._fit(self._line)
        elif self._lateness(index, arrival_s) < self._lateness(*self._lowest[-1]):
            self._lowest[-1] = (index, arrival_s)
            # A line that lies above an arrival is wrong; one that lies below can wait for the next slot.
            if self._line is not None and arrival_s < self._line.time_of(index):
                self._line = self._fit(self._line)

    def of_latest(self, span_s: float) -> ArrivalClock:
        """Return the clock by what came in the latest `span_s` alone, that too which was late by an earlier line."""
        clock = ArrivalClock(rate_hz=1.0 / self._nominal_period_s, can_be_rounded=self._can_be_rounded)
        # The least late arrivals of two slots are up to two slots apart.
        first = self._lowest[-1][0] - (span_s + 2.0 * _SLOT_S) / self._nominal_period_s
        clock._lowest.extend((index, arrival_s) for index, arrival_s in self._lowest if index > first)
        clock._origin, clock._slot, clock._n_observed = self._origin, self._slot, self._n_observed
        clock._line = clock._fit(None)
        return clock

    def residual_s(self, index: int, arrival_s: float) -> float:
        """How much later than the estimate sample `index` arrived, s."""
        return arrival_s - self.line.time_of(index)

    def least_late_s(self, line: ClockLine) -> float:
        """Lateness of the least late of the remembered arrivals by `line`, s."""
        return min(arrival_s - line.time_of(index) for index, arrival_s in self._lowest)

    def stamp(self, first_index: int, n_samples: int) -> tuple[float, float]:
        """Give `n_samples` samples their times; later calls never go back.

        Returns
        -------
        first_time_s, period_s : float
            Time of the first sample (s, monotonic clock) and spacing of the block.
        """
        line = self.line
        end_index = first_index + n_samples
        if self._last is None:
            self._last = (end_index, line.time_of(end_index))
            return line.time_of(first_index), line.period_s
        last_index, last_time_s = self._last
        n_steps = end_index - last_index
        if n_steps <= 0:
            raise ValueError(f"sample {first_index} was stamped before (next is {last_index})")
        error_s = line.time_of(end_index) - (last_time_s + n_steps * line.period_s)
        share = min(1.0, n_steps * line.period_s / _SLEW_TIME_S)
        wanted = error_s * share / (n_steps * line.period_s)
        limit = _USUAL_SLEW
        if abs(error_s) > _LARGE_ERROR_S:
            wanted, limit = error_s / (n_steps * line.period_s), LARGEST_SLEW
        period_s = line.period_s * (1.0 + min(max(wanted, -limit), limit))
        first_time_s = last_time_s + (first_index - last_index) * period_s
        self._last = (end_index, last_time_s + n_steps * period_s)
        return first_time_s, period_s

    def renumber(self, from_index: int, shift: int) -> None:
        """Move what was observed and stamped from sample `from_index` on by `shift`: they were counted wrongly."""
        self._lowest = deque(
            ((n + shift if n >= from_index else n, t) for n, t in self._lowest), maxlen=self._lowest.maxlen
        )
        if self._last is not None and self._last[0] >= from_index:
            self._last = (self._last[0] + shift, self._last[1])
        self._slot += int(shift * self._nominal_period_s / _SLOT_S)

    def measured_rate_hz(self) -> float:
        """Return samples per second by the earliest of the remembered arrivals (0 if too few).

        On a busy machine the first samples may come late, all at once: they are no faster instrument.
        """
        if len(self._lowest) < 2:
            return 0.0
        index, arrival_s = np.array(self._lowest, dtype=np.float64).T
        period_s = _hull_slope_below_mean(index - index[0], arrival_s - arrival_s[0])
        return 1.0 / period_s if period_s > 0 else 0.0

    def drift_ppm(self) -> tuple[float, float] | None:
        """Rate of the instrument's quartz against nominal, by this machine's clock, 1e-6, and its standard uncertainty.

        Returns
        -------
        tuple of float or None
            None while fewer than ten slots (about 1 s) were seen. Unlike the slope that makes the times, it is not
            drawn to the nominal rate; the uncertainty is the scatter of the smallest latencies over the span.
        """
        if len(self._lowest) < 10 or self.span_s <= 0:
            return None
        relative = self._hull_slope / self._nominal_period_s
        return -relative * 1e6, 2**0.5 * self.uncertainty_s / self.span_s * 1e6

    def statement(self) -> str:
        """Say in words how the times were made and how sure they are."""
        line = self.line
        drift_ppm = (self._nominal_period_s / line.period_s - 1.0) * 1e6
        return (
            f"sample count against arrival at this machine, lower envelope over {self.span_s:.1f} s "
            f"({self._n_observed} reads); "
            f"rate {1.0 / line.period_s:.4f} Hz ({drift_ppm:+.0f} ppm of nominal); "
            f"alignment +/- {self.uncertainty_s * 1e3:.2f} ms (1 std), plus the constant latency of the "
            f"link, which a receiver cannot see (USB: up to {LINK_LATENCY_S * 1e3:g} ms)"
        )

    def _lateness(self, index: int, arrival_s: float) -> float:
        assert self._origin is not None
        return (arrival_s - self._origin[1]) - (index - self._origin[0]) * self._nominal_period_s

    def _fit(self, former: ClockLine | None) -> ClockLine:
        """Line below the arrivals; `former` tells which slots were late as a whole."""
        assert self._origin is not None
        n0, t0 = self._origin
        lowest = np.array(self._lowest, dtype=np.float64)
        index = lowest[:, 0] - n0
        late_s = lowest[:, 1] - t0 - index * self._nominal_period_s
        if former is not None:
            above_s = late_s - (former.period_s - self._nominal_period_s) * index
            in_time = above_s <= above_s.min() + _LATE_SLOT_S
            index, late_s = index[in_time], late_s[in_time]
        slope = self._slope(index, late_s)
        above_s = late_s - slope * index
        floor_s = float(above_s.min())
        self._spread_s = _spread_s(above_s)
        period_s = self._nominal_period_s + slope
        return ClockLine(offset_s=float(t0 + floor_s - n0 * period_s), period_s=float(period_s))

    def _slope(self, index: NDArray[np.float64], late_s: NDArray[np.float64]) -> float:
        """Deviation of the period from nominal, s a sample."""
        span_s = (index[-1] - index[0]) * self._nominal_period_s
        learnt, learnt_span_s = self._learnt
        if span_s < 0.5 * learnt_span_s:
            return learnt
        if span_s <= 0:
            return 0.0
        limit = _LARGEST_RATE_ERROR * self._nominal_period_s
        slope = float(np.clip(_hull_slope_below_mean(index, late_s), -limit, limit))
        self._hull_slope = slope
        std = _rate_std(span_s, _spread_s(late_s - slope * index))
        is_quartz = abs(slope) < _ROUNDED_SIGMAS * std * self._nominal_period_s
        if is_quartz or span_s < LATE_LINK_S or not self._can_be_rounded:
            slope *= (_QUARTZ_STD / std) ** 2
        self._learnt = (slope, span_s)
        return slope


def _rate_std(span_s: float, spread_s: float) -> float:
    """Relative standard deviation of the rate of a quartz as seen over `span_s`."""
    return (_QUARTZ_STD**2 + 2.0 * (max(spread_s, LATENCY_STD_S) / span_s) ** 2) ** 0.5


def _spread_s(above_s: NDArray[np.float64]) -> float:
    """How repeatable the smallest latency is, s: by the lower half of the slots."""
    lower_half_s = np.sort(above_s)[: max(2, len(above_s) // 2)]
    return float(np.sqrt(np.mean((lower_half_s - lower_half_s[0]) ** 2)))


def _hull_slope_below_mean(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Slope of the edge of the lower convex hull of (x, y) that lies under the mean of x; x increases."""
    middle = float(np.mean(x))
    a, b = 0, len(x) - 1
    while True:
        slope = float((y[b] - y[a]) / (x[b] - x[a]))
        # The point furthest below the line through two points of the hull is one of the hull too.
        below = y - slope * x
        lowest = int(np.argmin(below))
        if lowest in {a, b} or below[lowest] >= min(below[a], below[b]):
            return slope
        a, b = (lowest, b) if x[lowest] < middle else (a, lowest)
