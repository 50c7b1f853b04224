"""The counter that some instruments send with each sample: how many were lost, and when the counter itself is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.devices.device import Chunk

# The sample before a jump may have arrived late by this much, so that more were sent in between than the arrivals tell.
_LATENESS_S: Final = 2.5
_RATE_TOLERANCE: Final = 1.03
# Numbers are exact up to here; no counter gets beyond it by itself.
_LARGEST_MODULUS: Final = 1 << 53
# So many samples whose counter did not go on are no accident.
_MANY_UNCOUNTED: Final = 10


@dataclass(frozen=True, kw_only=True, slots=True)
class Counted:
    """What the counter says about the frames of one batch.

    Attributes
    ----------
    n_ready : int
        Frames that are judged; one whose counter jumps waits for the frame behind it, which tells why.
    keep : ndarray of bool, shape (n_ready,)
        False for a frame sent twice.
    n_lost : ndarray of int, shape (n_ready,)
        Samples lost before each frame.
    is_exact : ndarray of bool, shape (n_ready,)
        False where the counter restarted or contradicts the time of arrival: then only the time tells the loss.
    """

    n_ready: int
    keep: NDArray[np.bool_]
    n_lost: NDArray[np.int64]
    is_exact: NDArray[np.bool_]


class SampleCounter:
    """Follow one counter.

    Parameters
    ----------
    modulus : int
        After so many counts it begins at 0 again.
    rate_hz : float
        Of the samples; bounds how many can have been lost between two arrivals.

    Attributes
    ----------
    n_uncounted : int
        Samples that were kept although their count was that of the one before.

    Examples
    --------
    >>> counter = SampleCounter(modulus=256, rate_hz=1000.0)
    >>> counter.take(np.array([254, 255, 0, 3, 4]), np.arange(5) * 1e-3).n_lost
    array([0, 0, 0, 2, 0])
    >>> counter.take(np.array([5, 6 ^ 0x40, 7, 8]), np.arange(5, 9) * 1e-3).n_lost
    array([0, 0, 0, 0])
    """

    def __init__(self, *, modulus: int, rate_hz: float) -> None:
        self._modulus = modulus
        self._rate_hz = rate_hz
        self._last: tuple[int, float] | None = None
        # Whether an equal count means the same sample: not before it has counted, nor once another sample had it too.
        self._is_counting = False
        self.n_uncounted = 0

    def take(
        self, counts: NDArray[np.int64], arrival_s: NDArray[np.float64], is_same: NDArray[np.bool_] | None = None
    ) -> Counted:
        """Judge a batch of at least one frame; those beyond `n_ready` have to be given again, before the next ones.

        Parameters
        ----------
        counts : ndarray of int, shape (n,)
        arrival_s : ndarray, shape (n,), s
        is_same : ndarray of bool, shape (n,), optional
            Whether a frame holds the same values as the one before; by default all do.
        """
        n = len(counts)
        keep, n_lost, is_exact = np.ones(n, dtype=bool), np.zeros(n, dtype=np.int64), np.ones(n, dtype=bool)
        is_first = self._last is None
        if self._last is None:
            self._last = (int(counts[0]) - 1, float(arrival_s[0]))
        expected = (self._last[0] + 1 + np.arange(n)) % self._modulus
        if np.array_equal(counts, expected):
            self._last = (int(counts[-1]), float(arrival_s[-1]))
            self._is_counting |= n > 1 or not is_first
            return Counted(n_ready=n, keep=keep, n_lost=n_lost, is_exact=is_exact)
        last, last_s = self._last
        for k in range(n):
            count, at_s = int(counts[k]), float(arrival_s[k])
            step = (count - last) % self._modulus
            if step != 1:
                if k + 1 == n:
                    self._last = (last, last_s)
                    return Counted(n_ready=k, keep=keep[:k], n_lost=n_lost[:k], is_exact=is_exact[:k])
                if step == 0 and is_same is not None and not is_same[k]:
                    self._is_counting = False
                count, keep[k], n_lost[k], is_exact[k] = self._judge(last, count, int(counts[k + 1]), at_s - last_s)
            elif k or not is_first:
                self._is_counting = True
            last, last_s = count, at_s
        self._last = (last, last_s)
        return Counted(n_ready=n, keep=keep, n_lost=n_lost, is_exact=is_exact)

    def _judge(self, last: int, count: int, following: int, elapsed_s: float) -> tuple[int, bool, int, bool]:
        """Count as it should be, whether to keep the frame, samples lost before it, and whether that is certain."""
        expected = (last + 1) % self._modulus
        if (following - last) % self._modulus == 2:
            # The frames around it follow each other: a bit of this counter was flipped on the way.
            return expected, True, 0, True
        if count == last % self._modulus:
            self.n_uncounted += not self._is_counting
            return count, not self._is_counting, 0, True
        if (following - count) % self._modulus > 2:
            # It fits neither side.
            return expected, True, 0, False
        n_lost = (count - last) % self._modulus - 1
        most = _RATE_TOLERANCE * self._rate_hz * (max(0.0, elapsed_s) + _LATENESS_S)
        is_possible = n_lost <= min(most, 0.5 * self._modulus)
        return (count, True, n_lost, True) if is_possible else (count, True, 0, False)


class CountedStream:
    """Samples that carry a counter -> chunks with what was lost between them.

    Parameters
    ----------
    stream : str
        Name in the chunks.
    modulus : int
        After so many counts the counter begins at 0 again.
    rate_hz : float

    Examples
    --------
    >>> stream = CountedStream("frames", modulus=256, rate_hz=1000.0)
    >>> chunks = stream.chunks(np.zeros((3, 1)), np.array([254.0, 255.0, 3.0]), np.array([0.0, 0.001, 0.005]))
    >>> chunks += stream.chunks(np.zeros((1, 1)), np.array([4.0]), np.array([0.006]))
    >>> [(len(chunk.raw), chunk.n_lost) for chunk in chunks]
    [(2, 0), (2, 3)]
    """

    def __init__(self, stream: str, *, modulus: int, rate_hz: float) -> None:
        self._stream = stream
        self._modulus = min(modulus, _LARGEST_MODULUS)
        self._counter = SampleCounter(modulus=self._modulus, rate_hz=rate_hz)
        self._latest: NDArray[np.float64] | None = None
        self._is_warned = False
        # Samples whose counter jumps, until the next one tells why.
        self._waiting: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None = None

    def chunks(
        self, raw: NDArray[np.float64], counts: NDArray[np.float64], arrival_s: NDArray[np.float64]
    ) -> list[Chunk]:
        """Return what is certain.

        Parameters
        ----------
        raw : ndarray, shape (n, n_channels)
        counts : ndarray, shape (n,)
        arrival_s : ndarray, shape (n,), s
        """
        counts = counts % self._modulus
        if self._waiting is not None:
            before, counts_before, before_s = self._waiting
            raw, counts = np.concatenate((before, raw)), np.concatenate((counts_before, counts))
            arrival_s = np.concatenate((before_s, arrival_s))
            self._waiting = None
        before = raw[:1] if self._latest is None else self._latest
        before = np.concatenate((before, raw[:-1]))
        is_same = np.all((raw == before) | (np.isnan(raw) & np.isnan(before)), axis=1)
        counted = self._counter.take(counts.astype(np.int64), arrival_s, is_same)
        n = counted.n_ready
        if n < len(raw):
            self._waiting = raw[n:], counts[n:], arrival_s[n:]
        if n:
            self._latest = raw[n - 1 : n]
        kept = np.flatnonzero(counted.keep)
        raw, arrival_s = raw[kept], arrival_s[kept]
        n_lost, is_exact = counted.n_lost[kept], counted.is_exact[kept]
        starts = np.flatnonzero((n_lost > 0) | ~is_exact)
        edges = sorted({0, *starts.tolist(), len(raw)}) if len(raw) else []
        return [
            Chunk(
                stream=self._stream,
                raw=raw[a:b],
                arrival_s=arrival_s[a:b],
                n_lost=int(n_lost[a]),
                is_loss_exact=bool(is_exact[a]),
                warning=self._warning() if a == 0 else "",
            )
            for a, b in pairwise(edges)
        ]

    def _warning(self) -> str:
        """Say once that the counter does not count."""
        if self._is_warned or self._counter.n_uncounted < _MANY_UNCOUNTED:
            return ""
        self._is_warned = True
        return (
            f"{self._stream}: the sample counter stands still while samples go on; losses are found by the time of"
            " arrival alone: choose another counter, or none"
        )
