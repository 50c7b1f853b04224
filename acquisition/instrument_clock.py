"""Time stamps that an instrument sends with its samples -> times on the clock of this machine."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.clock import ArrivalClock

_STEP_S: Final = 1e-6
# A stamp that contradicts the arrival by more than this was damaged, or the instrument restarted.
_CONTRADICTION_S: Final = 2.5


class InstrumentClock:
    """Follow the clock of one instrument by its stamps.

    Parameters
    ----------
    tick_s : float
        Of the stamps, s.
    n_bits : int, optional
        After which the stamps begin at 0 again; None: never.

    Notes
    -----
    The stamps are tied to the arrivals as sample counts are, by `ArrivalClock`. A stamp that contradicts the time of
    its arrival by more than 2.5 s is left out; where the next one agrees with it the instrument restarted, and so
    does this clock.

    Examples
    --------
    >>> clock = InstrumentClock(tick_s=1e-6, n_bits=32)
    >>> times, is_used = clock.times(np.array([2**32 - 5000, 5000]), 7.0)
    >>> np.round(np.diff(times), 6).tolist(), is_used.tolist()
    ([0.01], [True, True])
    """

    def __init__(self, *, tick_s: float, n_bits: int | None = None) -> None:
        self._tick_s = tick_s
        self._n_bits = n_bits
        self._clock = _new_clock()
        self._elapsed_ticks = 0.0
        # Stamp and arrival of the last sample that was used, and of one that was left out behind it.
        self._last: tuple[float, float] | None = None
        self._left_out: tuple[float, float] | None = None

    def times(self, stamps: NDArray[np.float64], arrival_s: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Turn the stamps of samples that arrived together into times.

        Parameters
        ----------
        stamps : ndarray, shape (n,), ticks
        arrival_s : float
            Monotonic clock, s.

        Returns
        -------
        time_s : ndarray, shape (k,), s
            Monotonic clock.
        is_used : ndarray of bool, shape (n,)
            k of them true; the others have a stamp that cannot be.
        """
        is_used = np.zeros(len(stamps), dtype=bool)
        index: list[int] = []
        for k, stamp in enumerate(stamps):
            step, is_new = self._step_to(float(stamp), arrival_s)
            if is_new:
                # What came before in the same read is left out.
                self._clock = _new_clock()
                is_used[:k] = False
                index.clear()
            if step is not None:
                is_used[k] = True
                self._elapsed_ticks += step
                index.append(round(self._elapsed_ticks * self._tick_s / _STEP_S))
        if index:
            self._clock.observe(index[-1], arrival_s)
        return np.array([self._clock.stamp(n, 1)[0] for n in index]), is_used

    def _step_to(self, stamp: float, arrival_s: float) -> tuple[float | None, bool]:
        """Ticks from the last stamp to this one, None where it cannot be; and whether the instrument restarted."""
        step = 0.0 if self._last is None else self._step(self._last, stamp, arrival_s)
        is_new = step is None and self._left_out is not None and bool(self._step(self._left_out, stamp, arrival_s))
        if step is None and not is_new:
            self._left_out = (stamp, arrival_s)
            return None, False
        self._last, self._left_out = (stamp, arrival_s), None
        return (0.0 if is_new else step), is_new

    def _step(self, before: tuple[float, float], stamp: float, arrival_s: float) -> float | None:
        """Ticks since `before`; None where they contradict the arrival, or no time has passed."""
        ticks = stamp - before[0]
        if self._n_bits is not None:
            ticks %= 1 << self._n_bits
        passed_s = arrival_s - before[1]
        is_possible = ticks * self._tick_s > _STEP_S / 2 and abs(ticks * self._tick_s - passed_s) <= _CONTRADICTION_S
        return ticks if is_possible else None


def _new_clock() -> ArrivalClock:
    # Stamps are few: a slope beyond that of a quartz would be the scatter of their latencies.
    return ArrivalClock(rate_hz=1.0 / _STEP_S, can_be_rounded=False)
