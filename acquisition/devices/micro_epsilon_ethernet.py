"""Micro-Epsilon controllers over Ethernet: blocks of measured values on their data port (TCP).

A block is a header and M frames of 32-bit values, low byte first. capaNCDT 62x0, combiSENSOR 64x0: preamble `MEAS`,
order number, serial number (32 bit each), channels (64 bit, two bits a channel), status (32 bit), M and bytes per frame
(16 bit each), counter of the first frame (32 bit); values 0..FFFFFF over the measuring range. optoNCDT 2300: the same
with two words of flags (32 bit each) in place of channels and status; distances in nm. Sources: operating instructions
capaNCDT 6200, section 6.2; optoNCDT 2300, sections 8.2.3 and 9.2. Their texts leave open whether the preamble is
written as text or as a number, so that both `MEAS` and `SAEM` are read.
"""

from __future__ import annotations

import struct
import time
import zlib
from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from pydantic import Field, model_validator
from sawbench.acquisition.devices.device import inputs_within
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.row_instrument import RowInstrument, RowProtocol, Rows
from sawbench.acquisition.devices.sample_rows import RowTiming
from sawbench.acquisition.devices.serial_instrument import SerialTable
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sampling import Sampler
from sawbench.acquisition.simulation.sensor import EmulatedSensor

PREAMBLES: Final = (b"MEAS", b"SAEM")
_MOST_VALUES: Final = 32
_MOST_BYTES: Final = 1 << 16
_COUNTER_BITS: Final = 32
_HEADERS: Final = {
    "capancdt": struct.Struct("<4sIIQIHHI"),
    "optoncdt": struct.Struct("<4sIIIIHHI"),
}


class MicroEpsilonEthernetSettings(SerialTable):
    """`[devices.NAME]` with `driver = "micro_epsilon_ethernet"`.

    Attributes
    ----------
    port : str
        `socket://ADDRESS:PORT` of the controller's data port: 10001 for capaNCDT as delivered.
    channels : mapping of Channel to ChannelTable
        Bench channel -> place of the value in a frame (from 1). Raw unit: 1/FFFFFF of the measuring range for capancdt,
        nm for optoncdt; its error codes lie above 2147000000, outside of a `raw_range` that ends below.
    family : {"capancdt", "optoncdt"}
        capaNCDT 62x0 and combiSENSOR 64x0, or optoNCDT 2300.
    rate_hz : float
        Frames per second that the controller is set to, with its web page.
    baud_rate : int
        Of no effect on a socket.
    serial_number : str, optional
        Of the controller; another one at this address is refused. `sawbench init` writes it.
    """

    HAS_OWN_NUMBER = True

    driver: str = "micro_epsilon_ethernet"
    family: Literal["capancdt", "optoncdt"] = "capancdt"
    rate_hz: float = Field(default=1041.67, gt=0, le=50_000)

    @model_validator(mode="after")
    def _values_exist(self) -> MicroEpsilonEthernetSettings:
        inputs_within(self.channels, _MOST_VALUES, "values of a frame")
        return self


