"""Micro-Epsilon induSENSOR MSC7xxx inductive displacement controller, polled over RS485.

One question, one value: about 330 Hz at 256 kBd. For a stroke of a jigsaw read the analogue output with a
fast amplifier instead (`gsv8`); this driver is for slower machines and for checking the sensor.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from pydantic import Field
from sawbench.acquisition.devices.device import Chunk, OneChannel
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.msc7xxx_emulator import Msc7xxxEmulator
from sawbench.acquisition.devices.serial_instrument import SerialInstrument, SerialTable
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sensor import EmulatedSensor

_SHORT_START: Final = 0x10
_LONG_START: Final = 0x68
_END: Final = 0x16
_READ_VALUES: Final = 0x4C
_HOST: Final = 0x01


class Values(NamedTuple):
    """One answer of the controller.

    Attributes
    ----------
    voltage_v : float
        Sensor value, V.
    scaled : float
        The controller's own scaled value; 0 where it has none.
    """

    voltage_v: float
    scaled: float


def question(address: int) -> bytes:
    """Request frame that asks the controller at `address` for its values.

    Examples
    --------
    >>> question(0x7E).hex(" ")
    '10 7e 01 4c cb 16'
    """
    body = bytes((address, _HOST, _READ_VALUES))
    return bytes((_SHORT_START,)) + body + bytes((sum(body) % 256, _END))


class Msc7xxxDecoder:
    """Bytes in, values out: frames `68 L L 68`, L bytes, sum modulo 256, `16`, as in FT 1.2.

    The body is host address, controller address, function, then two little-endian floats.

    Examples
    --------
    >>> reply = bytes.fromhex("680b0b68 017e08 ae47613f 00000000 1c16")
    >>> round(Msc7xxxDecoder(address=0x7E).feed(reply)[0].voltage_v, 6)
    0.88
    """

    def __init__(self, *, address: int) -> None:
        self._address = address
        self._buffer = bytearray()
        self.n_discarded_bytes = 0

    def feed(self, received: bytes) -> list[Values]:
        """Return the values completed by `received`."""
        self._buffer += received
        found: list[Values] = []
        while self._buffer:
            length = self._frame_length()
            if length is None:
                break
            if length == 0:
                # Not a frame: look for the next possible beginning.
                following = self._buffer.find(_LONG_START, 1)
                n_bad = following if following > 0 else len(self._buffer)
                self.n_discarded_bytes += n_bad
                del self._buffer[:n_bad]
                continue
            body = bytes(self._buffer[4 : length - 2])
            del self._buffer[:length]
            if len(body) == 11 and body[0] == _HOST and body[1] == self._address:
                value = Values(*struct.unpack("<ff", body[3:11]))
                if np.isfinite(value.voltage_v):
                    found.append(value)
                    continue
            self.n_discarded_bytes += length
        return found

    def _frame_length(self) -> int | None:
        """Length of the frame at the front; 0: none; None: more bytes needed."""
        b = self._buffer
        if b[0] != _LONG_START:
            return 0
        if len(b) < 4:
            return None
        if b[1] != b[2] or b[3] != _LONG_START or b[1] < 3:
            return 0
        length = b[1] + 6
        if len(b) < length:
            return None
        is_good = b[length - 1] == _END and sum(b[4 : length - 2]) % 256 == b[length - 2]
        return length if is_good else 0


class Msc7xxxSettings(SerialTable):
    """`[devices.NAME]` with `driver = "msc7xxx"`.

    Attributes
    ----------
    address : int
        Of the controller on the RS485 bus.
    channels : mapping of Channel to ChannelTable
        One channel; its raw value is the sensor voltage, V.
    baud_rate : int
        Bit/s, 8E1.
    """

    driver: str = "msc7xxx"
    address: int = Field(default=0x7E, ge=0, le=0xFF)
    channels: OneChannel
    baud_rate: int = Field(default=256_000, gt=0)


class Msc7xxx(SerialInstrument[Msc7xxxSettings, Msc7xxxDecoder]):
    """One controller; see `SerialInstrument`."""

    MODEL = "MSC7xxx"
    STREAM = "values"

    def __init__(self, name: str, settings: Msc7xxxSettings, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(name, settings, Msc7xxxDecoder(address=settings.address), clock=clock, parity="E")

    def open(self) -> None:
        """Connect and ask once; see `Device.open`."""
        self._link.open()
        if not self.read():
            raise self._no_answer(
                f"opens, but did not answer address {self._settings.address:02X}",
                "check power, RS485 wiring, address and baud rate (256000, even parity)",
            )

    def start(self) -> None:
        """Nothing to do: the controller only answers."""

    def read(self) -> list[Chunk]:
        """Ask for one value; its time is the middle between question and answer."""
        return self._poll(question(self._settings.address), self.answer)

    def answer(self, received: bytes, asked_s: float, arrival_s: float) -> list[Chunk]:
        """Turn received bytes into chunks; no input or output."""
        values = self._framer.feed(received)
        if not values:
            return []
        # Only the last answer belongs to this question; an older one came too late to have a time.
        middle = np.array([0.5 * (asked_s + arrival_s)])
        raw = np.array([[values[-1].voltage_v]])
        return [Chunk(stream=self.STREAM, raw=raw, arrival_s=np.array([arrival_s]), time_s=middle)]

    def describe(self) -> dict[str, str]:
        """Protocol, address, where the times come from."""
        return {
            "model": self.MODEL,
            "address": f"{self._settings.address:02X}",
            "time_source": "middle between question and answer",
            **self._link.facts,
        }


def emulate(_name: str, settings: Msc7xxxSettings, plant: PlantStream, _clock_error_ppm: float) -> Msc7xxxEmulator:
    """Build the controller of one validated table, seen from the other side; it has no sample clock."""
    ((channel, table),) = settings.channels.items()
    return Msc7xxxEmulator(plant, EmulatedSensor.of(channel, table), address=settings.address)


INSTRUMENT: Final = Instrument(
    settings=Msc7xxxSettings,
    make=Msc7xxx,
    emulate=emulate,
    example={"channels": {"displacement_mm": {"input": 1, "raw_range": [-10, 10], "calibration": {"scale": 2.5}}}},
)
