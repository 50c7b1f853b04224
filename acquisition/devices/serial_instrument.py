"""What the instruments on a serial port have in common: one link, one stream, bytes that are framed."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, Generic, Protocol, TypeVar

from pydantic import Field
from sawbench.acquisition.devices.device import BenchChannel, ChannelTable, Chunk, Stream
from sawbench.acquisition.devices.driver import Driver, InstrumentTable
from sawbench.acquisition.transports.serial_port import SerialPort
from sawbench.bench.errors import DeviceError

ANSWER_WAIT_S: Final = 0.2
_QUIET_WAIT_S: Final = 0.5


class SerialTable(InstrumentTable):
    """Keys of every instrument on a serial port.

    Attributes
    ----------
    channels : mapping of Channel to ChannelTable
        Bench channel -> input of the instrument (from 1), calibration, raw range.
    baud_rate : int
        Bit/s.
    """

    channels: dict[BenchChannel, ChannelTable] = Field(min_length=1)
    baud_rate: int = Field(default=115_200, gt=0)


class Framer(Protocol):
    """Whatever turns bytes into samples."""

    n_discarded_bytes: int


Settings = TypeVar("Settings", bound=SerialTable)
AnyFramer = TypeVar("AnyFramer", bound=Framer)


class SerialInstrument(Driver[Settings], Generic[Settings, AnyFramer]):
    """One instrument; see `devices.device.Device`. A driver adds `open`, `start` and `decode`.

    Parameters
    ----------
    name, settings, clock
        See `Driver`.
    framer : Framer
    rate_hz : float
        Samples per second; 0 where each sample has its own time.
    farewell : bytes
        Sent before the port is closed.
    parity : {"N", "E", "O"}
    """

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
    ) -> None:
        super().__init__(name, settings, clock)
        self._framer = framer
        self._rate_hz = rate_hz
        self._farewell = farewell
        self._discarded_before = 0
        self._link = SerialPort(
            settings.port,
            device=name,
            baud_rate=settings.baud_rate,
            parity=parity,
            serial_number=settings.adapter_number,
        )

    @property
    def streams(self) -> tuple[Stream, ...]:
        """One stream with all channels."""
        return self._one_stream(self._settings.channels, self._rate_hz)

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
                    f"still sends data {_QUIET_WAIT_S:g} s after the stop command",
                    "check port and baud_rate",
                )

    def _poll(self, question: bytes, answer: Callable[[bytes, float, float], list[Chunk]]) -> list[Chunk]:
        """Send `question`; return what `answer` makes of (bytes, asked s, arrival s); nothing after 0.2 s."""
        asked_s = self._clock()
        self._link.write(question)
        while self._clock() < asked_s + ANSWER_WAIT_S:
            if chunks := answer(self._link.read(), asked_s, self._clock()):
                return chunks
        return []
