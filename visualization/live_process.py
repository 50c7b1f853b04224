"""The live view in a process of its own: what it costs, and what becomes of it, is no matter of the recorder.

Blocks and events go through a bounded queue and a pipe to `python -m sawbench.visualization.live_process`, which shows
them with `rerun_view.LiveView`. Rerun is imported there alone.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal

from sawbench.bench.errors import SawbenchError
from sawbench.bench.processed import Frame
from sawbench.bench.recording import Event, SampleBlock, Trial
from sawbench.bench.sample_queue import SampleQueue
from sawbench.visualization.viewer import refuse_rrd

_COMMAND: Final = (sys.executable, "-m", "sawbench.visualization.live_process")
_Estimate = tuple[float, float, float, float | None, float | None]


class LiveViewProcess:
    """Shows a trial in Rerun while it is recorded; an observer for `SampleBlock` and `Event`.

    Calls return at once; where the other process cannot keep up, hangs or is gone, what is shown is dropped, never what
    is recorded.

    Parameters
    ----------
    trial : Trial, optional
    show : {"spawn", "serve", "none"}
    save_path : str or Path, optional
    overwrite, frame, has_estimate
        As `rerun_view.LiveView`.
    command : sequence of str
        What is started; tests start something else.

    Attributes
    ----------
    is_dead : bool
        Whether the view ended early; known while it runs where its process is gone, else after `close`.
    dead_reason : str
        Why, one line; empty while all is well.

    Raises
    ------
    InputError
        If `save_path` cannot be written.
    """

    def __init__(
        self,
        trial: Trial | None = None,
        *,
        show: Literal["spawn", "serve", "none"] = "spawn",
        save_path: str | Path | None = None,
        overwrite: bool = False,
        frame: Frame = "crank",
        has_estimate: bool = False,
        command: Sequence[str] = _COMMAND,
    ) -> None:
        if save_path is not None:
            refuse_rrd(save_path, overwrite=overwrite)
        self.is_dead = False
        self.dead_reason = ""
        self._n_not_shown = 0
        self._waiting: SampleQueue[Any] = SampleQueue()
        self._waiting.put(
            {
                "trial": trial,
                "show": show,
                "save_path": save_path,
                "overwrite": overwrite,
                "frame": frame,
                "has_estimate": has_estimate,
            }
        )
        # In a session of its own: Ctrl-C ends the recording, and the view when that is done.
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=os.name == "posix",
        )
        self._is_closed = False
        self._sender = threading.Thread(target=self._send, name="live view", daemon=True)
        self._sender.start()

    @property
    def n_dropped(self) -> int:
        """Items that did not reach the view, or that it could not keep up with; the latter are known after `close`."""
        return self._waiting.n_dropped + self._n_not_shown

    @property
    def pid(self) -> int:
        """Of the process that shows."""
        return self._process.pid

    def __call__(self, item: SampleBlock | Event) -> None:
        """Show a block of samples or an event; returns at once."""
        # What the instrument sent is not shown.
        self._put(replace(item, raw=None) if isinstance(item, SampleBlock) else item)

    def cutting_estimate(
        self,
        time_s: float,
        k_fc_n_s_per_m: float,
        std_n_s_per_m: float,
        remaining_s: float | None = None,
        remaining_std_s: float | None = None,
    ) -> None:
        """Show k_Fc and the battery's remaining time, each with its standard uncertainty as a band; returns at once."""
        self._put((time_s, k_fc_n_s_per_m, std_n_s_per_m, remaining_s, remaining_std_s))

    def close(self, timeout_s: float = 15.0) -> None:
        """Let the view show what waits and end; a viewer stays open. One that hangs for `timeout_s` is killed."""
        if self._is_closed:
            return
        self._is_closed = True
        self._waiting.end()
        self._sender.join(timeout_s)
        if self._sender.is_alive():
            self._die("the live view does not accept samples")
            self._process.kill()
            self._sender.join()
        self._process.wait()

    def _put(self, item: SampleBlock | Event | _Estimate) -> None:
        if self.is_dead:
            self._n_not_shown += 1
        else:
            self._waiting.put(item)

    def _die(self, reason: str) -> None:
        if not self.is_dead:
            self.is_dead, self.dead_reason = True, reason

    def _send(self) -> None:
        """Move items into the pipe; at the end take over what the other process says of itself."""
        to_view, said = self._process.stdin, self._process.stdout
        assert to_view is not None and said is not None
        try:
            while (item := self._waiting.get()) is not None:
                pickle.dump(item, to_view)
                to_view.flush()
            to_view.close()
        except OSError:
            self._die("the process of the live view ended")
        finally:
            with contextlib.suppress(OSError):
                to_view.close()
        with said:
            text = said.read()
        try:
            found = json.loads(text)
        except ValueError:
            self._die("the process of the live view ended")
            return
        self._n_not_shown += found["n_dropped"]
        if found["dead_reason"]:
            self._die(found["dead_reason"])


def main() -> None:
    """Show what arrives on standard input until it ends, then say on standard output how it went."""
    # It ends when the recorder does, not at Ctrl-C.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from sawbench.visualization.rerun_view import LiveView

    stream = sys.stdin.buffer
    n_dropped, reason = 0, ""
    try:
        view = LiveView(**pickle.load(stream))
        while (item := _next(stream)) is not None:
            if isinstance(item, tuple):
                view.cutting_estimate(*item)
            else:
                view(item)
        view.close()
        n_dropped, reason = view.n_dropped, view.dead_reason
    except SawbenchError as error:
        reason = str(error)
    sys.stdout.write(json.dumps({"n_dropped": n_dropped, "dead_reason": reason}))


def _next(stream: Any) -> Any:
    """Return the next item; None where the recorder has closed the pipe, or was killed while it wrote."""
    try:
        return pickle.load(stream)
    except (EOFError, pickle.UnpicklingError):
        return None


if __name__ == "__main__":
    main()
