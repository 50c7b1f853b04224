"""Link of a running command to the panel that started it, through files of one folder.

The command writes what it asks and measures; the panel writes answers, notes and the wish to stop. Neither waits for
the other: the command continues where the panel has crashed or its page was closed, and a panel that is started again
finds everything in the folder.

| file | written by | holds |
|---|---|---|
| `question.json` | command | the question that is open; absent where there is none |
| `live.jsonl` | command | state of the recording with force and current for the plot, five times a second; progress |
| `orders.jsonl` | panel | one line an answer, a note, a wish to stop |
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from sawbench.acquisition.recording_report import RecordingStatus
    from sawbench.bench.recording import Event, SampleBlock
    from sawbench.commands.live_estimate import LiveCuttingEstimate

VARIABLE: Final = "SAWBENCH_LINK"
QUESTION, LIVE, ORDERS = "question.json", "live.jsonl", "orders.jsonl"
_LOOK_EVERY_S: Final = 0.1
# Of the plot: smallest and largest value of every so many seconds.
_BIN_S: Final = 0.01
_PLOTTED: Final = ("force_n", "motor_current_a")

_current: list[Link] = []


def current_link() -> Link | None:
    """Return the link to the panel; None where the command was not started by one."""
    folder = os.environ.get(VARIABLE)
    if not folder:
        return None
    if not _current:
        _current.append(Link(Path(folder)))
    return _current[0]


class Link:
    """The command's end of the link.

    Attributes
    ----------
    stop : threading.Event
        Somebody has pressed stop, and nobody has taken note of it yet.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.stop = threading.Event()
        self._answers: SimpleQueue[dict[str, Any]] = SimpleQueue()
        self._notes: SimpleQueue[str] = SimpleQueue()
        self._n_asked = 0
        self._plot = PlotFeed()
        self._last_progress_s = 0.0
        threading.Thread(target=self._follow, name="orders of the panel", daemon=True).start()

    def ask(self, question: str, *, default: str = "", choices: str = "") -> str | None:
        """Have a question answered; None where somebody pressed stop instead.

        Parameters
        ----------
        question : str
        default : str
        choices : str
            Letters of which one must be given; empty: any text.
        """
        self._n_asked += 1
        asked = {"number": self._n_asked, "question": question, "default": default, "choices": choices.split()}
        self._write_whole(QUESTION, asked)
        try:
            while not self.stop.is_set():
                with suppress(Empty):
                    order = self._answers.get(timeout=_LOOK_EVERY_S)
                    if order.get("number") == self._n_asked:
                        return str(order.get("text", "")).strip() or default
            self.stop.clear()
            return None
        finally:
            (self._folder / QUESTION).unlink(missing_ok=True)

    @contextmanager
    def notes(self) -> Iterator[Iterator[str]]:
        """Give the notes that are written until the context ends; later ones wait for `waiting_notes`."""
        over = threading.Event()

        def lines() -> Iterator[str]:
            while not over.is_set():
                with suppress(Empty):
                    yield self._notes.get(timeout=_LOOK_EVERY_S)

        try:
            yield lines()
        finally:
            over.set()

    def waiting_notes(self) -> list[str]:
        """Return the notes that nobody has taken yet."""
        found: list[str] = []
        with suppress(Empty):
            while True:
                found.append(self._notes.get_nowait())
        return found

    def raise_if_stopped(self) -> None:
        """Give way to a wish to stop that came before there was anything to finish.

        Raises
        ------
        KeyboardInterrupt
        """
        if self.stop.is_set():
            self.stop.clear()
            raise KeyboardInterrupt("stopped by the operator")

    def signals(self, item: SampleBlock | Event) -> None:
        """Take what was recorded, for the live plot: an observer of the recording."""
        self._plot.take(item)

    def status(self, status: RecordingStatus, seconds: float | None, estimate: LiveCuttingEstimate | None) -> None:
        """Show one snapshot of the recording."""
        self._add_live(
            {
                "kind": "recording",
                "phase": status.phase,
                "elapsed_s": round(status.elapsed_s, 2),
                "seconds": seconds,
                "light": status.light,
                "warnings": list(status.warnings),
                "lost": list(status.lost_devices),
                "estimate": "" if estimate is None else estimate.describe(),
                "channels": [
                    {"channel": c.channel, "unit": c.unit, "latest": c.latest, "rate_hz": round(c.rate_hz, 1),
                     "n_samples": c.n_samples, "n_gaps": c.n_gaps, "n_missing": c.n_missing}
                    for c in status.channels
                ],
                "plot": self._plot.drain(),
            }
        )  # fmt: skip

    def phase(self, text: str) -> None:
        """Say what continues where there are no numbers yet, or none any more."""
        self._add_live({"kind": "phase", "phase": text})

    def progress(self, done: int, total: int, what: str) -> None:
        """Say how far a computation is; at most five times a second."""
        now_s = time.monotonic()
        if done < total and now_s - self._last_progress_s < 2 * _LOOK_EVERY_S:
            return
        self._last_progress_s = now_s
        self._add_live({"kind": "progress", "done": done, "total": total, "what": what})

    def _add_live(self, fields: dict[str, Any]) -> None:
        # Nothing here is worth the recording: a full disk ends the display.
        with suppress(OSError, ValueError), (self._folder / LIVE).open("a", encoding="utf-8") as file:
            file.write(json.dumps(fields, allow_nan=False) + "\n")

    def _write_whole(self, name: str, fields: dict[str, Any]) -> None:
        from sawbench.storage.output import write_whole

        write_whole(self._folder / name, json.dumps(fields), overwrite=True)

    def _follow(self) -> None:
        """Read the orders as they come; the thread ends with the program."""
        position, rest = 0, b""
        while True:
            with suppress(OSError), (self._folder / ORDERS).open("rb") as file:
                file.seek(position)
                new = file.read()
                position += len(new)
                *lines, rest = (rest + new).split(b"\n")
                for line in lines:
                    self._obey(line)
            time.sleep(_LOOK_EVERY_S)

    def _obey(self, line: bytes) -> None:
        try:
            order = json.loads(line)
        except ValueError:
            return
        if order.get("kind") == "answer":
            self._answers.put(order)
        elif order.get("kind") == "note" and str(order.get("text", "")).strip():
            self._notes.put(str(order["text"]).strip())
        elif order.get("kind") == "stop":
            self.stop.set()


