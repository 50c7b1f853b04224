"""Writes one trial to MCAP so that the death of the program costs at most the last second."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import Final

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import LIBRARY_IDENTIFIER, CompressionType, Writer
from sawbench.bench.errors import InputError, RecordingError, WritingError
from sawbench.bench.recording import Event, SampleBlock, Trial
from sawbench.storage.codec import (
    EVENT_TOPIC,
    PREVIEW_TOPIC,
    PROFILE,
    SIGNAL_TOPIC,
    encode_block,
    encode_event,
    encode_preview,
    epoch_ns,
    log_time_ns,
    schema_data,
    trial_to_metadata,
)
from sawbench.storage.output import Output
from sawbench.storage.packed_index import pack_index
from sawbench.storage.preview import PreviewBuilder

MAX_PREVIEW_RATE_HZ: Final = 100.0
NO_START_TIME: Final = "the start of the trial is unknown; log times count from 1970-01-01"


def software_version() -> str:
    """Return the name and version written into files, for example "sawbench 0.1.0"."""
    try:
        return f"sawbench {version('sawbench')}"
    except PackageNotFoundError:
        return "sawbench (not installed)"


@dataclass(kw_only=True, slots=True)
class _Stream:
    """What the writer remembers about one channel."""

    device: str
    unit: str
    preview: PreviewBuilder
    n_blocks: int = 0
    topics: dict[str, int] = field(default_factory=dict)


class RecordingWriter:
    """Writes blocks and events of one trial to `<path>.part` and renames it to `path` when closed.

    Everything is flushed to the operating system every `flush_every_s`, by a thread of its own where nothing
    is written meanwhile, and then to the disk. May be used from several threads. Left with an exception, the
    context manager writes an event that names it and closes the file as not complete.

    Parameters
    ----------
    path : Path
        File to write, `.mcap`.
    trial : Trial
        Written at the start; its `started_at` is replaced by `started_at`.
    config_toml : str
        The bench configuration as text ("" if there is none).
    provenance : mapping of str to str
        Software, clock alignment, calibration, ...; the software version is added.
    started_at : datetime or None
        UTC of the recording's zero, timezone-aware. None where is unknown: log times then count from
        1970 and the provenance says so.
    preview_rate_hz : float
        Preview intervals a second, 0 to 100 Hz.
    flush_every_s : float
        Longest time that samples stay in memory, s.
    second_copy : Path, optional
        Folder that gets the same file; its failure is an event and never stops the recording.
    clock : callable
        Monotonic time in s.
    overwrite : bool
        Replace an existing `path` (only when the new one is closed). A `.part` file is never replaced.

    Raises
    ------
    RecordingError
        If `path` exists (without `overwrite`), or `<path>.part` exists, or the folder cannot be written to.
    InputError
        If a rate, a time or `started_at` is not allowed.

    Examples
    --------
    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> trial = Trial(trial_id="T1", material="oak")
    >>> with RecordingWriter(
    ...     path=folder / "T1.mcap", trial=trial, config_toml="", provenance={}, started_at=None
    ... ) as writer:
    ...     writer.write_event(Event(kind="note", time_s=0.0, text="new blade"))
    >>> sorted(path.name for path in folder.iterdir())
    ['T1.mcap']
    """

    # Size: options by name: what a file says of itself, and how often and where it is secured.
    def __init__(
        self,
        *,
        path: Path,
        trial: Trial,
        config_toml: str,
        provenance: Mapping[str, str],
        started_at: datetime | None,
        preview_rate_hz: float = 50.0,
        flush_every_s: float = 1.0,
        second_copy: Path | None = None,
        clock: Callable[[], float] = time.monotonic,
        overwrite: bool = False,
    ) -> None:
        if not 0 < preview_rate_hz <= MAX_PREVIEW_RATE_HZ:
            raise InputError(f"preview_rate_hz is {preview_rate_hz!r}, allowed is above 0 up to 100 Hz")
        if not flush_every_s > 0:
            raise InputError(f"flush_every_s is {flush_every_s!r}, allowed is above 0 s")
        self.path = Path(path)
        self._origin_ns = epoch_ns(started_at)
        self._preview_rate_hz = preview_rate_hz
        self._flush_every_s = flush_every_s
        self._clock = clock
        self._lock = threading.RLock()
        self._streams: dict[str, _Stream] = {}
        self._schema_ids: dict[str, int] = {}
        self._event_channel: int | None = None
        self._latest_s = 0.0
        self._is_dirty = False
        self._output: Output | None = Output(self.path, second_copy=second_copy, overwrite=overwrite)
        # The writer's Output has the three methods of a binary stream that the library calls.
        self._mcap = Writer(self._output, compression=CompressionType.ZSTD, enable_data_crcs=True)  # type: ignore[arg-type]
        pack_index(self._mcap)
        trial = replace(trial, started_at=started_at)
        self._write_settings(trial, config_toml, provenance)
        self._last_flush_s = clock()
        self._stopping = threading.Event()
        self._flusher = threading.Thread(target=self._flush_regularly, name="recording flush", daemon=True)
        self._flusher.start()

    def _write_settings(self, trial: Trial, config_toml: str, provenance: Mapping[str, str]) -> None:
        origin = {} if trial.started_at else {"log_time": NO_START_TIME}
        with self._disk() as output:
            self._mcap.start(profile=PROFILE, library=f"{software_version()} {LIBRARY_IDENTIFIER}")
            # Metadata records bypass the chunks: they are in the file from the first moment.
            self._mcap.add_metadata("trial", trial_to_metadata(trial))
            self._mcap.add_metadata("config", {"toml": config_toml})
            self._mcap.add_metadata("provenance", {"software": software_version(), **origin, **provenance})
            output.flush()
            output.sync()

    def write_block(self, block: SampleBlock) -> None:
        """Write consecutive samples of one channel; a block without samples is not written.

        Raises
        ------
        InputError
            If the channel's unit or device is another than in its first block.
        RecordingError
            If the file is closed; `WritingError` if it cannot be written, for example because the disk is full.
        """
        if not len(block.time_s):
            return
        message = encode_block(block, self._origin_ns)
        with self._disk():
            stream = self._stream_of(block)
            self._add(stream.topics["signal"], float(block.time_s[0]), message, stream.n_blocks)
            stream.n_blocks += 1
            for interval in stream.preview.add(block.time_s, block.values):
                self._add_preview(stream, interval)
            self._latest_s = max(self._latest_s, float(block.time_s[-1]))
            self._flush_if_due()

    def write_event(self, event: Event) -> None:
        """Write an event.

        Raises
        ------
        RecordingError
            As `write_block`.
        """
        with self._disk():
            if self._event_channel is None:
                self._event_channel = self._register(EVENT_TOPIC, "sawbench.Event")
            self._add(self._event_channel, event.time_s, encode_event(event, self._origin_ns))
            self._flush_if_due()

    def flush(self) -> None:
        """Hand everything written so far to the operating system."""
        with self._disk():
            self._flush()

    def close(self, provenance: Mapping[str, str] | None = None, is_complete: bool = True) -> Path:
        """Finish the file and give it its final name; a second call does nothing.

        Parameters
        ----------
        provenance : mapping of str to str, optional
            What only the end of the recording knows, for example the clock alignment; adds to, and
            replaces by key, what was given at the start.
        is_complete : bool
            False where the trial was interrupted.

        Returns
        -------
        Path
            The final name.

        Raises
        ------
        RecordingError
            If the file cannot be finished; what was written is in the `.part` file.
        """
        self._stopping.set()
        self._flusher.join()
        if self._output is None:
            return self.path
        with self._disk() as output:
            try:
                for stream in self._streams.values():
                    for interval in stream.preview.finish():
                        self._add_preview(stream, interval)
                self._flush()
                if provenance:
                    self._mcap.add_metadata("provenance", dict(provenance))
                self._mcap.add_metadata("finish", {"is_complete": str(is_complete).lower()})
                self._mcap.finish()
                return output.finish()
            except BaseException:
                with suppress(OSError):
                    output.abandon()
                raise
            finally:
                self._output = None

    @property
    def is_closed(self) -> bool:
        """Whether nothing more can be written."""
        return self._output is None

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None or self._output is None:
            self.close()
            return
        text = f"{kind.__name__}: {error}".strip(": ")
        # On a broken disk these fail again; the first error is the one to see.
        with suppress(RecordingError):
            self.write_event(Event(kind="interrupted", time_s=self._latest_s, text=text))
        with suppress(RecordingError):
            self.close(is_complete=False)

    @contextmanager
    def _disk(self) -> Iterator[Output]:
        """Hold the lock and turn a failing disk into an error that says what to do."""
        with self._lock:
            if self._output is None:
                raise RecordingError("the recording is already closed", where=self.path)
            try:
                yield self._output
            except OSError as error:
                kept = "the data written so far can be read with `sawbench recover`"
                raise WritingError.of(error, where=f"{self.path}.part", kept=kept) from error

    def _stream_of(self, block: SampleBlock) -> _Stream:
        stream = self._streams.get(block.channel)
        if stream is None:
            preview = PreviewBuilder(rate_hz=self._preview_rate_hz)
            stream = _Stream(device=block.device, unit=block.unit, preview=preview)
            about = {"unit": block.unit, "device": block.device}
            stream.topics["signal"] = self._register(SIGNAL_TOPIC + block.channel, "sawbench.SampleBlock", about)
            stream.topics["preview"] = self._register(PREVIEW_TOPIC + block.channel, "sawbench.Preview", about)
            self._streams[block.channel] = stream
        elif (stream.device, stream.unit) != (block.device, block.unit):
            raise InputError(
                f"block from {block.device!r} in {block.unit!r}, but its first block was from "
                f"{stream.device!r} in {stream.unit!r}",
                where=f"channel {block.channel}",
                remedy="assign one device and one unit to every channel in the configuration",
            )
        return stream

    def _register(self, topic: str, message_type: str, about: Mapping[str, str] | None = None) -> int:
        if message_type not in self._schema_ids:
            self._schema_ids[message_type] = self._mcap.register_schema(
                message_type, SchemaEncoding.Protobuf, schema_data(message_type)
            )
        channel_id = self._mcap.register_channel(
            topic, MessageEncoding.Protobuf, self._schema_ids[message_type], dict(about or {})
        )
        # Topics are announced inside a chunk; this copy lets the other chunks be read without that one.
        self._mcap.add_metadata("topic", {"id": str(channel_id), "topic": topic, "type": message_type})
        return channel_id

    def _add(self, channel_id: int, time_s: float, message: bytes, sequence: int = 0) -> None:
        log_time = log_time_ns(self._origin_ns, time_s)
        self._mcap.add_message(channel_id, log_time, message, log_time, sequence)
        self._is_dirty = True

    def _add_preview(self, stream: _Stream, interval: tuple[float, float, float, float]) -> None:
        message = encode_preview(interval, stream.unit, self._origin_ns)
        self._add(stream.topics["preview"], interval[0], message)

    def _flush_if_due(self, interval_s: float | None = None) -> None:
        due_s = self._flush_every_s if interval_s is None else interval_s
        if self._clock() - self._last_flush_s >= due_s:
            self._flush()

    def _flush(self) -> None:
        assert self._output is not None
        problem, self._output.copy_problem = self._output.copy_problem, None
        if problem is not None:
            self.write_event(Event(kind="warning", time_s=self._latest_s, text=problem))
        self._last_flush_s = self._clock()
        self._is_dirty = False
        self._mcap.flush()

    def _flush_regularly(self) -> None:
        """Flush what no later block pushes out, and bring it to the disk without holding anybody up."""
        # Looking four times an interval and flushing at half of it, nothing waits here for more than three quarters;
        # the last quarter is for the age that samples have when they come, and for a busy machine.
        look_every_s = self._flush_every_s / 4
        synced_s = self._last_flush_s
        while not self._stopping.wait(look_every_s):
            with self._lock:
                output = self._output
                if output is None:
                    return
                try:
                    if self._is_dirty:
                        self._flush_if_due(2 * look_every_s)
                except OSError:
                    return  # the next block meets the same error and reports it
                flushed_s = self._last_flush_s
            try:
                if flushed_s != synced_s:
                    output.sync()
                    synced_s = flushed_s
            except (OSError, ValueError):
                return  # a disk that cannot sync, or the file was closed meanwhile
