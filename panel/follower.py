"""What a job says, as it says it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Final

from sawbench.panel.jobs import Job, Jobs
from sawbench.panel.words import in_panel
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

LOOK_EVERY_S: Final = 0.2
# Of the live numbers, a page that is opened late gets so much of what was before.
_LATE_BYTES: Final = 300_000


async def events(jobs: Jobs, job: Job, request: Request) -> AsyncIterator[str]:
    """Follow the files of a job until it has ended or the page is closed."""
    live = Follower(job.folder / "live.jsonl", late_bytes=_LATE_BYTES)
    log = Follower(job.folder / "log.txt")
    state: dict[str, Any] = {}
    while not await request.is_disconnected():
        found = await run_in_threadpool(jobs.get, job.id)
        if found is None:
            return
        if lines := [json.loads(line) for line in live.new_lines()]:
            yield _event("live", lines)
        if text := log.new_text(is_ended=not found.is_running):
            yield _event("log", in_panel(text))
        now = {"question": found.question.get("number"), "is_running": found.is_running}
        if now != state:
            state = now
            yield _event("state", state)
        if not found.is_running:
            return
        await asyncio.sleep(LOOK_EVERY_S)


def _event(name: str, content: Any) -> str:
    return f"event: {name}\ndata: {json.dumps(content)}\n\n"


class Follower:
    """What is added to a file while it is watched.

    Parameters
    ----------
    path : Path
        Need not be there yet.
    late_bytes : int, optional
        How much of what is there already is given; default: all.
    """

    def __init__(self, path: Path, *, late_bytes: int | None = None) -> None:
        self._path = path
        self._rest = b""
        size = path.stat().st_size if path.exists() else 0
        # The line in the middle of which that begins is dropped: `new_lines` takes whole ones alone.
        self._position = 0 if late_bytes is None else max(0, size - late_bytes)

    def new_lines(self) -> list[str]:
        """Return the lines that are complete and new."""
        *lines, self._rest = (self._rest + self._read()).split(b"\n")
        return [line.decode() for line in lines if line.startswith(b"{")]

    def new_text(self, *, is_ended: bool = False) -> str:
        """Return what is new, as whole lines, in which words are replaced; `is_ended`: with what follows the last."""
        whole, end, rest = (self._rest + self._read()).rpartition(b"\n")
        self._rest = b"" if is_ended else rest
        return (whole + end + (rest if is_ended else b"")).decode(errors="replace")

    def _read(self) -> bytes:
        try:
            with self._path.open("rb") as file:
                file.seek(self._position)
                new = file.read()
        except OSError:
            return b""
        self._position += len(new)
        return new
