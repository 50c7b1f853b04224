"""Lines that a person types, while a live display is redrawn over the place where they would appear."""

from __future__ import annotations

import codecs
import contextlib
import os
import select
from collections.abc import Iterator
from typing import Any, Final

_LOOK_EVERY_S: Final = 0.1
_ERASE: Final = "\x7f\b"
_ERASE_LINE: Final = "\x15"


class TypedLines:
    """The lines of a terminal; `pending` is what is typed of the next one while the terminal does not echo.

    Parameters
    ----------
    descriptor : int
        Of the terminal, as `sys.stdin.fileno()` gives it.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self.pending = ""

    @property
    def can_be_silent(self) -> bool:
        """Whether the terminal can be told not to echo; elsewhere nothing may be redrawn over what is typed."""
        try:
            import termios
        except ImportError:
            return False
        try:
            termios.tcgetattr(self._descriptor)
        except termios.error:
            return False
        return True

    def __iter__(self) -> Iterator[str]:
        """Yield lines until the input ends."""
        while True:
            if not select.select([self._descriptor], [], [], _LOOK_EVERY_S)[0]:
                continue
            try:
                read = os.read(self._descriptor, 1024)
            except OSError:
                # The terminal has gone.
                return
            if not read:
                return
            yield from self.feed(self._decoder.decode(read))

    def feed(self, text: str) -> Iterator[str]:
        r"""Take typed characters and yield the lines that they complete; erasing keys erase.

        Examples
        --------
        >>> lines = TypedLines(0)
        >>> list(lines.feed("knoz")), list(lines.feed("\x7ft here\nand"))
        ([], ['knot here'])
        >>> lines.pending
        'and'
        """
        for character in text:
            if character in "\r\n":
                line, self.pending = self.pending, ""
                yield line
            elif character in _ERASE:
                self.pending = self.pending[:-1]
            elif character == _ERASE_LINE:
                self.pending = ""
            elif character.isprintable():
                self.pending += character

    @contextlib.contextmanager
    def silent(self) -> Iterator[None]:
        """Let the terminal give every key at once and echo none; whoever draws shows `pending`. Ctrl-C stays."""
        if not self.can_be_silent:
            yield
            return
        import termios

        before: list[Any] = termios.tcgetattr(self._descriptor)
        quiet = list(before)
        quiet[3] &= ~(termios.ICANON | termios.ECHO)
        termios.tcsetattr(self._descriptor, termios.TCSADRAIN, quiet)
        try:
            yield
        finally:
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, before)


def typed_lines() -> TypedLines | None:
    """Return the lines of the terminal; None where standard input is none, or the system cannot read single keys."""
    import sys

    if sys.stdin is None or not sys.stdin.isatty():
        return None
    found = TypedLines(sys.stdin.fileno())
    return found if found.can_be_silent else None
