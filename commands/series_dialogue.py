"""Questions to the technician, and lines that become notes while a trial is recorded."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Iterable, Iterator
from typing import Final

import click
from sawbench.commands.link import Link
from sawbench.commands.typed_lines import TypedLines

_LOOK_EVERY_S: Final = 0.1
_NOTE: Final = "n "


class SeriesStopped(Exception):
    """The technician wants to go on another time."""


class Dialogue:
    """One reader of the lines that the technician types, whoever needs them.

    Parameters
    ----------
    lines : iterable of str, optional
        Standard input; without it nobody is asked and every question has its default for an answer.
    is_typed : bool
        A person types the lines as the questions come; only then are lines between them notes.
    """

    def __init__(self, lines: Iterable[str] | None, *, is_typed: bool = False) -> None:
        self.is_attended = lines is not None
        self._is_typed = is_typed
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self.typed = lines if isinstance(lines, TypedLines) else None
        self.notes: list[str] = []
        if lines is not None:
            threading.Thread(target=self._read, args=(lines,), name="technician", daemon=True).start()

    def say(self, text: str) -> None:
        """Show one or more lines."""
        click.echo(text, err=True)

    def phase(self, text: str) -> None:
        """Show what is being done, where that has a place of its own: not in the terminal."""

    def ask(self, question: str, *, default: str, choices: str = "") -> str:
        """Return the answer; a line that begins with `n ` is taken into `notes` and the question asked again.

        Parameters
        ----------
        question : str
        default : str
            For an empty line, and where nobody is asked.
        choices : str
            Letters of which one must be given; empty: any text.

        Raises
        ------
        SeriesStopped
            On `q`, and at the end of the input.
        """
        if not self.is_attended:
            self.say(f"{question} {default}".rstrip())
            return default
        while True:
            click.echo(f"{question} [{default or 'Enter'}] ", err=True, nl=False)
            line = self._next()
            if line is None:
                raise SeriesStopped("the input ended")
            answer = line.strip()
            if answer.startswith(_NOTE):
                self.notes.append(answer.removeprefix(_NOTE).strip())
                self.say("noted")
            elif answer == "q":
                raise SeriesStopped("by the technician")
            elif not answer or not choices or answer in choices.split():
                return answer or default
            else:
                self.say(f"{answer!r} is not one of {choices} q, and not a note (n TEXT)")

    @contextlib.contextmanager
    def meanwhile(self) -> Iterator[Iterator[str]]:
        """Give the lines that are typed until the context ends."""
        over = threading.Event()
        try:
            yield self._until(over) if self._is_typed else iter(())
        finally:
            over.set()

    def _until(self, over: threading.Event) -> Iterator[str]:
        while not over.is_set():
            with contextlib.suppress(queue.Empty):
                line = self._lines.get(timeout=_LOOK_EVERY_S)
                if line is None or over.is_set():
                    self._lines.put(line)
                    return
                yield line

    def _next(self) -> str | None:
        # In short waits: Ctrl-C must get through.
        while True:
            with contextlib.suppress(queue.Empty):
                return self._lines.get(timeout=_LOOK_EVERY_S)

    def _read(self, lines: Iterable[str]) -> None:
        # An end of the input, or a line that is no text, ends the sitting; nobody may wait for more.
        try:
            for line in lines:
                self._lines.put(line)
        except (OSError, ValueError) as error:
            self.say(f"the input cannot be read: {error}")
        finally:
            self._lines.put(None)


class PanelDialogue(Dialogue):
    """The technician at the panel: questions and notes go through its link."""

    def __init__(self, link: Link) -> None:
        super().__init__(None)
        self.is_attended = True
        self._link = link

    def phase(self, text: str) -> None:
        """Show what is being done, above the log."""
        self._link.phase(text)

    def ask(self, question: str, *, default: str, choices: str = "") -> str:
        """Return the answer; notes that were written meanwhile are taken into `notes`.

        Raises
        ------
        SeriesStopped
            If somebody presses stop.
        """
        answer = self._link.ask(question.partition(" (n TEXT")[0], default=default, choices=choices)
        self.notes += self._link.waiting_notes()
        if answer is None:
            raise SeriesStopped("by the technician")
        self.say(f"{question.partition(' (n TEXT')[0]}: {answer}")
        return answer
