"""Rows of numbers, as lines and frames give them -> chunks, by whatever tells their time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.devices.device import Chunk
from sawbench.acquisition.instrument_clock import InstrumentClock
from sawbench.acquisition.sample_counter import CountedStream

ARRIVAL = "sample count and arrival of the bytes at this machine"
OWN_CLOCK = "time stamps of the instrument, tied to the arrival of the bytes at this machine"


@dataclass(frozen=True, kw_only=True, slots=True)
class RowTiming:
    """What tells the time of the rows.

    Attributes
    ----------
    rate_hz : float
        Samples per second; 0 where they carry a stamp, or answer a question.
    tick_s : float, optional
        The number behind the channels is a time stamp in steps of this, s.
    tick_bits : int, optional
        After which the stamps begin at 0 again.
    counter_bits : int, optional
        The number behind the channels counts the samples.
    """

    rate_hz: float = 0.0
    tick_s: float | None = None
    tick_bits: int | None = None
    counter_bits: int | None = None

    @property
    def words(self) -> str:
        """Where the times come from."""
        return ARRIVAL if self.tick_s is None else OWN_CLOCK


class RowStream:
    """One stream."""

    def __init__(self, stream: str, timing: RowTiming) -> None:
        self._stream = stream
        self._clock = None if timing.tick_s is None else InstrumentClock(tick_s=timing.tick_s, n_bits=timing.tick_bits)
        self._counted = (
            None
            if timing.counter_bits is None
            else CountedStream(stream, modulus=1 << timing.counter_bits, rate_hz=timing.rate_hz)
        )
        self._n_lost = 0

    def chunks(self, rows: NDArray[np.float64], n_lost: int, arrival_s: float) -> list[Chunk]:
        """Return the chunks of rows that came without a break, `n_lost` broken ones before them.

        Parameters
        ----------
        rows : ndarray, shape (n, n_channels) or (n, n_channels + 1)
            The last column is the stamp or the counter, where there is one.
        n_lost : int
        arrival_s : float
            Monotonic clock, s.
        """
        arrival = np.array([arrival_s])
        if self._counted is not None:
            return self._counted.chunks(rows[:, :-1], rows[:, -1], np.repeat(arrival, len(rows)))
        if self._clock is not None:
            time_s, is_used = self._clock.times(rows[:, -1], arrival_s)
            raw = rows[is_used, :-1]
            # A stamp that cannot be is a row without a time: as good as lost.
            n_lost, self._n_lost = self._n_lost + n_lost + int((~is_used).sum()), 0
            if not len(raw):
                self._n_lost = n_lost
                return []
            return [
                Chunk(
                    stream=self._stream, raw=raw, arrival_s=arrival, time_s=time_s, n_lost=n_lost, is_loss_exact=False
                )
            ]
        return [Chunk(stream=self._stream, raw=rows, arrival_s=arrival, n_lost=n_lost, is_loss_exact=n_lost == 0)]
