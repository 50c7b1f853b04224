"""The live view: an observer of a recording that can neither stop it nor slow it down.

Samples pass through a bounded queue to a thread of our own, which thins them out and hands them to rerun.
Rerun serves them on the loopback interface; the viewer is a separate process that follows this server, so it
can appear late, die or hang without anything here waiting for it.
"""

from __future__ import annotations

import math
import queue
import threading
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from sawbench.bench.processed import Frame
from sawbench.bench.recording import Event, Floats, SampleBlock, Trial
from sawbench.bench.sample_queue import SampleQueue
from sawbench.bench.units import DISPLACEMENT
from sawbench.modeling.machines.words import words_of
from sawbench.visualization.envelope import envelope_indices
from sawbench.visualization.layout import (
    K_FC,
    REMAINING,
    STROKE_RATE_PATH,
    TIMELINE,
    log_bounds_style,
    log_event,
    log_style,
    log_trial,
    make_blueprint,
    series_of,
)
from sawbench.visualization.sdk import rr
from sawbench.visualization.stroke_rate import LiveStrokeRate
from sawbench.visualization.viewer import LOOPBACK, ViewerProcess, free_port, refuse_rrd

Show = Literal["spawn", "serve", "none"]
_Item = SampleBlock | Event | tuple[float, float, float, float, float]
_SEND_EVERY_S: Final = 0.05
# Points a second and channel that are shown: the envelope keeps every peak.
_MAX_RATE_HZ: Final = 1000.0
# Width of the moving time window.
_WINDOW_S: Final = 3.0
# For viewers that connect late the stream is kept up to this size, the oldest part goes first.
_MEMORY_LIMIT: Final = "64MB"
_VIEWER_CHECK_EVERY_S: Final = 0.5
_APPLICATION_ID: Final = "sawbench"


def send_samples(recording: Any, path: str, time_s: Floats, values: Floats, *, chunk: int = 10_000) -> None:
    """Send samples of one entity in chunks of columns.

    Parameters
    ----------
    recording : rerun.RecordingStream
    path : str
    time_s : ndarray, shape (n,), s
    values : ndarray, shape (n,)
        NaN breaks the line.
    chunk : int
        Samples a chunk; rerun is fastest near 10 000.
    """
    for first in range(0, len(time_s), chunk):
        part = slice(first, first + chunk)
        recording.send_columns(
            path,
            indexes=[rr.TimeColumn(TIMELINE, duration=time_s[part])],
            columns=rr.Scalars.columns(scalars=values[part]),
        )


def open_rrd(path: str | Path, *, overwrite: bool) -> Any:
    """Return a rerun sink that writes `path`.

    Raises
    ------
    InputError
        See `viewer.refuse_rrd`.
    """
    refuse_rrd(path, overwrite=overwrite)
    return rr.FileSink(path)


def _start_viewer(url: str) -> ViewerProcess:
    return ViewerProcess(connect_to=url)


