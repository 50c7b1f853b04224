"""What a command prints: results as text or JSON, progress only on a terminal."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import click
from sawbench.commands.link import current_link
from sawbench.plain import plain

T = TypeVar("T")


def progress(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
    """Yield `items`, with a progress bar and the time left on standard error where that is a terminal.

    Parameters
    ----------
    items : iterable
    description : str
    total : int, optional
        Number of items; needed where they have no length.
    """
    total = len(items) if isinstance(items, Sequence) else total
    link = current_link()
    if link is not None:
        for number, item in enumerate(items):
            link.progress(number, total or 0, f"{description}: {number + 1} of {total}")
            yield item
        return
    if (total is not None and total < 2) or not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(items, description=description, total=total, console=Console(stderr=True), transient=True)


def emit(result: Any, text: str, *, as_json: bool) -> None:
    """Print `result` as JSON or `text` for people.

    Parameters
    ----------
    result : object
        Dataclasses, mappings, sequences, arrays, numbers, paths, times.
    text : str
    as_json : bool
    """
    click.echo(json.dumps(plain(result), indent=2, allow_nan=False) if as_json else text)


def table(headers: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Lay out a plain-text table: first column left, the others right.

    Examples
    --------
    >>> print(table(["name", "N"], [["force", "12"], ["x", "3"]]))
    name    N
    force  12
    x       3
    """
    lines = [list(headers), *[list(row) for row in rows]]
    widths = [max(len(line[k]) for line in lines) for k in range(len(headers))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


@contextlib.contextmanager
def stepper(description: str) -> Iterator[Callable[[int, int, str], None]]:
    """Give a function (done, total, name) that moves a progress bar, here or in the panel; else it does nothing."""
    link = current_link()
    if link is not None:
        yield lambda done, total, name: link.progress(done, total, f"{description} {name}".strip())
        return
    if not sys.stderr.isatty():
        yield lambda done, total, name: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=None)

        def step(done: int, total: int, name: str) -> None:
            bar.update(task, completed=done, total=total, description=f"{description} {name}")

        yield step


def has_display() -> bool:
    """Whether a window can be opened on this machine."""
    if sys.platform in {"darwin", "win32"}:
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
