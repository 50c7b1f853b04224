"""Ctrl-C while a recording is written: noted, and looked at between two writes.

An exception from a signal comes between any two instructions, in the middle of a chunk of the file too, whose samples
would be lost.
"""

from __future__ import annotations

import signal
import threading
import time
from types import FrameType, TracebackType
from typing import Any, Final

_NAMES: Final = ("SIGINT", "SIGTERM", "SIGHUP")
# A signal that comes again this long after the first means that writing hangs.
_PATIENCE_S: Final = 1.0


class EndSignals:
    """Notes the signals that end a program while the context lasts; what nobody has taken is raised when it ends.

    A signal has the meaning that it had before: it is noted where its handler raises KeyboardInterrupt. One that comes
    a second or more after the first is raised at once. Outside the main thread, where no signal arrives, and for
    signals that Python does not handle, nothing changes.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._words: str | None = None
        self._noted_s: float | None = None

    def take(self) -> str | None:
        """Return why the program should end, once; None where it should not."""
        words, self._words = self._words, None
        return words

    def __enter__(self) -> EndSignals:
        if threading.current_thread() is threading.main_thread():
            for number in (getattr(signal, name) for name in _NAMES if hasattr(signal, name)):
                if callable(handler := signal.getsignal(number)):
                    self._before[number] = handler
                    signal.signal(number, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            # A handler may have had the signal ignored from then on.
            if signal.getsignal(number) == self._note:
                signal.signal(number, handler)
        words = self.take()
        if kind is None and words is not None:
            raise KeyboardInterrupt(words)

    def _note(self, number: int, frame: FrameType | None) -> None:
        try:
            self._before[number](number, frame)
        except KeyboardInterrupt as wish:
            now_s = time.monotonic()
            if self._noted_s is None:
                self._words, self._noted_s = str(wish) or "stopped by the operator (Ctrl-C)", now_s
            elif now_s - self._noted_s >= _PATIENCE_S:
                raise