class BlockFramer:
    """Bytes in, measured values and their counter out.

    Parameters
    ----------
    family : {"capancdt", "optoncdt"}
    columns : tuple of int
        Values of a frame to read, from 1.

    Attributes
    ----------
    serial_number : str
        Of the newest block; "" before the first.
    """

    def __init__(self, family: str, columns: tuple[int, ...]) -> None:
        self._header = _HEADERS[family]
        self._columns = columns
        self._buffer = b""
        self.serial_number = ""
        self.n_discarded_bytes = 0

    def feed(self, received: bytes) -> list[Rows]:
        """Return the frames of the blocks that `received` completes; the counter tells what was lost."""
        self._buffer += received
        pieces: list[Rows] = []
        while len(self._buffer) >= self._header.size:
            fields = self._header.unpack_from(self._buffer)
            n_frames, n_frame_bytes, first = fields[-3:]
            if not self._is_header(fields[0], n_frames, n_frame_bytes):
                self._skip()
                continue
            end = self._header.size + n_frames * n_frame_bytes
            if len(self._buffer) < end:
                break
            body = np.frombuffer(self._buffer, "<i4", n_frames * n_frame_bytes // 4, self._header.size)
            values = body.reshape(n_frames, -1)[:, [column - 1 for column in self._columns]]
            counts = (first + np.arange(n_frames)) % (1 << _COUNTER_BITS)
            pieces.append(Rows(np.column_stack([values, counts]).astype(np.float64), 0))
            self.serial_number = str(fields[2])
            self._buffer = self._buffer[end:]
        return pieces

    def _is_header(self, preamble: bytes, n_frames: int, n_frame_bytes: int) -> bool:
        return (
            preamble in PREAMBLES
            and n_frame_bytes % 4 == 0
            and n_frame_bytes >= 4 * max(self._columns)
            and 0 < n_frames * n_frame_bytes <= _MOST_BYTES
        )

    def _skip(self) -> None:
        found = [at for at in (self._buffer.find(preamble, 1) for preamble in PREAMBLES) if at > 0]
        at = min(found, default=len(self._buffer) - 3)
        self._buffer = self._buffer[at:]
        self.n_discarded_bytes += at


class MicroEpsilonEthernet(RowInstrument[MicroEpsilonEthernetSettings]):
    """One controller; see `RowInstrument`."""

    MODEL = "Micro-Epsilon"
    STREAM = "values"

    def __init__(
        self, name: str, settings: MicroEpsilonEthernetSettings, clock: Callable[[], float] = time.monotonic
    ) -> None:
        columns = tuple(table.input for table in settings.channels.values())
        protocol = RowProtocol(
            new_framer=lambda _is_begun: BlockFramer(settings.family, columns),
            timing=RowTiming(rate_hz=settings.rate_hz, counter_bits=_COUNTER_BITS),
        )
        super().__init__(name, settings, protocol, clock=clock)

    def open(self) -> None:
        """Connect and wait for the first block, which tells the serial number; see `Device.open`."""
        super().open()
        self._require_number(self._number)

    def describe(self) -> dict[str, str]:
        """Model, serial number, rate, where its times come from."""
        return {**super().describe(), "model": f"{self.MODEL} {self._settings.family}"}

    def _renew(self, *, is_begun: bool) -> None:
        # The block that ended the waiting told the number; what is dropped at the start tells none.
        if isinstance(self._framer, BlockFramer):
            self._number = self._framer.serial_number or self._number
        super()._renew(is_begun=is_begun)


class MicroEpsilonEthernetEmulator:
    """A controller that sends a block whenever it is looked at, from switching on.

    Parameters
    ----------
    plant : PlantStream
    sensors : tuple of EmulatedSensor
    settings : MicroEpsilonEthernetSettings
    serial_number : int
    clock_error_ppm : float
        How much faster than nominal its quartz runs.
    """

    def __init__(
        self,
        plant: PlantStream,
        sensors: tuple[EmulatedSensor, ...],
        settings: MicroEpsilonEthernetSettings,
        *,
        serial_number: int,
        clock_error_ppm: float = 0.0,
    ) -> None:
        self._plant = plant
        self._sensors = sensors
        self._is_capancdt = settings.family == "capancdt"
        self._serial_number = serial_number
        self._n_values = max(sensor.input for sensor in sensors)
        self._sampler = Sampler(settings.rate_hz, clock_error_ppm)
        self.power_cycle()

    @property
    def is_streaming(self) -> bool:
        """It always sends."""
        return True

    def power_cycle(self) -> None:
        """Count from 0 again."""
        self._sampler.end()

    def receive(self, commands: bytes, now_s: float) -> bytes:
        """Obey nothing: commands go to another port."""
        del commands, now_s
        return b""

    def advance(self, now_s: float) -> bytes:
        """One block with the frames up to `now_s`."""
        if not self._sampler.is_running:
            self._sampler.begin(now_s)
        first = self._sampler.n_taken
        time_s = self._sampler.due(now_s)
        if not len(time_s):
            return b""
        frames = np.zeros((len(time_s), self._n_values), dtype="<i4")
        for sensor in self._sensors:
            frames[:, sensor.input - 1] = np.round(sensor.raw(self._plant, time_s))
        if self._is_capancdt:
            available = sum(1 << (2 * k) for k in range(self._n_values))
            what = available.to_bytes(8, "little") + bytes(4)
        else:
            what = bytes(8)
        return (
            b"MEAS"
            + (2_303_018).to_bytes(4, "little")
            + self._serial_number.to_bytes(4, "little")
            + what
            + len(time_s).to_bytes(2, "little")
            + (4 * self._n_values).to_bytes(2, "little")
            + first.to_bytes(4, "little")
            + frames.tobytes()
        )


def emulate(
    name: str, settings: MicroEpsilonEthernetSettings, plant: PlantStream, clock_error_ppm: float
) -> MicroEpsilonEthernetEmulator:
    """Build the controller of one validated table, seen from the other side; its name gives it a serial number."""
    return MicroEpsilonEthernetEmulator(
        plant,
        tuple(EmulatedSensor.of(channel, table) for channel, table in settings.channels.items()),
        settings,
        serial_number=zlib.crc32(name.encode()) % 10**8,
        clock_error_ppm=clock_error_ppm,
    )


INSTRUMENT: Final = Instrument(
    settings=MicroEpsilonEthernetSettings,
    make=MicroEpsilonEthernet,
    emulate=emulate,
    example={
        "channels": {
            "displacement_mm": {
                "input": 1,
                "raw_range": [0, 16777215],
                "calibration": {"scale": 1.7881394e-06, "raw_unit": "1/FFFFFF of 30 mm"},
            }
        }
    },
    is_searched=False,
)
