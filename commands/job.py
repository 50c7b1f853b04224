"""Runs one command of `sawbench` for the panel: `python -m sawbench.commands.job FOLDER`.

A process of its own, which neither the end of the panel nor a closed page ends. `job.json` in the folder states the
arguments; when the command has ended, `exit.json` states its exit code. Standard output and error are files already.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Final

from sawbench.commands.link import LIVE, VARIABLE, current_link
from sawbench.commands.main import main, raise_terminated
from sawbench.storage.output import write_whole

JOB, EXIT, LOCK = "job.json", "exit.json", "lock"
# The bench comes first: what only computes steps back.
_BACKGROUND_NICENESS: Final = 10
_INTERRUPTED: Final = 130


def run_job(folder: Path) -> int:
    """Run the command of a folder, keep its exit code there, and return it."""
    job = json.loads((folder / JOB).read_text(encoding="utf-8"))
    os.environ[VARIABLE] = str(folder.resolve())
    if job["is_background"] and hasattr(os, "nice"):
        os.nice(_BACKGROUND_NICENESS)
    if job["stops_by_interrupt"]:
        threading.Thread(target=_interrupt_when_asked, name="stop", daemon=True).start()
    with (folder / LOCK).open("a") as lock:
        _hold(lock.fileno())
        code = _INTERRUPTED
        try:
            code = main(job["arguments"])
        finally:
            # The panel reads the results as soon as the exit code is there.
            for stream in (sys.stdout, sys.stderr):
                stream.flush()
            write_whole(folder / EXIT, json.dumps({"code": code, "at": time.time()}), overwrite=True)
            # The recording has all of it.
            (folder / LIVE).unlink(missing_ok=True)
    return code


def _interrupt_when_asked() -> None:
    """Turn the wish to stop into a Ctrl-C, for commands that know no other way."""
    link = current_link()
    assert link is not None
    link.stop.wait()
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        signal.raise_signal(signal.SIGINT)


def _hold(descriptor: int) -> None:
    """Show by a lock that this process lives; it ends with the process, however that ends."""
    try:
        import fcntl
    except ImportError:
        return
    fcntl.flock(descriptor, fcntl.LOCK_EX)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, raise_terminated)
    # A process in a session of its own may have been born with Ctrl-C ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(run_job(Path(sys.argv[1])))
