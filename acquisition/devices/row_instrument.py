"""An instrument that sends rows of numbers, as lines or frames, whatever its commands are."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.devices.device import Chunk, Stream
from sawbench.acquisition.devices.sample_rows import OWN_CLOCK, RowStream, RowTiming
from sawbench.acquisition.devices.serial_instrument import SerialInstrument, Settings

# A microcontroller restarts when its port is opened, and first waits for its boot loader, then takes its zero.
_FIRST_ROW_S: Final = 5.0


class Rows(NamedTuple):
    """Rows that came without a break.

    Attributes
    ----------
    values : ndarray, shape (n, n_columns)
    n_lost : int
        Rows before the first one that cannot be read; a lower bound.
    """

    values: NDArray[np.float64]
    n_lost: int


class RowFramer(Protocol):
    """Bytes in, rows out."""

    n_discarded_bytes: int

    def feed(self, received: bytes) -> list[Rows]:
        """Return the rows that `received` completes."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class RowProtocol:
    """What is sent and received.

    Attributes
    ----------
    new_framer : callable
        (whether the next byte begins a row) -> framer; its rows hold the channels in their order, and behind them the
        time stamp or the counter.
    timing : RowTiming
    question : bytes
        Asks for one row; empty where rows come without.
    start, stop : bytes
        Begin and end the transmission. Without `stop` it never ends, and `start` is sent once the port is open.
    """

    new_framer: Callable[[bool], RowFramer]
    timing: RowTiming
    question: bytes = b""
    start: bytes = b""
    stop: bytes = b""


class RowInstrument(SerialInstrument[Settings, RowFramer]):
    """One instrument; see `devices.device.Device`.

    Parameters
    ----------
    name, settings, clock, parity
        See `SerialInstrument`.
    protocol : RowProtocol
    """

    def __init__(
        self,
        name: str,
        settings: Settings,
        protocol: RowProtocol,
        *,
        clock: Callable[[], float] = time.monotonic,
        parity: str = "N",
    ) -> None:
        super().__init__(
            name,
            settings,
            protocol.new_framer(False),
            clock=clock,
            rate_hz=protocol.timing.rate_hz,
            farewell=protocol.stop,
            parity=parity,
        )
        self._protocol = protocol
        self._number = ""  # of the instrument, where a driver learns it
        self._rows = RowStream(self.STREAM, protocol.timing)

    @property
    def streams(self) -> tuple[Stream, ...]:
        """One stream with all channels."""
        (stream,) = super().streams
        is_stamped = self._protocol.timing.tick_s is not None
        return (replace(stream, own_time=OWN_CLOCK) if is_stamped else stream,)

    def open(self) -> None:
        """Connect, and see that it is quiet, answers or sends, whatever it does by itself; see `Device.open`."""
        self._link.open()
        self._open_dialogue()
        protocol = self._protocol
        self._renew(is_begun=bool(protocol.question or protocol.stop))
        if protocol.question and not self.read():
            raise self._no_answer(
                f"opens, but did not answer {protocol.question!r} as expected",
                "check power, baud_rate and the question, and that the configuration describes the answer",
            )
        if not protocol.question and not protocol.stop:
            self._wait_for_rows()

    def start(self) -> None:
        """Start the transmission; where it never ends, forget what came while other instruments were opened."""
        if self._protocol.stop:
            self._link.write(self._protocol.start)
        elif not self._protocol.question:
            self._link.drop_waiting()
            self._renew(is_begun=False)

    def read(self) -> list[Chunk]:
        """Return the samples that arrived, or ask for one; wait at most 0.1 s for the first byte of it."""
        if not self._protocol.question:
            return super().read()
        return self._poll(self._protocol.question, self.answer)

    def decode(self, received: bytes, arrival_s: float) -> list[Chunk]:
        """Turn received bytes into chunks; no input or output."""
        return [
            chunk
            for piece in self._framer.feed(received)
            for chunk in self._rows.chunks(piece.values, piece.n_lost, arrival_s)
        ]

    def answer(self, received: bytes, asked_s: float, arrival_s: float) -> list[Chunk]:
        """Turn the answer to a question into a chunk; its time is the middle between the two."""
        pieces = self._framer.feed(received)
        if not pieces:
            return []
        # Only the last line answers this question; an older one came too late to have a time.
        middle = np.array([0.5 * (asked_s + arrival_s)])
        raw = pieces[-1].values[-1:]
        return [Chunk(stream=self.STREAM, raw=raw, arrival_s=np.array([arrival_s]), time_s=middle)]

    def describe(self) -> dict[str, str]:
        """Model, rate, where its times come from, serial number where it is known."""
        timing = self._protocol.timing
        rate = {"rate_hz": f"{timing.rate_hz:g}"} if timing.rate_hz else {}
        polled = self._protocol.question
        words = "middle between question and answer" if polled else timing.words
        number = {"serial_number": self._number} if self._number else {}
        return {"model": self.MODEL, **rate, "time_source": words, **self._link.facts, **number}

    def _open_dialogue(self) -> None:
        """Stop the transmission, where there is a command for it; an instrument that tells its name adds questions."""
        if self._protocol.stop:
            self._link.write(self._protocol.stop)
            self._wait_until_quiet()

    def _ask_text(self, request: bytes, *, wait_s: float = 0.5) -> str:
        """Send a request and return the first line of the answer that is not empty; "" where none came."""
        self._link.write(request)
        received = b""
        deadline_s = self._clock() + wait_s
        while self._clock() < deadline_s:
            received += self._link.read()
            *whole, _ = received.replace(b"\n", b"\r").split(b"\r")
            for line in whole:
                if text := line.decode("ascii", "replace").strip():
                    return text
        return ""

    def _renew(self, *, is_begun: bool) -> None:
        self._begin_anew(self._protocol.new_framer(is_begun))
        self._rows = RowStream(self.STREAM, self._protocol.timing)

    def _wait_for_rows(self) -> None:
        """Wait until it sends; what it sent before the start was no measurement of ours."""
        self._link.write(self._protocol.start)
        begun_s = self._clock()
        while not self._framer.feed(self._link.read()):
            if self._clock() > begun_s + _FIRST_ROW_S:
                raise self._no_answer(
                    f"opens, but sent no readable data within {_FIRST_ROW_S:g} s",
                    "check power and baud_rate, and that the configuration describes what the instrument sends",
                )
        self._renew(is_begun=False)


def columns_of(inputs: Sequence[int], behind: int | None) -> tuple[int, ...]:
    """Columns that are read: those of the channels, then that of the stamp or the counter."""
    return (*inputs, *(() if behind is None else (behind,)))
