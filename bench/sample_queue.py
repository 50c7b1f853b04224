"""What waits for a slower reader: bounded by its samples, and so by its memory."""

from __future__ import annotations

import queue
import threading
from typing import Final, Generic, TypeVar

from sawbench.bench.recording import SampleBlock

MOST_SAMPLES: Final = 1_000_000
"""25 s of four channels at 10 kHz, about 24 MB."""
# Whatever waits takes as much memory as so many samples, beside its own.
_SAMPLES_AN_ITEM: Final = 100

Item = TypeVar("Item")


class SampleQueue(Generic[Item]):
    """Hand items to one other thread without ever waiting for it; what does not fit is dropped and counted.

    Parameters
    ----------
    most_samples : int
        From so many waiting samples on, further items are dropped; each item counts as a hundred more than it holds.

    Attributes
    ----------
    n_dropped : int

    Examples
    --------
    >>> waiting: SampleQueue[str] = SampleQueue(most_samples=200)
    >>> [waiting.put(text) for text in ("a", "b", "c")], waiting.n_dropped
    ([True, True, False], 1)
    >>> waiting.end()
    >>> waiting.get(), waiting.get(), waiting.get()
    ('a', 'b', None)
    """

    def __init__(self, most_samples: int = MOST_SAMPLES) -> None:
        self.n_dropped = 0
        self._most = most_samples
        self._items: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._n_put = 0
        self._n_taken = 0

    def put(self, item: Item) -> bool:
        """Append `item`; False where it was dropped."""
        with self._lock:
            if self._n_put - self._n_taken >= self._most:
                self.n_dropped += 1
                return False
            self._n_put += _size(item)
        self._items.put(item)
        return True

    def end(self) -> None:
        """Say that nothing follows."""
        self._items.put(None)

    def get(self, timeout_s: float | None = None) -> Item | None:
        """Take the next item, None after `end`.

        Parameters
        ----------
        timeout_s : float, optional
            How long to wait for one, s; without it for ever.

        Raises
        ------
        queue.Empty
            If none came in time.
        """
        item = self._items.get(timeout=timeout_s)
        if item is not None:
            self._n_taken += _size(item)
        return item


def _size(item: object) -> int:
    return _SAMPLES_AN_ITEM + (len(item.time_s) if isinstance(item, SampleBlock) else 0)
