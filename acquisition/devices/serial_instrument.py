"""What the instruments on a serial port have in common: one link, one stream, bytes that are framed."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Final, Generic, Protocol, TypeVar

from sawbench.acquisition.devices.device import ChannelTable, Chunk, Stream
from sawbench.acquisition.transports.serial_port import SerialPort
from sawbench.bench.errors import DeviceError, NoAnswerError, OtherInstrumentError
from sawbench.bench.units import Channel

ANSWER_WAIT_S: Final = 0.2
_QUIET_WAIT_S: Final = 0.5


class SerialSettings(Protocol):
    """What the settings of every instrument on a serial port hold."""

    @property
    def port(self) -> str:
        """Serial port or pyserial URL."""
        ...

    @property
    def baud_rate(self) -> int:
        """Bit/s."""
        ...

    @property
    def serial_number(self) -> str | None:
        """Of the instrument, or of the adapter at the port."""
        ...

    @property
    def channels(self) -> Mapping[Channel, ChannelTable]:
        """Channels with their inputs."""
        ...


class Framer(Protocol):
    """Whatever turns bytes into samples."""

    n_discarded_bytes: int


Settings = TypeVar("Settings", bound=SerialSettings)
AnyFramer = TypeVar("AnyFramer", bound=Framer)


class SerialInstrument(Generic[Settings, AnyFramer]):
    """One instrument; see `devices.device.Device`. A driver adds `open`, `start` and `decode`.

    Parameters
    ----------
    name : str
        Of the device table.
    settings : SerialSettings
    framer : Framer
    clock : callable
        Monotonic seconds; stamps the arrival of samples.
    rate_hz : float
        Samples per second; 0 where each sample has its own time.
    farewell : bytes
        Sent before the port is closed.
    parity : {"N", "E", "O"}
    has_own_number : bool
        The instrument states a serial number of its own, which the driver compares; otherwise that of the USB adapter
        is compared.
    """

    MODEL = ""
    STREAM = "frames"

    def __init__(
        self,
        name: str,
        settings: Settings,
        framer: AnyFramer,
        *,
        clock: Callable[[], float] = time.monotonic,
        rate_hz: float = 0.0,
        farewell: bytes = b"",
        parity: str = "N",
        has_own_number: bool = False,
    ) -> None:
        self.name = name
        self.port = settings.port
        self._settings = settings
        self._framer = framer
        self._clock = clock
        self._rate_hz = rate_hz
        self._farewell = farewell
        self._discarded_before = 0
        self._link = SerialPort(
            settings.port,
            device=name,
            baud_rate=settings.baud_rate,
            parity=parity,
            serial_number=None if has_own_number else settings.serial_number,
        )

    @property
    def streams(self) -> tuple[Stream, ...]:
        """One stream with all channels."""
        channels = tuple(table.stream_channel(channel) for channel, table in self._settings.channels.items())
        return (Stream(name=self.STREAM, rate_hz=self._rate_hz, channels=channels),)

    @property
    def n_discarded_bytes(self) -> int:
        """Received bytes that were part of no valid frame, since construction."""
        return self._discarded_before + self._framer.n_discarded_bytes

    def read(self) -> list[Chunk]:
        """Return the samples that arrived; wait at most 0.1 s for the first byte."""
        return self.decode(self._link.read(), self._clock())

    def decode(self, received: bytes, arrival_s: float) -> list[Chunk]:
        """Turn received bytes into chunks; no input or output."""
        raise NotImplementedError

    def stop(self) -> None:
        """Stop the transmission and close the port."""
        try:
            if self._farewell:
                self._link.write(self._farewell)
        except DeviceError:
            # Unplugged or never opened: nothing is left to be told to stop.
            pass
        finally:
            self._link.close()

    def _begin_anew(self, framer: AnyFramer) -> None:
        """Frame what comes from now on with `framer`; the count of discarded bytes goes on."""
        self._discarded_before = self.n_discarded_bytes
        self._framer = framer

    def _wait_until_quiet(self) -> None:
        """Read away what was on its way when the instrument was told to stop: it is no measurement of ours."""
        deadline_s = self._clock() + _QUIET_WAIT_S
        while self._link.read():
            if self._clock() > deadline_s:
                raise self._error(
                    f"goes on sending {_QUIET_WAIT_S:g} s after it was told to stop",
                    "check that this port belongs to it, and that baud_rate is its own",
                )

    def _poll(self, question: bytes, answer: Callable[[bytes, float, float], list[Chunk]]) -> list[Chunk]:
        """Send `question`; return what `answer` makes of (bytes, asked s, arrival s); nothing after 0.2 s."""
        asked_s = self._clock()
        self._link.write(question)
        while self._clock() < asked_s + ANSWER_WAIT_S:
            if chunks := answer(self._link.read(), asked_s, self._clock()):
                return chunks
        return []

    def _require_number(self, present: str) -> None:
        """Refuse another instrument than the one whose own serial number the configuration names."""
        wanted = self._settings.serial_number
        if wanted not in {None, present}:
            raise OtherInstrumentError(
                f"another instrument is at this port: its serial number is {present or 'not known'}, "
                f"the configuration names {wanted}",
                where=self._where,
                remedy=f"change the plugs, or correct `port` or `serial_number` in [devices.{self.name}]",
            )

    @property
    def _where(self) -> str:
        return f"{self.name} ({self.MODEL}) on {self.port}"

    def _error(self, what: str, remedy: str) -> DeviceError:
        return DeviceError(what, where=self._where, remedy=remedy)

    def _no_answer(self, what: str, remedy: str) -> NoAnswerError:
        return NoAnswerError(what, where=self._where, remedy=remedy)