class PlotFeed:
    """Force and current thinned for the live plot: smallest and largest value of every hundredth of a second."""

    def __init__(self) -> None:
        self._blocks: dict[str, list[SampleBlock]] = {name: [] for name in _PLOTTED}
        self._lock = threading.Lock()

    def take(self, item: SampleBlock | Event) -> None:
        """Keep a block of a channel that is plotted."""
        from sawbench.bench.recording import SampleBlock

        if isinstance(item, SampleBlock) and item.channel in self._blocks and len(item.time_s):
            with self._lock:
                self._blocks[item.channel].append(item)

    def drain(self) -> dict[str, list[list[float]]]:
        """Return times (s) and values of each channel since the last call."""
        with self._lock:
            taken, self._blocks = self._blocks, {name: [] for name in _PLOTTED}
        return {name: _thinned(blocks) for name, blocks in taken.items() if blocks}


def _thinned(blocks: list[SampleBlock]) -> list[list[float]]:
    import numpy as np

    time_s = np.concatenate([block.time_s for block in blocks])
    values = np.concatenate([block.values for block in blocks])
    edges = np.flatnonzero(np.diff(np.floor(time_s / _BIN_S))) + 1
    chosen: list[int] = []
    for first, end in zip([0, *edges.tolist()], [*edges.tolist(), len(time_s)], strict=True):
        part = values[first:end]
        chosen += sorted({first + int(part.argmin()), first + int(part.argmax())})
    return [np.round(time_s[chosen], 4).tolist(), [float(f"{value:.4g}") for value in values[chosen]]]
