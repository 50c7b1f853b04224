"""Any instrument that sends frames of fixed length: bytes, commands and timing stand in the configuration alone."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Sequence
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator
from sawbench.acquisition.devices.device import inputs_within
from sawbench.acquisition.devices.frames import FrameFormat, FrameFramer
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.row_emulator import RowEmulator, described
from sawbench.acquisition.devices.row_instrument import RowInstrument, RowProtocol, columns_of
from sawbench.acquisition.devices.sample_rows import RowTiming
from sawbench.acquisition.devices.serial_instrument import SerialTable
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sensor import EmulatedSensor


def _is_hexadecimal(text: str) -> str:
    try:
        bytes.fromhex(text)
    except ValueError as error:
        raise ValueError("give bytes in hexadecimal, such as 'AA 55'") from error
    return text


Hexadecimal = Annotated[str, AfterValidator(_is_hexadecimal)]


class BinaryFramesSettings(SerialTable):
    """`[devices.NAME]` with `driver = "binary_frames"`.

    A frame is sync bytes, fields, checksum, end bytes, in this order; bytes are written in hexadecimal. Exactly one of
    `rate_hz`, `time_field` and `question` tells the time of the samples.

    Attributes
    ----------
    channels : mapping of Channel to ChannelTable
        Bench channel -> field of the frame (from 1) as `input`, calibration, raw range.
    sync : str
        Bytes that begin each frame.
    fields : str
        As Python's `struct` writes them, byte order first: `<Hhh` are a word and two signed words, low byte first.
    checksum : {"", "sum8", "xor8", "sum16", "crc16_modbus", "crc16_ccitt"}
        Behind the fields, in their byte order.
    covers_sync : bool
        Whether the checksum covers the sync bytes too.
    end : str
        Bytes that end each frame.
    rate_hz : float
        Frames per second, where the instrument samples at a constant rate.
    time_field : int, optional
        Field with the instrument's own time stamp.
    tick_s : float
        Step of the time stamp, s.
    counter_field : int, optional
        Field that counts the frames, so that lost ones are known; needs `rate_hz`.
    question : str
        Bytes sent for each frame, where the instrument answers only.
    start, stop : str
        Bytes that begin and end the transmission. An instrument that always sends has no `stop`.
    parity : {"N", "E", "O"}
    """

    driver: str = "binary_frames"
    sync: Hexadecimal = Field(min_length=2)
    fields: str
    checksum: Literal["", "sum8", "xor8", "sum16", "crc16_modbus", "crc16_ccitt"] = ""
    covers_sync: bool = False
    end: Hexadecimal = ""
    rate_hz: float = Field(default=0.0, ge=0, le=100_000)
    time_field: int | None = Field(default=None, ge=1)
    tick_s: float = Field(default=1e-6, gt=0, le=1)
    counter_field: int | None = Field(default=None, ge=1)
    question: Hexadecimal = ""
    start: Hexadecimal = ""
    stop: Hexadecimal = ""
    parity: Literal["N", "E", "O"] = "N"

    @model_validator(mode="after")
    def _fits_together(self) -> BinaryFramesSettings:
        frame = self.frame_format
        try:
            n_fields = frame.n_fields
        except ValueError as error:
            raise ValueError(f"fields {self.fields!r} {error}") from error
        inputs_within(self.channels, n_fields, "fields")
        if max(frame.columns) > n_fields:
            raise ValueError(
                f"fields {self.fields!r} has {n_fields} fields, but field {max(frame.columns)} is configured"
            )
        if sum([bool(self.rate_hz), self.time_field is not None, bool(self.question)]) != 1:
            raise ValueError("give exactly one of rate_hz, time_field and question: it defines the time of the samples")
        if self.counter_field is not None and not self.rate_hz:
            raise ValueError("counter_field needs rate_hz")
        if self._behind is not None and self._type_of(self._behind)[1] != "u":
            raise ValueError("the counter or the time stamp has to be a field without a sign (B, H, I, Q)")
        if self.stop and not self.start:
            raise ValueError("stop needs start: a stopped instrument has to be started again")
        return self

    @property
    def frame_format(self) -> FrameFormat:
        """Where the numbers are."""
        return FrameFormat(
            sync=bytes.fromhex(self.sync),
            fields=self.fields,
            columns=columns_of([table.input for table in self.channels.values()], self._behind),
            checksum=self.checksum,
            covers_sync=self.covers_sync,
            end=bytes.fromhex(self.end),
        )

    @property
    def protocol(self) -> RowProtocol:
        """What is sent and received."""
        n_bits = None if self._behind is None else 8 * int(self._type_of(self._behind)[2])
        return RowProtocol(
            new_framer=lambda _is_begun: FrameFramer(self.frame_format),
            timing=RowTiming(
                rate_hz=self.rate_hz,
                tick_s=None if self.time_field is None else self.tick_s,
                tick_bits=None if self.time_field is None else n_bits,
                counter_bits=None if self.counter_field is None else n_bits,
            ),
            question=bytes.fromhex(self.question),
            start=bytes.fromhex(self.start),
            stop=bytes.fromhex(self.stop),
        )

    @property
    def _behind(self) -> int | None:
        return self.time_field if self.time_field is not None else self.counter_field

    def _type_of(self, field: int) -> str:
        return [kind for kind in self.frame_format.field_types if "V" not in kind][field - 1]


class BinaryFrames(RowInstrument[BinaryFramesSettings]):
    """One instrument; see `RowInstrument`."""

    MODEL = "binary frames"

    def __init__(self, name: str, settings: BinaryFramesSettings, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(name, settings, settings.protocol, clock=clock, parity=settings.parity)


def emulate(_name: str, settings: BinaryFramesSettings, plant: PlantStream, clock_error_ppm: float) -> RowEmulator:
    """Build the instrument of one validated table, seen from the other side; it packs with `struct`."""
    sensors = tuple(EmulatedSensor.of(channel, table) for channel, table in settings.channels.items())
    types = [kind for kind in settings.frame_format.field_types if "V" not in kind]

    def number(value: float, kind: str) -> float | int:
        if kind[1] == "f":
            return value
        low, high = int(np.iinfo(kind[1:]).min), int(np.iinfo(kind[1:]).max)
        return min(max(round(value), low), high)

    def render(readings: Sequence[float], index: int, time_s: float) -> bytes:
        cells: list[float | int] = [0] * len(types)
        for sensor, reading in zip(sensors, readings, strict=True):
            cells[sensor.input - 1] = number(reading, types[sensor.input - 1])
        for field, count in ((settings.counter_field, index), (settings.time_field, round(time_s / settings.tick_s))):
            if field is not None:
                cells[field - 1] = count % (1 << 8 * int(types[field - 1][2]))
        body = struct.pack(settings.fields, *cells)
        sync = bytes.fromhex(settings.sync)
        covered = sync + body if settings.covers_sync else body
        return sync + body + _check_bytes(covered, settings.checksum, settings.fields[0]) + bytes.fromhex(settings.end)

    return described(settings, plant, sensors, render=render, as_sent=bytes.fromhex, clock_error_ppm=clock_error_ppm)


def _check_bytes(data: bytes, checksum: str, order: str) -> bytes:
    """Byte by byte, as a microcontroller does it: the driver's own code takes whole columns."""
    value = 0xFFFF if checksum.startswith("crc16") else 0
    for byte in data:
        if checksum == "xor8":
            value ^= byte
        elif checksum == "crc16_modbus":
            value ^= byte
            for _ in range(8):
                value = (value >> 1) ^ (0xA001 if value & 1 else 0)
        elif checksum == "crc16_ccitt":
            value ^= byte << 8
            for _ in range(8):
                value = ((value << 1) ^ (0x1021 if value & 0x8000 else 0)) & 0xFFFF
        else:
            value += byte
    if not checksum:
        return b""
    n_bytes = 1 if checksum.endswith("8") else 2
    return (value % (1 << 8 * n_bytes)).to_bytes(n_bytes, "little" if order == "<" else "big")


INSTRUMENT: Final = Instrument(
    settings=BinaryFramesSettings,
    make=BinaryFrames,
    emulate=emulate,
    example={
        "sync": "AA 55",
        "fields": "<Hh",
        "checksum": "crc16_modbus",
        "rate_hz": 1000.0,
        "counter_field": 1,
        "start": "01",
        "stop": "02",
        "channels": {"force_n": {"input": 2, "raw_range": [-32000, 32000], "calibration": {"scale": 0.02}}},
    },
    is_searched=False,
)
