"""One thread a device: reads it, notices silence, reconnects; never touches the recording."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from sawbench.acquisition.devices.device import Chunk, Device, Receiver, joined
from sawbench.bench.errors import DeviceError, OtherInstrumentError

_FIRST_PAUSE_S: Final = 0.1
_LONGEST_PAUSE_S: Final = 2.0
_QUEUE_WAIT_S: Final = 0.2
_SERIAL_NUMBER: Final = "serial_number"
# So many samples, and values in them, may gather: adapters and systems hand out a few kilobytes at a time.
_GATHERED_SAMPLES: Final = 400
_GATHERED_VALUES: Final = 1000
# Timing and writing cost more than a read: what gathered so many times is handed on together.
_GATHERED_TIMES: Final = 3
# Slower instruments are read as they send; and all are while the clock settles, which wants every arrival.
_GATHER_FROM_HZ: Final = 200.0
_EAGER_S: Final = 3.0
# Samples that come later than they may gather, by so much, are behind: they are read without a pause.
_BEHIND_S: Final = 0.05
_WINDOW_S: Final = 5.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Samples:
    """What one read returned."""

    device: str
    chunks: list[Chunk]


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkLost:
    """The device is gone or silent."""

    device: str
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkBack:
    """The device answers again."""

    device: str


Message = Samples | LinkLost | LinkBack


class DeviceReader(threading.Thread):
    """Move chunks from an opened and started device to `messages` until told to stop.

    Parameters
    ----------
    device : Device
        Open and started; the thread stops it at the end.
    messages : Queue
        Bounded: a writer that is too slow makes this thread wait, and the instrument's buffer overflow, which
        then shows as a gap.
    clock : callable
        Monotonic seconds.
    silence_s : float
        Without a sample for this long the link counts as lost.
    gather_s : float
        Samples that the instrument sends by itself may gather for so long before they are read: waking up costs more
        than they do. What follows them is waited for, so that the arrival of the newest is known. 0: read as they come.
    """

    def __init__(
        self,
        device: Device,
        messages: queue.Queue[Message],
        *,
        clock: Callable[[], float],
        silence_s: float,
        gather_s: float = 0.0,
    ) -> None:
        super().__init__(name=f"read {device.name}", daemon=True)
        self.device = device
        self._receiver: Receiver = device if isinstance(device, Receiver) else _Reads(device)
        self.n_reconnects = 0
        self._messages = messages
        self._clock = clock
        self._silence_s = silence_s
        self._stopping = threading.Event()
        self._gather_s = _gather_s(device, gather_s)
        self._lag = _Lag(device)
        self._serial_number = device.describe().get(_SERIAL_NUMBER)

    def stop(self) -> None:
        """Ask the thread to end; it stops the device."""
        self._stopping.set()

    def run(self) -> None:
        """Read until stopped."""
        try:
            self._read_and_reconnect()
        except Exception as error:
            # A fault in a driver must not end the other instruments' recording.
            reason = f"driver failed: {error!r}; it is not tried again in this recording"
            self._send(LinkLost(device=self.device.name, reason=reason))
        finally:
            self.device.stop()

    def _read_and_reconnect(self) -> None:
        while not self._stopping.is_set():
            try:
                self._read_until_lost()
            except DeviceError as error:
                self._send(LinkLost(device=self.device.name, reason=error.what))
                self._reconnect()

    def _read_until_lost(self) -> None:
        begun_s = latest_s = self._clock()
        self._lag.begin()
        while not self._stopping.is_set():
            may_gather = self._gather_s > 0 and not self._lag.is_behind and self._clock() - begun_s > _EAGER_S
            chunks = self._gathered() if may_gather else self.device.read()
            now_s = self._clock()
            if chunks:
                latest_s = now_s
                self._lag.take(chunks, now_s)
                self._send(Samples(device=self.device.name, chunks=chunks))
            elif now_s - latest_s > self._silence_s:
                raise DeviceError(f"sent nothing for {now_s - latest_s:.1f} s", where=self.device.name)

    def _gathered(self) -> list[Chunk]:
        """Let samples gather, receive them, some times; wait for those behind them, whose arrival is then known."""
        try:
            for _ in range(_GATHERED_TIMES):
                time.sleep(self._gather_s)
                self._receiver.receive()
            self._receiver.receive()
        except DeviceError:
            self._send(Samples(device=self.device.name, chunks=self._receiver.decoded()))
            raise
        return self._receiver.decoded()

    def _reconnect(self) -> None:
        pause_s = _FIRST_PAUSE_S
        self.device.stop()
        said: set[str] = set()
        while not self._stopping.wait(pause_s):
            try:
                self.device.open()
                self._require_same_instrument()
                self.device.start()
            except Exception as error:
                # Still away: this is what the pause is for. The gap is in the record since the link was lost.
                self.device.stop()
                pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)
                reason = _beyond_absence(error)
                if reason is not None and reason not in said:
                    said.add(reason)
                    self._send(LinkLost(device=self.device.name, reason=reason))
                continue
            self.n_reconnects += 1
            self._send(LinkBack(device=self.device.name))
            return

    def _require_same_instrument(self) -> None:
        present = self.device.describe().get(_SERIAL_NUMBER)
        if present != self._serial_number:
            raise OtherInstrumentError(
                f"another instrument is at {self.device.port}: its serial number is {present}, "
                f"the recording began with {self._serial_number}",
                where=self.device.name,
            )

    def _send(self, message: Message) -> None:
        while not self._stopping.is_set():
            try:
                self._messages.put(message, timeout=_QUEUE_WAIT_S)
            except queue.Full:
                continue
            return


def _beyond_absence(error: Exception) -> str | None:
    """What keeps a device from being taken up again, if it is not just away."""
    if isinstance(error, OtherInstrumentError):
        return error.what
    return None if isinstance(error, DeviceError) else f"driver failed: {error!r}"


class _Reads:
    """A device that decodes what it reads at once, as a receiver."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._chunks: list[Chunk] = []

    def receive(self) -> None:
        """Read once."""
        self._chunks = joined(self._chunks, self._device.read())

    def decoded(self) -> list[Chunk]:
        """Give what was read since the last call."""
        chunks, self._chunks = self._chunks, []
        return chunks


