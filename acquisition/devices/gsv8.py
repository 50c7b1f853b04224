"""ME-Systeme GSV-8 and GSV-6 strain-gauge and voltage amplifiers on a serial port.

The load cell (mV/V) and an inductive sensor's analogue output (volts, an input set to +-10 V) both come in
through it.
"""

from __future__ import annotations

import struct
import time
import zlib
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from pydantic import Field, model_validator
from sawbench.acquisition.devices.device import Chunk, inputs_within
from sawbench.acquisition.devices.gsv8_emulator import Gsv8Emulator
from sawbench.acquisition.devices.gsv8_frames import ERROR_TEXT, Answer, DataType, Gsv8Framer, request
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.serial_instrument import SerialInstrument, SerialTable
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sensor import EmulatedSensor

GET_INTERFACE: Final = 0x01
SET_ZERO: Final = 0x0C
GET_SERIAL_NUMBER: Final = 0x1F
STOP_TRANSMISSION: Final = 0x23
START_TRANSMISSION: Final = 0x24
GET_FIRMWARE_VERSION: Final = 0x2B
READ_DATA_RATE: Final = 0x8A
WRITE_DATA_RATE: Final = 0x8B
_ANSWER_WAIT_S: Final = 0.5
_MODELS: Final = {6: "GSV-6", 8: "GSV-8"}
_DATA_TYPES: Final[dict[int, DataType]] = {1: "int16", 2: "int24", 3: "float32"}


class Gsv8Settings(SerialTable):
    """`[devices.NAME]` with `driver = "gsv8"`.

    Attributes
    ----------
    rate_hz : float
        Frames per second that the amplifier is set to: GSV-8 up to 48 kHz.
    channels : mapping of Channel to ChannelTable
        Bench channel -> input of the amplifier (from 1), calibration, raw range.
    baud_rate : int
        Bit/s; a frame of one float needs 80 bit, so 115200 Bd carry 1.4 kHz. Of no effect over USB.
    integer_full_scale : float
        Raw unit at the largest code of int16 and int24 frames; 2 mV/V inputs reach 2.1 mV/V.
    serial_number : str, optional
        Of the amplifier; another one at this port is refused. `sawbench init` writes it.
    """

    HAS_OWN_NUMBER = True

    driver: str = "gsv8"
    rate_hz: float = Field(default=6000.0, gt=0, le=48000)
    integer_full_scale: float = Field(default=2.1, gt=0)

    @model_validator(mode="after")
    def _inputs_exist(self) -> Gsv8Settings:
        inputs_within(self.channels, 15)
        return self


class _Received(NamedTuple):
    """Bytes of one read, and when it returned."""

    content: bytes
    arrival_s: float


