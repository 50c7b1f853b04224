"""The Rerun viewer as a process of its own: started here, never waited for."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from sawbench.bench.errors import InputError

LOOPBACK = "127.0.0.1"
VIEWER_MEMORY_LIMIT = "1GB"
"""Rerun's default is 75 % of the memory; a bench computer has other things to do."""

_COLOUR_CODES = re.compile(r"\x1b\[[0-9;]*m")
_TROUBLE = re.compile(r"error|panic|not found|failed", re.IGNORECASE)


def free_port() -> int:
    """Return a TCP port that is free on the loopback interface right now."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def refuse_rrd(path: str | Path, *, overwrite: bool) -> None:
    """Refuse to write an `.rrd` file.

    Raises
    ------
    InputError
        If the file exists and `overwrite` is not set, or its folder is missing.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise InputError("exists already", where=path, remedy="give another file name, or overwrite with --force")
    if not path.parent.is_dir():
        raise InputError("the folder does not exist", where=path, remedy=f"create {path.parent} first")


def viewer_environment() -> dict[str, str]:
    """Return the environment of the viewer: ours, with its usage analytics switched off.

    Rerun sends usage data unless the user has run `rerun analytics disable`. It sends none where `CI` is set,
    which leaves the user's own Rerun configuration alone.
    """
    environment = dict(os.environ)
    environment.pop("FORCE_RERUN_ANALYTICS", None)
    environment.update(CI="1", RERUN_APP_ONLY="true")
    return environment


class ViewerProcess:
    """A Rerun viewer that listens on the loopback interface only.

    Parameters
    ----------
    sources : sequence of str
        `.rrd` files to open.
    connect_to : str, optional
        URL of a stream to follow, `rerun+http://127.0.0.1:PORT/proxy`.
    port : int, optional
        Port of the viewer's own server; one that is free by default.
    is_headless : bool
        Without a window, for screenshots.
    memory_limit : str
        Oldest samples leave the viewer above this.
    """

    def __init__(
        self,
        sources: Sequence[str] = (),
        *,
        connect_to: str | None = None,
        port: int | None = None,
        is_headless: bool = False,
        window_size: tuple[int, int] | None = None,
        memory_limit: str = VIEWER_MEMORY_LIMIT,
    ) -> None:
        self.port = free_port() if port is None else port
        command = [sys.executable, "-m", "rerun_cli", *sources]
        command += ["--bind", LOOPBACK, "--port", str(self.port)]
        command += ["--memory-limit", memory_limit, "--server-memory-limit", "256MB", "--hide-welcome-screen"]
        command += ["--connect", connect_to] if connect_to else []
        command += ["--headless"] if is_headless else []
        command += ["--window-size", "{}x{}".format(*window_size)] if window_size else []
        self._log: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        self._process = subprocess.Popen(
            command,
            env=viewer_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._log,
            start_new_session=os.name == "posix",
        )

    @property
    def pid(self) -> int:
        """Process id; on POSIX also the id of its process group."""
        return self._process.pid

    @property
    def url(self) -> str:
        """Where the viewer listens."""
        return f"rerun+http://{LOOPBACK}:{self.port}/proxy"

    @property
    def is_running(self) -> bool:
        """Whether the process lives."""
        return self._process.poll() is None

    def is_listening(self) -> bool:
        """Whether the viewer accepts connections."""
        with socket.socket() as probe:
            probe.settimeout(0.2)
            return probe.connect_ex((LOOPBACK, self.port)) == 0

    def why_ended(self) -> str:
        """Say in one line how the viewer ended, with the last line it wrote."""
        if self.is_running:
            return "the viewer is running"
        self._log.seek(0)
        text = _COLOUR_CODES.sub("", self._log.read().decode(errors="replace"))
        if "DISPLAY is set" in text:
            return "there is no display for the viewer"
        told = [line.strip() for line in text.splitlines() if _TROUBLE.search(line)]
        # The launcher's exit code says nothing: it is 0 whatever became of the viewer.
        return f"the viewer ended: {told[-1]}" if told else "the viewer was closed"

    def kill(self) -> None:
        """End the viewer and its helper process at once; nothing happens if they are gone."""
        if os.name == "posix":
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        elif self.is_running:
            subprocess.run(["taskkill", "/PID", str(self._process.pid), "/T", "/F"], check=False, capture_output=True)
        self._process.wait(timeout=5.0)
        self.release()

    def release(self) -> None:
        """Let go of the viewer, which keeps running; only its log is given up."""
        self._log.close()
        # The process outlives us on purpose; without this its object would warn when collected.
        if self._process.returncode is None and self.is_running:
            self._process.returncode = 0