class LiveView:
    """Shows a trial in Rerun while it is recorded; an observer for `SampleBlock`.

    Nothing the viewer does reaches the caller: calls return at once, samples are dropped from the view (never
    from the recording) when it cannot keep up, and the first trouble is kept in `dead_reason`.

    Parameters
    ----------
    trial : Trial, optional
        For the text panel.
    show : {"spawn", "serve", "none"}
        Start a viewer; only serve the stream, for a viewer that is opened by hand with `rerun --connect URL`;
        or neither (with `save_path`).
    save_path : str or Path, optional
        Also write what is shown, thinned out as it is, to this `.rrd` file.
    overwrite : bool
        Allow `save_path` to exist.
    frame : {"crank", "linear_axis"}
        Of the machine that is recorded.
    has_estimate : bool
        Make room for k_Fc and the remaining runtime; see `cutting_estimate`.
    start_viewer : callable
        Starts the viewer that follows the stream at a URL; tests start one without a window.

    Attributes
    ----------
    is_dead : bool
        Whether the view is no longer shown; a written `.rrd` goes on.
    dead_reason : str
        Why, one line; empty while all is well.
    url : str or None
        Where the stream is served.

    Raises
    ------
    InputError
        If `save_path` cannot be written. Trouble with the viewer never raises.

    Examples
    --------
    >>> view = LiveView(show="none")
    >>> view(SampleBlock(device="cell", channel="force_n", unit="N", first_index=0,
    ...                  time_s=np.arange(3) / 5000, values=np.zeros(3)))
    >>> view.close()
    >>> view.is_dead
    False
    """

    def __init__(
        self,
        trial: Trial | None = None,
        *,
        show: Show = "spawn",
        save_path: str | Path | None = None,
        overwrite: bool = False,
        frame: Frame = "crank",
        has_estimate: bool = False,
        start_viewer: Callable[[str], ViewerProcess] = _start_viewer,
    ) -> None:
        self.is_dead = False
        self.dead_reason = ""
        self.url: str | None = None
        self._words = words_of(frame)
        self._viewer: ViewerProcess | None = None
        self._waiting: SampleQueue[_Item] = SampleQueue()
        self._is_closing = threading.Event()
        self._pending: dict[str, list[SampleBlock]] = {}
        self._next_index: dict[str, int] = {}
        self._styled: set[str] = set()
        self._stroke_rate = LiveStrokeRate()
        self._recording = rr.RecordingStream(_APPLICATION_ID, recording_id=uuid.uuid4())
        self._attach(show, save_path, overwrite, start_viewer)
        if trial is not None:
            log_trial(self._recording, trial, words=self._words)
        blueprint = make_blueprint(words=self._words, live_window_s=_WINDOW_S, has_estimate=has_estimate)
        self._recording.send_blueprint(blueprint)
        self._worker = threading.Thread(target=self._work, name="live view", daemon=True)
        self._worker.start()

    def _attach(
        self,
        show: Show,
        save_path: str | Path | None,
        overwrite: bool,
        start_viewer: Callable[[str], ViewerProcess],
    ) -> None:
        sinks = [] if save_path is None else [open_rrd(save_path, overwrite=overwrite)]
        if show != "none":
            try:
                server = rr.GrpcServerSink(
                    bind_ip=LOOPBACK, port=free_port(), server_memory_limit=_MEMORY_LIMIT, newest_first=False
                )
                self._recording.set_sinks(server, *sinks)
                self.url = server.uri
                if show == "spawn":
                    self._viewer = start_viewer(server.uri)
                return
            except Exception as error:  # whatever rerun raises: the recording goes on without it
                self._die(f"the live view could not start: {error}")
        if sinks:
            self._recording.set_sinks(*sinks)

    @property
    def n_dropped(self) -> int:
        """Items that the view could not keep up with."""
        return self._waiting.n_dropped

    @property
    def viewer_pid(self) -> int | None:
        """Process id of the viewer that was started, if any."""
        return None if self._viewer is None else self._viewer.pid

    def __call__(self, item: SampleBlock | Event) -> None:
        """Show a block of samples, or a note or another event; returns at once."""
        self._put(item)

    def cutting_estimate(
        self,
        time_s: float,
        k_fc_n_s_per_m: float,
        std_n_s_per_m: float,
        remaining_s: float | None = None,
        remaining_std_s: float | None = None,
    ) -> None:
        """Show k_Fc and the battery's remaining time, each with its standard uncertainty as a band; returns at once."""
        left_s, left_std_s = (math.nan if value is None else value for value in (remaining_s, remaining_std_s))
        self._put((time_s, k_fc_n_s_per_m, std_n_s_per_m, left_s, left_std_s))

    def close(self, timeout_s: float = 5.0) -> None:
        """Send what is waiting, finish the file and let go of the viewer, which stays open.

        Parameters
        ----------
        timeout_s : float
            Longest time this may take, s. A viewer that hangs is left behind, with the reason kept.
        """
        if self._is_closing.is_set():
            return
        self._is_closing.set()
        self._worker.join(timeout_s)
        if self._worker.is_alive():
            self._die("the viewer does not accept samples")
            if self._viewer is not None:
                self._viewer.kill()
        elif self._viewer is not None:
            self._viewer.release()

    def _put(self, item: _Item) -> None:
        self._waiting.put(item)

    def _die(self, reason: str) -> None:
        if not self.is_dead:
            self.is_dead, self.dead_reason = True, reason

    def _work(self) -> None:
        next_check = time.monotonic()
        try:
            while not self._is_closing.is_set():
                self._collect()
                self._send_pending()
                if time.monotonic() >= next_check:
                    self._check_viewer()
                    next_check = time.monotonic() + _VIEWER_CHECK_EVERY_S
            self._collect()
            self._send_pending()
            self._check_viewer()
        except Exception as error:  # rerun is at fault, not the recording
            self._die(f"rerun failed: {error}")
        self._finish()

    def _finish(self) -> None:
        try:
            self._recording.flush(timeout_sec=2.0)
        except Exception as error:
            self._die(f"the last samples were not sent to the viewer: {error}")
        self._recording.disconnect()

    def _check_viewer(self) -> None:
        if self._viewer is not None and not self._viewer.is_running:
            self._die(self._viewer.why_ended())

    def _collect(self) -> None:
        """Wait for samples, at most `_SEND_EVERY_S`, and sort what came by channel."""
        deadline = time.monotonic() + _SEND_EVERY_S
        while True:
            left_s = deadline - time.monotonic()
            try:
                item = self._waiting.get(0.0 if self._is_closing.is_set() else max(left_s, 1e-3))
            except queue.Empty:
                return
            if isinstance(item, tuple):
                self._send_estimate(*item)
            elif isinstance(item, Event):
                log_event(self._recording, item)
            elif isinstance(item, SampleBlock):
                self._pending.setdefault(item.channel, []).append(item)
            if left_s <= 0 and not self._is_closing.is_set():
                return

    def _send_pending(self) -> None:
        for channel, blocks in self._pending.items():
            series = series_of(channel, blocks[0].unit, self._words)
            self._style_once(channel, blocks[0].unit)
            times, values = [], []
            for block in blocks:
                if not len(block.time_s):
                    continue
                if block.first_index != self._next_index.get(channel, block.first_index):
                    times.append(block.time_s[:1] - 1e-9)
                    values.append(np.array([np.nan]))
                self._next_index[channel] = block.first_index + len(block.time_s)
                keep = envelope_indices(block.time_s, block.values, max_rate_hz=_MAX_RATE_HZ)
                times.append(block.time_s[keep])
                values.append(block.values[keep])
                if channel == DISPLACEMENT.name:
                    self._send_stroke_rates(self._stroke_rate.update(block.time_s, block.values))
            if times:
                send_samples(self._recording, series.path, np.concatenate(times), np.concatenate(values))
        self._pending.clear()

    def _send_stroke_rates(self, rates: list[tuple[float, float]]) -> None:
        if rates:
            self._style_once("stroke_rate_hz", "Hz")
            found = np.asarray(rates, dtype=np.float64)
            send_samples(self._recording, STROKE_RATE_PATH, found[:, 0], found[:, 1])

    def _send_estimate(
        self, time_s: float, k_fc: float, std: float, remaining_s: float, remaining_std_s: float
    ) -> None:
        self._send_with_band(K_FC, time_s, k_fc, std)
        if math.isfinite(remaining_s):
            self._send_with_band(REMAINING, time_s, remaining_s, remaining_std_s)

    def _send_with_band(self, channel: str, time_s: float, value: float, std: float) -> None:
        series, at_s = series_of(channel), np.array([time_s])
        if channel not in self._styled:
            log_bounds_style(self._recording, series)
        self._style_once(channel, "")
        send_samples(self._recording, series.path, at_s, np.array([value]))
        if math.isfinite(std):
            send_samples(self._recording, f"{series.path}/lower", at_s, np.array([value - std]))
            send_samples(self._recording, f"{series.path}/upper", at_s, np.array([value + std]))

    def _style_once(self, channel: str, unit: str) -> None:
        if channel not in self._styled:
            self._styled.add(channel)
            log_style(self._recording, series_of(channel, unit, self._words))
