"""Commands that the panel has started: each a process with a folder of its own, found again after a crash."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

from sawbench.bench.errors import InputError
from sawbench.panel.words import in_panel
from sawbench.storage.json_lines import append_line
from sawbench.storage.output import write_whole

State = Literal["running", "done", "not reliable", "refused", "stopped", "failed"]
_STATE_OF_CODE: Final[Mapping[int, State]] = {0: "done", 1: "not reliable", 2: "refused", 130: "stopped"}
_FOLDER: Final = re.compile(r"\d{4,}-[a-z]+")
_LOG_CHARACTERS: Final = 20_000
# Computations that may run beside each other, and beside a recording.
MOST_BACKGROUND: Final = 2


@dataclass(frozen=True, kw_only=True, slots=True)
class JobKind:
    """What a job does to the bench.

    Attributes
    ----------
    needs_bench : bool
        It opens the instruments: one such job at a time.
    stops_by_interrupt : bool
        A wish to stop ends it as Ctrl-C does; the others look for it themselves and finish their file.
    """

    needs_bench: bool = False
    stops_by_interrupt: bool = True


KINDS: Final[Mapping[str, JobKind]] = MappingProxyType(
    {
        "check": JobKind(needs_bench=True),
        "tare": JobKind(needs_bench=True),
        "calibrate": JobKind(needs_bench=True, stops_by_interrupt=False),
        "record": JobKind(needs_bench=True, stops_by_interrupt=False),
        "series": JobKind(needs_bench=True, stops_by_interrupt=False),
        "report": JobKind(),
        "compare": JobKind(),
        "diagnose": JobKind(),
    }
)


@dataclass(frozen=True, kw_only=True)
class Job:
    """One command, as its folder tells.

    Attributes
    ----------
    folder : Path
    kind, title : str
    arguments : tuple of str
        Of `sawbench`.
    started_at : datetime
        UTC.
    form : mapping of str to str
        What was entered to start it.
    is_running : bool
    """

    folder: Path
    kind: str
    title: str
    arguments: tuple[str, ...]
    started_at: datetime
    form: Mapping[str, str] = field(default_factory=dict)
    is_running: bool

    @property
    def id(self) -> str:
        """Name of its folder."""
        return self.folder.name

    @property
    def command(self) -> str:
        """What somebody would type to do the same."""
        return shlex.join(["sawbench", *self.arguments])

    @cached_property
    def code(self) -> int | None:
        """Exit code; None while it runs, or where it was killed."""
        return self._json("exit.json").get("code")

    @property
    def state(self) -> State:
        """How it stands."""
        if self.is_running:
            return "running"
        return "failed" if self.code is None else _STATE_OF_CODE.get(self.code, "failed")

    @property
    def log(self) -> str:
        """The end of what it said, in words for the panel."""
        return in_panel(self._text("log.txt")[-_LOG_CHARACTERS:])

    @cached_property
    def result(self) -> Any:
        """What it printed as JSON; None where it printed none."""
        try:
            return json.loads(self._text("out.txt"))
        except (ValueError, RecursionError):
            return None

    @property
    def question(self) -> dict[str, Any]:
        """The question that is open; empty where there is none."""
        return self._json("question.json") if self.is_running else {}

    @property
    def progress(self) -> dict[str, Any]:
        """How far a computation is, as it said last: "done", "total", "what"; empty where it said nothing yet."""
        last = self._text("live.jsonl").rpartition("\n")[0].rpartition("\n")[2]
        try:
            found = json.loads(last)
        except ValueError:
            return {}
        return found if found.get("kind") == "progress" else {}

    @property
    def files(self) -> list[str]:
        """Pages and tables that it has written, relative to its folder."""
        endings = {".html", ".csv", ".h5", ".json", ".toml"}
        own = {"job.json", "exit.json", "question.json"}
        found = (path.relative_to(self.folder).as_posix() for path in self.folder.rglob("*") if path.suffix in endings)
        return sorted((name for name in found if name not in own), key=lambda name: (not name.endswith(".html"), name))

    def order(self, kind: Literal["answer", "note", "stop"], **facts: Any) -> None:
        """Tell the command something."""
        append_line(self.folder / "orders.jsonl", {"kind": kind, **facts})

    def _text(self, name: str) -> str:
        try:
            return (self.folder / name).read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""

    def _json(self, name: str) -> dict[str, Any]:
        try:
            found = json.loads(self._text(name))
        except ValueError:
            return {}
        return found if isinstance(found, dict) else {}


class Jobs:
    """All jobs of a folder.

    Parameters
    ----------
    folder : Path
        Made with the first job.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._processes: dict[str, subprocess.Popen[Any]] = {}
        self._lock = threading.Lock()

    def start(self, kind: str, title: str, arguments: Sequence[str], *, form: Mapping[str, str] | None = None) -> Job:
        """Start a command in a process that outlives the panel; `{folder}` in the arguments is the job's own folder.

        Raises
        ------
        InputError
            If the bench is in use, or enough is being computed already.
        """
        with self._lock:
            running = [job for job in self.all() if job.is_running]
            if KINDS[kind].needs_bench:
                busy = next((job for job in running if KINDS[job.kind].needs_bench), None)
                if busy is not None:
                    raise InputError(
                        f"the bench is in use: {busy.title}", remedy="wait until it is finished, or stop it"
                    )
            elif sum(not KINDS[job.kind].needs_bench for job in running) >= MOST_BACKGROUND:
                raise InputError(
                    f"{MOST_BACKGROUND} computations are already running",
                    remedy="wait until one is finished, or stop it",
                )
            folder = self._new_folder(kind)
            job = {
                "kind": kind,
                "title": title,
                "arguments": [argument.replace("{folder}", str(folder)) for argument in arguments],
                "started_at": datetime.now(UTC).isoformat(),
                "form": dict(form or {}),
                "is_background": not KINDS[kind].needs_bench,
                "stops_by_interrupt": KINDS[kind].stops_by_interrupt,
            }
            write_whole(folder / "job.json", json.dumps(job, indent=1))
            self._launch(folder)
        found = self.get(folder.name)
        assert found is not None
        return found

    def all(self) -> list[Job]:
        """Return every job, newest first."""
        names = [path.name for path in self._folder.glob("*") if _FOLDER.fullmatch(path.name)]
        found = (self.get(name) for name in sorted(names, key=lambda name: int(name.split("-")[0]), reverse=True))
        return [job for job in found if job is not None]

    def get(self, job_id: str) -> Job | None:
        """Return one job; None where there is none of that name."""
        folder = self._folder / job_id
        if not _FOLDER.fullmatch(job_id):
            return None
        try:
            fields = json.loads((folder / "job.json").read_text(encoding="utf-8"))
            return Job(
                folder=folder,
                kind=fields["kind"],
                title=fields["title"],
                arguments=tuple(fields["arguments"]),
                started_at=datetime.fromisoformat(fields["started_at"]),
                form=fields["form"],
                is_running=not (folder / "exit.json").exists() and self._lives(folder),
            )
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def latest(self, kind: str) -> Job | None:
        """Return the newest job of a kind."""
        return next((job for job in self.all() if job.kind == kind), None)

    def on_bench(self) -> Job | None:
        """Return the job that uses the bench now."""
        return next((job for job in self.all() if job.is_running and KINDS[job.kind].needs_bench), None)

    def _new_folder(self, kind: str) -> Path:
        self._folder.mkdir(parents=True, exist_ok=True)
        numbers = [int(path.name.split("-")[0]) for path in self._folder.glob("*") if _FOLDER.fullmatch(path.name)]
        number = max(numbers, default=0) + 1
        while True:
            folder = self._folder / f"{number:04d}-{kind}"
            try:
                folder.mkdir()
            except FileExistsError:
                number += 1
            else:
                return folder

    def _launch(self, folder: Path) -> None:
        call = [sys.executable, "-m", "sawbench.commands.job", str(folder)]
        # Of its own session: neither Ctrl-C at the panel nor the end of its terminal reaches a recording.
        apart: dict[str, Any] = (
            {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP} if os.name == "nt" else {"start_new_session": True}
        )
        with (folder / "out.txt").open("wb") as out, (folder / "log.txt").open("wb") as log:
            self._processes[folder.name] = subprocess.Popen(
                call, stdin=subprocess.DEVNULL, stdout=out, stderr=log, env={**os.environ, "PYTHONUNBUFFERED": "1"},
                **apart,
            )  # fmt: skip

    def _lives(self, folder: Path) -> bool:
        process = self._processes.get(folder.name)
        if process is not None:
            return process.poll() is None
        return _is_locked(folder / "lock")


def _is_locked(path: Path) -> bool:
    """Whether the process that holds a lock file lives: for jobs of a panel that has ended."""
    try:
        import fcntl

        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except (ImportError, OSError):
        return False
    return False