class _Lag:
    """How far the newest sample is behind, against the least of the last seconds.

    A read may return only a part of what waits, as systems hand out a few kilobytes at a time: who pauses behind such a
    read falls back further.
    """

    def __init__(self, device: Device) -> None:
        self._stream, self._rate_hz = next(((s.name, s.rate_hz) for s in device.streams), ("", 0.0))
        self.begin()

    def begin(self) -> None:
        """Count again: the instrument has just been started."""
        self._n = 0
        self._least_s = self._least_before_s = np.inf
        self._window_s = -np.inf
        self.is_behind = False

    def take(self, chunks: Sequence[Chunk], now_s: float) -> None:
        """Count the samples of the first stream among what was read at `now_s`."""
        if self._rate_hz <= 0:
            return
        self._n += sum(len(chunk.raw) + chunk.n_lost for chunk in chunks if chunk.stream == self._stream)
        behind_s = now_s - self._n / self._rate_hz
        if now_s > self._window_s + _WINDOW_S:
            # What was lost stays away: only the last seconds count.
            self._window_s, self._least_before_s, self._least_s = now_s, self._least_s, np.inf
        self._least_s = min(self._least_s, behind_s)
        self.is_behind = behind_s > min(self._least_s, self._least_before_s) + _BEHIND_S


def _gather_s(device: Device, longest_s: float) -> float:
    """How long samples of a device may gather before they are read, s."""
    rates_hz = [stream.rate_hz for stream in device.streams]
    if not rates_hz or min(rates_hz) < _GATHER_FROM_HZ:
        return 0.0
    values_a_s = sum(stream.rate_hz * len(stream.channels) for stream in device.streams)
    return min(longest_s, _GATHERED_SAMPLES / max(rates_hz), _GATHERED_VALUES / values_a_s)
