"""Whether this computer keeps up: a thread that wants to wake up ten times a second, and how late it does."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final

_EVERY_S: Final = 0.1
_REMEMBERS_S: Final = 4.0
# Later than this, what an instrument sent waits longer than its buffers may hold it.
TOO_LATE_S: Final = 0.25


class BusyWatch:
    """Measure how long this program waits for its turn.

    A recorder that gets no processor time sees late samples and silent instruments; only this tells whose fault it is.

    Parameters
    ----------
    clock, sleep : callable
        Monotonic seconds, and a wait.
    """

    def __init__(
        self, *, clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], object] = time.sleep
    ) -> None:
        self._clock = clock
        self._sleep = sleep
        self._late: deque[tuple[float, float]] = deque()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="busy watch", daemon=True)

    def start(self) -> None:
        """Begin to watch, in a thread of its own."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stopping.set()

    def look(self) -> None:
        """Wait once, and note how much longer it took."""
        begun_s = self._clock()
        self._sleep(_EVERY_S)
        now_s = self._clock()
        self._late.append((now_s, now_s - begun_s - _EVERY_S))
        while self._late and self._late[0][0] < now_s - _REMEMBERS_S:
            self._late.popleft()

    @property
    def late_s(self) -> float:
        """Longest wait for a turn in the last 4 s, s."""
        return max((late_s for _, late_s in list(self._late)), default=0.0)

    def words(self) -> str:
        """Say that this computer is too busy; empty where it is not."""
        late_s = self.late_s
        if late_s < TOO_LATE_S:
            return ""
        return f"this computer is too busy: the recorder waited {late_s:.1f} s for its turn; end other programs"

    def _run(self) -> None:
        while not self._stopping.is_set():
            self.look()
