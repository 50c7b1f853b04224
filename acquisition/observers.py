"""The live view's side door: whatever happens behind it, the recording does not wait."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable
from typing import Final

from sawbench.bench.recording import Event, SampleBlock
from sawbench.bench.sample_queue import MOST_SAMPLES, SampleQueue

Observer = Callable[[SampleBlock | Event], object]
_LAST_WAIT_S: Final = 1.0


class ObserverFeed:
    """Hand blocks and events to observers on a thread of their own.

    Parameters
    ----------
    observers : iterable of callable
        Each is called with every block and event. One that raises is removed; one that hangs stops the feed,
        not the recording.
    most_samples : int
        See `SampleQueue`.
    """

    def __init__(self, observers: Iterable[Observer], *, most_samples: int = MOST_SAMPLES) -> None:
        self._observers = list(observers)
        self._waiting: SampleQueue[SampleBlock | Event] = SampleQueue(most_samples)
        self._failures: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        if self._observers:
            self._thread = threading.Thread(target=self._run, name="observers", daemon=True)
            self._thread.start()

    @property
    def n_dropped(self) -> int:
        """Items for which there was no room."""
        return self._waiting.n_dropped

    def offer(self, item: SampleBlock | Event) -> None:
        """Pass `item` on if there is room; never blocks."""
        if self._thread is not None and self._thread.is_alive():
            self._waiting.put(item)

    def failures(self) -> list[str]:
        """Return what went wrong in observers since the last call."""
        out = []
        while not self._failures.empty():
            out.append(self._failures.get())
        return out

    def close(self) -> None:
        """Let observers finish what waits, for at most a second."""
        self._waiting.end()
        if self._thread is not None:
            # Where an observer hangs, its thread is a daemon and ends with the process.
            self._thread.join(_LAST_WAIT_S)

    def _run(self) -> None:
        while self._observers and (item := self._waiting.get()) is not None:
            for observer in list(self._observers):
                try:
                    observer(item)
                except Exception as error:
                    self._observers.remove(observer)
                    self._failures.put(f"live view stopped: {type(error).__name__}: {error}")
