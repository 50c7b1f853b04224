"""The live view's side door: whatever happens behind it, the recording does not wait."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable
from typing import Final

from sawbench.bench.recording import Event, SampleBlock

Observer = Callable[[SampleBlock | Event], object]
_CAPACITY: Final = 2000
_LAST_WAIT_S: Final = 1.0


class ObserverFeed:
    """Hand blocks and events to observers on a thread of their own.

    Parameters
    ----------
    observers : iterable of callable
        Each is called with every block and event. One that raises is removed; one that hangs stops the feed,
        not the recording.
    capacity : int
        Items that may wait; further ones are dropped and counted.
    """

    def __init__(self, observers: Iterable[Observer], *, capacity: int = _CAPACITY) -> None:
        self._observers = list(observers)
        self._queue: queue.Queue[SampleBlock | Event | None] = queue.Queue(capacity)
        self._failures: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self.n_dropped = 0
        if self._observers:
            self._thread = threading.Thread(target=self._run, name="observers", daemon=True)
            self._thread.start()

    def offer(self, item: SampleBlock | Event) -> None:
        """Pass `item` on if there is room; never blocks."""
        if self._thread is None or not self._thread.is_alive():
            return
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            self.n_dropped += 1

    def failures(self) -> list[str]:
        """Return what went wrong in observers since the last call."""
        out = []
        while not self._failures.empty():
            out.append(self._failures.get())
        return out

    def close(self) -> None:
        """Let observers finish what waits, for at most a second."""
        if self._thread is None:
            return
        try:
            self._queue.put(None, timeout=_LAST_WAIT_S)
        except queue.Full:
            # The observer hangs; its thread is a daemon and ends with the process.
            return
        self._thread.join(_LAST_WAIT_S)

    def _run(self) -> None:
        while self._observers:
            item = self._queue.get()
            if item is None:
                return
            for observer in list(self._observers):
                try:
                    observer(item)
                except Exception as error:
                    self._observers.remove(observer)
                    self._failures.put(f"live view stopped: {type(error).__name__}: {error}")
