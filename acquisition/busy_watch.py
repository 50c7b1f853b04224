"""Whether this computer keeps up: a thread that wants to wake up ten times a second, and how late it does."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final

_EVERY_S: Final = 0.1
_REMEMBERS_S: Final = 4.0
# Later than this, what an instrument sent waits longer than its buffers may hold it.
TOO_LATE_S: Final = 0.25
# Programs that want each processor at a time, from which on a program beside the recorder gets too little of one.
_TOO_MANY: Final = 4.0


class BusyWatch:
    """Measure how long this program waits for its turn.

    A recorder that gets no processor time sees late samples and silent instruments; only this tells whose fault it is.
    So does one that is served in time itself while an instrument that another program is, as of the simulated bench,
    waits: the number of programs that want a processor tells of that.

    Parameters
    ----------
    clock, sleep : callable
        Monotonic seconds, and a wait.
    load : callable
        Programs that want each processor at a time, on average over a minute.
    """

    def __init__(
        self,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
        load: Callable[[], float] | None = None,
    ) -> None:
        self._clock = clock
        self._sleep = sleep
        self._load_of = _load_a_processor if load is None else load
        self._load = 0.0
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
        self._load = self._load_of()
        while self._late and self._late[0][0] < now_s - _REMEMBERS_S:
            self._late.popleft()

    @property
    def late_s(self) -> float:
        """Longest wait for a turn in the last 4 s, s."""
        return max((late_s for _, late_s in list(self._late)), default=0.0)

    def words(self) -> str:
        """Say that this computer is too busy; empty where it is not."""
        late_s = self.late_s
        if late_s >= TOO_LATE_S:
            return f"this computer is too busy: the recorder waited {late_s:.1f} s for its turn; end other programs"
        if self._load >= _TOO_MANY:
            return f"this computer is too busy: {self._load:.0f} programs want each processor; end other programs"
        return ""

    def _run(self) -> None:
        while not self._stopping.is_set():
            self.look()


def _load_a_processor() -> float:
    """0 where the system does not tell."""
    return os.getloadavg()[0] / (os.cpu_count() or 1) if hasattr(os, "getloadavg") else 0.0
