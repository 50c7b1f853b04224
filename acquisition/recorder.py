"""Record: devices -> common clock -> writer, with a live view that can never stand in the way.

Each device is read by a thread of its own; one loop, in the caller's thread, times, calibrates and writes.
Recording begins (t = 0) when every stream delivers and its clock has settled; samples from before are
dropped. A device that goes away is noted as a gap and taken up again, into the same file, when it returns.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final, Literal

from sawbench.acquisition.busy_watch import BusyWatch
from sawbench.acquisition.device_reader import DeviceReader, LinkBack, LinkLost, Message, Samples
from sawbench.acquisition.devices.device import Device
from sawbench.acquisition.end_signals import EndSignals
from sawbench.acquisition.live_warnings import LiveWarnings
from sawbench.acquisition.observers import Observer, ObserverFeed
from sawbench.acquisition.pre_trigger import Touch, TouchWatch
from sawbench.acquisition.recording_report import (
    BlockWriter,
    DeviceSummary,
    RecordingStart,
    RecordingStatus,
    RecordingSummary,
)
from sawbench.acquisition.stream_recorder import OUTSIDE, SILENT_PERIODS, StreamRecorder
from sawbench.bench.errors import DeviceError, InputError
from sawbench.bench.recording import Event, SampleBlock

_WAIT_S: Final = 0.05
# Where samples may gather, reads of all instruments do too: waking up for each costs more than it holds.
_TAKE_EVERY_S: Final = 0.1
_JOIN_S: Final = 3.0
# A touch is seen this late at most: samples wait while a link is late.
_LATEST_TOUCH_S: Final = 3.0

WriterOrFactory = BlockWriter | Callable[[RecordingStart], BlockWriter]


@dataclass(frozen=True, kw_only=True, slots=True)
class RecorderLimits:
    """Times after which the recorder acts, s, and how far it may fall behind.

    Attributes
    ----------
    first_sample_s : float
        A stream must deliver within this, and a period, after its start.
    settle_s : float
        All clocks must have settled within this, and the periods that they need.
    rate_s : float
        A rate that seems wrong is watched for this long: after a moment in which the machine was busy it looks so too.
    silence_s : float
        Silence that counts as a lost link, where it is longer than three periods.
    all_lost_s : float
        Recording ends when no device delivered for this long.
    grace_s : float
        Wait for stragglers after the asked duration.
    status_every_s : float
    queue_length : int
        Reads that may wait for the writer; a reader that is further ahead waits itself.
    gather_s : float
        Samples that an instrument sends by itself may gather for so long before they are read; see `DeviceReader`.
    preload_n : float, optional
        Force above which the carriage lifts off; see `LiveWarnings`.
    folder : Path, optional
        Whose disk must have space.
    touch : Touch, optional
        Recording begins when the blade touches, some seconds in the past.
    """

    first_sample_s: float = 2.0
    settle_s: float = 6.0
    rate_s: float = 3.0
    silence_s: float = 2.5
    all_lost_s: float = 10.0
    grace_s: float = 2.0
    status_every_s: float = 0.2
    queue_length: int = 8192
    gather_s: float = 0.04
    preload_n: float | None = None
    folder: Path | None = None
    touch: Touch | None = None


# Size: options by name: what ends a recording, who watches it, and what stands in for clock and threads in a test.
def record(
    devices: Sequence[Device],
    writer: WriterOrFactory,
    *,
    seconds: float | None = None,
    stop: threading.Event | None = None,
    observers: Iterable[Observer] = (),
    status: Callable[[RecordingStatus], object] | None = None,
    clock: Callable[[], float] = time.monotonic,
    limits: RecorderLimits | None = None,
    between_rounds: Callable[[], object] | None = None,
) -> RecordingSummary:
    """Record until `seconds` are full, `stop` is set, Ctrl-C, or every instrument is gone.

    Parameters
    ----------
    devices : sequence of Device
        Not opened yet; they are stopped when this returns or raises.
    writer : BlockWriter, or callable RecordingStart -> BlockWriter
        A callable is called at t = 0, when start time, alignment and calibration are known. It is closed at the end;
        where this raises, that is up to the caller.
    seconds : float, optional
        Without it, until stopped.
    stop : threading.Event, optional
    observers : iterable of callable
        See `ObserverFeed`.
    status : callable, optional
        Called about five times a second with `RecordingStatus`; an exception in it ends its calls, not the
        recording.
    clock : callable
        Monotonic seconds; the same that the devices use.
    limits : RecorderLimits, optional
    between_rounds : callable, optional
        For devices whose time is scripted: they are read in turn in this thread, and this is called before every round.

    Raises
    ------
    DeviceError
        If at the start a device is missing, silent, or sends at another rate than configured.
    InputError
        If there is no device or `seconds` is not positive.
    KeyboardInterrupt
        By Ctrl-C before t = 0 or once the end has come, and by one a second or more after the first.
    """
    if not devices:
        raise InputError("there is no instrument to record", remedy="add a [devices.*] table to the configuration")
    if seconds is not None and not seconds > 0:
        raise InputError(f"seconds is {seconds!r}, it must be greater than 0")
    run = _Run(devices, observers, clock, limits or RecorderLimits(), between_rounds)
    try:
        run.start_devices()
        run.wait_until_settled(stop)
        touched_s = run.wait_for_touch(stop)
        with EndSignals() as signals:
            start = run.begin(seconds, touched_s)
            target = writer if isinstance(writer, BlockWriter) else writer(start)
            summary = run.loop(target, start, seconds, stop, status, signals)
            target.close(provenance=summary.provenance, is_complete=summary.is_complete)
        return summary
    finally:
        run.close()


class _Run:
    """State of one recording."""

    def __init__(
        self,
        devices: Sequence[Device],
        observers: Iterable[Observer],
        clock: Callable[[], float],
        limits: RecorderLimits,
        between_rounds: Callable[[], object] | None,
    ) -> None:
        self._devices = list(devices)
        self._between_rounds = between_rounds
        self._clock = clock
        self._is_real_time = clock is time.monotonic
        # Simulated time waits for nobody: it does not stand still while samples gather.
        self._gather_s = limits.gather_s if self._is_real_time else 0.0
        self._limits = limits
        self._messages: queue.Queue[Message] = queue.Queue(limits.queue_length)
        self._readers: list[DeviceReader] = []
        self._streams: dict[tuple[str, str], StreamRecorder] = {}
        self._lost: dict[str, str] = {}
        self._feed = ObserverFeed(observers)
        self._discarded_at_start: dict[str, int] = {}
        self._zero_s = 0.0
        self._latest_data_s = 0.0
        self._pending: deque[SampleBlock | Event] = deque()
        self._warnings: LiveWarnings | None = None
        self._busy = BusyWatch()

    def start_devices(self) -> None:
        """Open all, then start all; DeviceError names the first that fails."""
        for device in self._devices:
            device.open()
        for device in self._devices:
            for stream in device.streams:
                self._streams[device.name, stream.name] = StreamRecorder(device.name, stream)
        for device in self._devices:
            device.start()
            period_s = min((stream.period_s for stream in device.streams), default=0.0)
            silence_s = max(self._limits.silence_s, SILENT_PERIODS * period_s)
            reader = DeviceReader(
                device, self._messages, clock=self._clock, silence_s=silence_s, gather_s=self._gather_s
            )
            self._readers.append(reader)
        for reader in self._readers if self._between_rounds is None else ():
            reader.start()
        if self._is_real_time:
            self._busy.start()

    def wait_until_settled(self, stop: threading.Event | None) -> None:
        """Wait until every stream delivers and its clock has settled."""
        begun_s = self._clock()
        while not self._is_ready(self._clock() - begun_s):
            self._take_next(stop, before="the recording began")
            waited_s = self._clock() - begun_s
            for (device, _), recorder in self._streams.items():
                if problem := recorder.timer.overdue(
                    waited_s, first_sample_s=self._limits.first_sample_s, settle_s=self._limits.settle_s
                ):
                    raise DeviceError(
                        problem, where=self._where(device), remedy="check power, transmission, port, rate and settings"
                    )
        for (device, _), recorder in self._streams.items():
            if problem := recorder.timer.rate_error():
                raise DeviceError(
                    problem,
                    where=self._where(device),
                    remedy="set the rate in the configuration to the rate of the instrument",
                )

    def _is_ready(self, waited_s: float) -> bool:
        timers = [recorder.timer for recorder in self._streams.values()]
        if not all(timer.is_settled and timer.has_data for timer in timers):
            return False
        return waited_s >= self._limits.rate_s or not any(timer.rate_error() for timer in timers)

    def wait_for_touch(self, stop: threading.Event | None) -> float | None:
        """Wait until the blade touches; return the monotonic time of t = 0, None where nothing is waited for."""
        touch = self._limits.touch
        if touch is None:
            return None
        recorder, column = self._stream_with(touch.channel)
        watch = TouchWatch(touch, recorder.stream.channels[column])
        for each in self._streams.values():
            each.keep(touch.before_s + _LATEST_TOUCH_S)
        seen_s = -float("inf")
        while True:
            self._take_next(stop, before="the contact")
            for block in recorder.kept:
                if block.time_s[-1] <= seen_s:
                    continue
                seen_s = float(block.time_s[-1])
                touched_s = watch.first_above(block.time_s, block.raw[:, column])
                if touched_s is not None:
                    return self._zero_before(touch, touched_s)

    def _take_next(self, stop: threading.Event | None, *, before: str) -> None:
        """Take one message while nothing is recorded yet: a link that is lost, or a stop, ends it."""
        if stop is not None and stop.is_set():
            raise InputError(f"stopped before {before}")
        message = self._next_message()
        if isinstance(message, LinkLost):
            where, remedy = self._where(message.device), "check cable and power, then start again"
            raise DeviceError(message.reason, where=where, remedy=remedy)
        if message is not None:
            self._take(message)

    def _stream_with(self, channel: str) -> tuple[StreamRecorder, int]:
        for recorder in self._streams.values():
            names = [c.name for c in recorder.stream.channels]
            if channel in names:
                return recorder, names.index(channel)
        raise InputError(f"no instrument provides {channel}, so the contact cannot be detected")

    def _zero_before(self, touch: Touch, touched_s: float) -> float:
        """Return t = 0: `before_s` before the touch, or later where not every stream reaches back that far."""
        first_s = [float(recorder.kept[0].time_s[0]) for recorder in self._streams.values() if recorder.kept]
        zero_s = max([touched_s - touch.before_s, *first_s])
        text = f"{touch.channel} above {touch.above:g} at {touched_s - zero_s:.3f} s: contact of the blade"
        self._pending.append(Event(kind="trigger", time_s=touched_s - zero_s, text=text, channel=touch.channel))
        return zero_s

    def begin(self, seconds: float | None, zero_s: float | None = None) -> RecordingStart:
        """Set t = 0 to `zero_s` (monotonic), to now without it."""
        self._latest_data_s = self._clock()
        self._zero_s = self._latest_data_s if zero_s is None else zero_s
        begun = [item for recorder in self._streams.values() for item in recorder.begin(self._zero_s, seconds)]
        self._pending.extend(begun)
        self._discarded_at_start = {d.name: d.n_discarded_bytes for d in self._devices}
        self._warnings = LiveWarnings(
            {key: recorder.stream for key, recorder in self._streams.items()},
            preload_n=self._limits.preload_n,
            folder=self._limits.folder,
            busy=self._busy.words,
            overloads=lambda: {d.name: int(d.describe().get("n_overloads", "0")) for d in self._devices},
        )
        started_at = datetime.now(UTC) - timedelta(seconds=self._latest_data_s - self._zero_s)
        return RecordingStart(started_at=started_at, provenance=self._provenance())

    def loop(
        self,
        writer: BlockWriter,
        start: RecordingStart,
        seconds: float | None,
        stop: threading.Event | None,
        status: Callable[[RecordingStatus], object] | None,
        signals: EndSignals,
    ) -> RecordingSummary:
        """Move everything from the readers to the writer until the end."""
        self._pending.appendleft(Event(kind="start", time_s=0.0, text=f"t = 0 at {start.started_at.isoformat()}"))
        for (device, stream), recorder in self._streams.items():
            text = f"clock of {stream}: {recorder.timer.statement()}"
            self._pending.append(Event(kind="device", time_s=0.0, text=text, device=device))
        next_status_s = self._clock()
        reason: tuple[Literal["stop", "interrupted"], str] | None = None
        while reason is None:
            message = self._next_message()
            if message is not None:
                self._pending += self._take(message)
            self._warn()
            self._write(writer)
            if status is not None and self._clock() >= next_status_s:
                next_status_s = self._clock() + self._limits.status_every_s
                status = self._report(status)
            words = signals.take()
            reason = self._end_reason(seconds, stop) if words is None else ("stop", words)
        if status is not None:
            self._report(status, phase="finishing")
        return self._finish(writer, start, *reason, seconds)

    def close(self) -> None:
        """Stop threads and devices."""
        self._busy.stop()
        for reader in self._readers:
            reader.stop()
        started = {reader.device.name for reader in self._readers if reader.ident is not None}
        for device in self._devices:
            if device.name not in started:
                device.stop()
        for reader in self._readers:
            if reader.ident is not None:
                reader.join(_JOIN_S)
        self._feed.close()

    def _next_message(self) -> Message | None:
        if self._between_rounds is not None and self._messages.empty():
            self._between_rounds()
            for device in self._devices:
                self._messages.put(Samples(device=device.name, chunks=device.read()))
        elif self._gather_s and self._messages.empty():
            time.sleep(_TAKE_EVERY_S)
        try:
            return self._messages.get(timeout=_WAIT_S)
        except queue.Empty:
            return None

    def _take(self, message: Message) -> list[SampleBlock | Event]:
        if isinstance(message, Samples):
            self._latest_data_s = self._clock()
            out: list[SampleBlock | Event] = []
            for chunk in message.chunks:
                out += self._streams[message.device, chunk.stream].push(chunk)
            return [self._blamed(item) for item in out]
        if isinstance(message, LinkBack):
            reason = self._lost.pop(message.device, "")
            return [self._event("device", f"link is back ({reason})", message.device)]
        out = [self._event("device", f"link lost: {message.reason}", message.device)]
        self._lost[message.device] = message.reason
        for (device, _), recorder in self._streams.items():
            if device == message.device:
                out += recorder.link_lost(message.reason)
        return [self._blamed(item) for item in out]

    def _blamed(self, item: SampleBlock | Event) -> SampleBlock | Event:
        """Add to what says that samples are late or lost that this computer is the reason, where it is."""
        if isinstance(item, SampleBlock) or OUTSIDE in item.text or not (why := self._busy.words()):
            return item
        return replace(item, text=f"{item.text} ({why})")

    def _warn(self) -> None:
        """Judge what was recorded so far; a mistake in that ends the warnings, never the recording."""
        if self._warnings is None:
            return
        try:
            for item in self._pending:
                self._warnings.take(item)
            self._pending += self._warnings.check(
                self._clock() - self._zero_s,
                lambda: {key: recorder.timer.drift_ppm() for key, recorder in self._streams.items()},
            )
        except Exception as error:
            self._warnings = None
            self._pending.append(self._event("warning", f"live warnings stopped: {error!r}"))

    def _write(self, writer: BlockWriter) -> None:
        for text in self._feed.failures():
            self._pending.append(self._event("warning", text))
        while self._pending:
            item = self._pending.popleft()
            if isinstance(item, SampleBlock):
                writer.write_block(item)
            else:
                writer.write_event(item)
            self._feed.offer(item)

    def _report(
        self, status: Callable[[RecordingStatus], object], phase: Literal["recording", "finishing"] = "recording"
    ) -> Callable[[RecordingStatus], object] | None:
        channels = tuple(c for r in self._streams.values() for c in r.status())
        try:
            status(
                RecordingStatus(
                    elapsed_s=self._clock() - self._zero_s,
                    channels=channels,
                    lost_devices=tuple(self._lost),
                    warnings=() if self._warnings is None else self._warnings.active,
                    is_spoilt=self._warnings is not None and self._warnings.is_spoilt,
                    phase=phase,
                )
            )
        except Exception as error:
            self._pending.append(self._event("warning", f"status display stopped: {error!r}"))
            return None
        return status

    def _end_reason(
        self, seconds: float | None, stop: threading.Event | None
    ) -> tuple[Literal["stop", "interrupted"], str] | None:
        now_s = self._clock()
        if stop is not None and stop.is_set():
            return "stop", "stopped by the operator"
        if seconds is not None:
            everyone_there = all(r.reached_s >= seconds for r in self._streams.values())
            if everyone_there or now_s > self._zero_s + seconds + self._limits.grace_s:
                return "stop", f"{seconds:g} s recorded"
            alive = [r for (d, _), r in self._streams.items() if d not in self._lost]
            if now_s > self._zero_s + seconds and all(r.reached_s >= seconds for r in alive):
                return "stop", f"{seconds:g} s recorded"
        if now_s - self._latest_data_s > self._limits.all_lost_s:
            return "interrupted", f"no instrument sent data for {self._limits.all_lost_s:g} s"
        return None

    def _finish(
        self,
        writer: BlockWriter,
        start: RecordingStart,
        kind: Literal["stop", "interrupted"],
        reason: str,
        seconds: float | None,
    ) -> RecordingSummary:
        now_s = self._clock() - self._zero_s
        for _ in range(self._messages.qsize()):
            self._pending += self._take(self._messages.get())
        end_s = now_s if seconds is None else min(seconds, now_s)
        for (device, _), recorder in self._streams.items():
            why = self._lost.get(device, "the samples had not arrived when the recording ended")
            self._pending += recorder.finish(end_s, why)
        self._pending.append(Event(kind=kind, time_s=end_s, text=reason))
        self._write(writer)
        channels = tuple(c for r in self._streams.values() for c in r.status())
        return RecordingSummary(
            started_at=start.started_at,
            duration_s=min(end_s, max((r.reached_s for r in self._streams.values()), default=0.0)),
            end_reason=reason,
            is_complete=kind == "stop" and not any(r.is_cut_short for r in self._streams.values()),
            channels=channels,
            devices=tuple(self._device_summary(reader) for reader in self._readers),
            n_dropped_for_observers=self._feed.n_dropped,
            provenance=self._provenance(),
        )

    def _device_summary(self, reader: DeviceReader) -> DeviceSummary:
        device = reader.device
        return DeviceSummary(
            device=device.name,
            port=device.port,
            n_discarded_bytes=device.n_discarded_bytes - self._discarded_at_start[device.name],
            n_reconnects=reader.n_reconnects,
            facts=device.describe(),
        )

    def _provenance(self) -> dict[str, str]:
        facts = {"clock": "t = 0 when every instrument streamed; all channels on the recording machine's own clock"}
        for (device, stream), recorder in self._streams.items():
            facts[f"alignment {device} {stream}"] = recorder.timer.statement()
            alignment = recorder.timer.alignment
            for channel in recorder.stream.channels:
                if alignment is not None:
                    facts |= alignment.entry(channel.name)
                facts[f"calibration {channel.name}"] = channel.calibration.statement(channel.name, channel.unit)
                facts[f"calibration values {channel.name}"] = channel.calibration.model_dump_json(exclude_none=True)
        for device in self._devices:
            for key, value in device.describe().items():
                facts[f"{device.name} {key}"] = value
        return facts

    def _event(self, kind: Literal["start", "device", "warning"], text: str, device: str = "") -> Event:
        return Event(kind=kind, time_s=max(0.0, self._clock() - self._zero_s), text=text, device=device)

    def _where(self, name: str) -> str:
        port = next(device.port for device in self._devices if device.name == name)
        return f"{name} on {port}"