class Gsv8(SerialInstrument[Gsv8Settings, Gsv8Framer]):
    """One amplifier; see `SerialInstrument`."""

    MODEL = "GSV-8"

    def __init__(self, name: str, settings: Gsv8Settings, clock: Callable[[], float] = time.monotonic) -> None:
        self._columns = [channel.input - 1 for channel in settings.channels.values()]
        super().__init__(
            name,
            settings,
            _framer_of(settings, max(self._columns) + 1, "float32"),
            clock=clock,
            rate_hz=settings.rate_hz,
            farewell=request(STOP_TRANSMISSION),
        )
        self._facts: dict[str, str] = {}
        self._received: list[_Received] = []

    def open(self) -> None:
        """Connect, stop the transmission, identify, set the data rate; see `Device.open`."""
        self._link.open()
        self._ask(STOP_TRANSMISSION, n_tries=3)
        # What was on its way when the transmission stopped is no measurement of ours.
        identity = self._ask(GET_INTERFACE, b"\x00").payload
        if len(identity) < 2 or identity[0] & 0x3F not in _MODELS:
            raise self._error(
                f"answers, but not as a GSV-8 (identity {identity.hex(' ') or 'empty'})",
                "check that this port belongs to the amplifier",
            )
        n_values, data_type = identity[1] >> 4, _DATA_TYPES.get(identity[1] & 0x07)
        if data_type is None or n_values <= max(self._columns):
            raise self._error(
                f"sends frames of {n_values} x {data_type}, but input {max(self._columns) + 1} is configured",
                "map the input into the measured-value frame with the maker's program, or correct `input`",
            )
        self._begin_anew(_framer_of(self._settings, n_values, data_type))
        serial_number = self._ask_serial_number()
        self._set_rate()
        firmware = self._ask(GET_FIRMWARE_VERSION).payload
        self._facts = {
            "model": _MODELS[identity[0] & 0x3F],
            "firmware": firmware.hex(" "),
            "frame": f"{n_values} x {data_type}",
            "rate_hz": f"{self._rate_hz:g}",
            "serial_number": serial_number,
        }

    def start(self) -> None:
        """Start the continuous transmission."""
        self._ask(START_TRANSMISSION)

    def receive(self) -> None:
        """Take over the bytes that arrived; see `Receiver`."""
        self._received.append(_Received(self._link.read(), self._clock()))

    def decoded(self) -> list[Chunk]:
        """Decode what was received since the last call; see `Receiver`."""
        received, self._received = self._received, []
        return self._decode(received)

    def decode(self, received: bytes, arrival_s: float) -> list[Chunk]:
        """Turn received bytes into chunks; no input or output."""
        return self._decode([_Received(received, arrival_s)])

    def _decode(self, received: Sequence[_Received]) -> list[Chunk]:
        self._framer.answers.clear()
        return [
            Chunk(
                stream=self.STREAM,
                raw=piece.raw[:, self._columns],
                arrival_s=np.array([_arrival_s(received, piece.n_behind)]),
                n_lost=piece.n_lost,
                is_loss_exact=piece.is_loss_exact,
            )
            for piece in self._framer.feed(b"".join(part.content for part in received))
        ]

    def set_zero(self, channel: str) -> None:
        """Make the present reading of `channel` the zero of the amplifier (command 0C).

        Raises
        ------
        DeviceError
            If the amplifier refuses.
        """
        (table,) = (t for c, t in self._settings.channels.items() if c.name == channel)
        self._ask(SET_ZERO, bytes([table.input]))

    def describe(self) -> dict[str, str]:
        """Model, firmware, frame layout, rate, overloads."""
        return {
            **self._facts,
            "n_overloads": str(self._framer.n_overloads),
            "time_source": "sample count and arrival of the bytes at this machine",
        }

    def _ask_serial_number(self) -> str:
        present = str(int.from_bytes(self._ask(GET_SERIAL_NUMBER).payload[:4], "big"))
        self._require_number(present)
        return present

    def _set_rate(self) -> None:
        wanted_hz = self._settings.rate_hz
        answer = self._ask(WRITE_DATA_RATE, struct.pack(">f", wanted_hz))
        self._rate_hz = wanted_hz
        if answer.error == 1:
            payload = self._ask(READ_DATA_RATE).payload
            (self._rate_hz,) = struct.unpack(">f", payload[:4]) if len(payload) >= 4 else (0.0,)
        if not abs(self._rate_hz - wanted_hz) <= 0.02 * wanted_hz:
            raise self._error(
                f"was set to {wanted_hz:g} Hz but uses {self._rate_hz:g} Hz",
                "set rate_hz to a rate the instrument supports",
            )

    def _ask(self, command: int, parameters: bytes = b"", *, n_tries: int = 1) -> Answer:
        for _ in range(n_tries):
            self._framer.answers.clear()
            self._link.write(request(command, parameters))
            deadline_s = self._clock() + _ANSWER_WAIT_S
            while self._clock() < deadline_s and not self._framer.answers:
                self._framer.feed(self._link.read())
            if self._framer.answers:
                answer = self._framer.answers[-1]
                if answer.error <= 1:
                    return answer
                raise self._error(
                    f"refused command {command:02X}: {ERROR_TEXT[answer.error]} (code {answer.error:02X})",
                    "check its settings with the maker's program",
                )
        raise self._no_answer(
            f"opens, but did not answer command {command:02X} within {n_tries * _ANSWER_WAIT_S:g} s",
            "check power, port and baud_rate",
        )


def _arrival_s(received: Sequence[_Received], n_behind: int) -> float:
    """When the byte had arrived that `n_behind` others stand behind, s."""
    for part in reversed(received):
        if n_behind < len(part.content):
            return part.arrival_s
        n_behind -= len(part.content)
    return received[0].arrival_s


def _framer_of(settings: Gsv8Settings, n_values: int, data_type: DataType) -> Gsv8Framer:
    return Gsv8Framer(n_values=n_values, data_type=data_type, full_scale=settings.integer_full_scale)


def emulate(name: str, settings: Gsv8Settings, plant: PlantStream, clock_error_ppm: float) -> Gsv8Emulator:
    """Build the amplifier of one validated table, seen from the other side; its name gives it a serial number."""
    sensors = tuple(EmulatedSensor.of(channel, table) for channel, table in settings.channels.items())
    return Gsv8Emulator(
        plant,
        sensors,
        rate_hz=settings.rate_hz,
        clock_error_ppm=clock_error_ppm,
        serial_number=zlib.crc32(name.encode()),
    )


INSTRUMENT: Final = Instrument(
    settings=Gsv8Settings,
    make=Gsv8,
    emulate=emulate,
    example={"channels": {"force_n": {"input": 2, "raw_range": [-3.5, 3.5], "calibration": {"scale": 250.0}}}},
)
