"""Loadstar Sensors iLoad load cells and DI-100, DI-1000 interfaces: commands and readings in ASCII.

A carriage return ends a command, carriage return and line feed end an answer. A carriage return alone stops the stream
and is answered by `A`. Source: "Basic Command Set for iLoad Digital Sensors" and "DI-100U/DI-1000U Command Set",
loadstarsensors.com.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from pydantic import Field
from sawbench.acquisition.devices.device import OneChannel
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.lines import LineFormat, LineFramer
from sawbench.acquisition.devices.row_emulator import RowEmulator
from sawbench.acquisition.devices.row_instrument import RowInstrument, RowProtocol
from sawbench.acquisition.devices.sample_rows import RowTiming
from sawbench.acquisition.devices.serial_instrument import SerialTable
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sampling import Sampler
from sawbench.acquisition.simulation.sensor import EmulatedSensor

PING: Final = b"\r"
READY: Final = "A"


@dataclass(frozen=True, kw_only=True, slots=True)
class _Family:
    """Commands of one family."""

    model: str
    stream: bytes
    identity: bytes


_FAMILIES: Final = {
    # Readings in 1/1000 lbf.
    "iload": _Family(model="iLoad", stream=b"O0W0\r", identity=b"SS1\r"),
    # Readings in the unit the interface was calibrated in.
    "di1000": _Family(model="DI-1000", stream=b"WC\r", identity=b"ID\r"),
}


class LoadstarSettings(SerialTable):
    """`[devices.NAME]` with `driver = "loadstar"`.

    Attributes
    ----------
    channels : mapping of Channel to ChannelTable
        One channel, input 1. Raw unit: 1/1000 lbf (0.0044482216 N) for iload, the calibrated unit for di1000.
    family : {"iload", "di1000"}
        iLoad, iLoad Pro, iLoad TR, DQ-1000U; or DI-100, DI-1000.
    rate_hz : float
        Readings per second: 150 for iLoad, 500 with its option; 80 for DI-1000, 500 for DI-1000UHS.
    baud_rate : int
        Bit/s; 230400 for fast versions.
    serial_number : str, optional
        Of the sensor (SS1) or the interface (ID); another one at this port is refused. `sawbench init` writes it.
    """

    HAS_OWN_NUMBER = True

    driver: str = "loadstar"
    channels: OneChannel
    family: Literal["iload", "di1000"] = "iload"
    rate_hz: float = Field(default=150.0, gt=0, le=1000)
    baud_rate: int = Field(default=9600, gt=0)


class Loadstar(RowInstrument[LoadstarSettings]):
    """One sensor; see `RowInstrument`."""

    MODEL = "Loadstar"
    STREAM = "readings"

    def __init__(self, name: str, settings: LoadstarSettings, clock: Callable[[], float] = time.monotonic) -> None:
        self._family = _FAMILIES[settings.family]
        protocol = RowProtocol(
            new_framer=lambda is_begun: LineFramer(LineFormat(columns=(1,)), is_begun=is_begun),
            timing=RowTiming(rate_hz=settings.rate_hz),
            start=self._family.stream,
            stop=PING,
        )
        super().__init__(name, settings, protocol, clock=clock)

    def describe(self) -> dict[str, str]:
        """Model, number, rate, where its times come from."""
        return {**super().describe(), "model": f"{self.MODEL} {self._family.model}"}

    def _open_dialogue(self) -> None:
        super()._open_dialogue()
        answer = self._ask_text(PING)
        if answer != READY:
            raise self._no_answer(
                f"opens, but answered a carriage return with {answer!r}, not with {READY!r}",
                "check that this port belongs to the sensor, and that baud_rate is correct (9600, 115200 or 230400)",
            )
        self._number = self._ask_text(self._family.identity)
        self._require_number(self._number)


def _line(family: str) -> Callable[[Sequence[float], int, float], bytes]:
    text = "{:.0f}\r\n" if family == "iload" else "{:12.4f}\r\n"
    return lambda readings, index, time_s: text.format(readings[0]).encode()


def emulate(name: str, settings: LoadstarSettings, plant: PlantStream, clock_error_ppm: float) -> RowEmulator:
    """Build the sensor of one validated table, seen from the other side; its name gives it a number."""
    ((channel, table),) = settings.channels.items()

    def ping(sensor: RowEmulator, now_s: float) -> bytes:
        if sensor.is_streaming:
            return sensor.end(now_s)
        return b"A\r\n"

    number = b"W%04d\r\n" % (zlib.crc32(name.encode()) % 10_000)
    return RowEmulator(
        plant,
        (EmulatedSensor.of(channel, table),),
        render=_line(settings.family),
        requests={
            b"O0W0\r" if settings.family == "iload" else b"WC\r": RowEmulator.begin,
            b"\r": ping,
            b"SS1\r" if settings.family == "iload" else b"ID\r": lambda _sensor, _now_s: number,
        },
        sampler=Sampler(settings.rate_hz, clock_error_ppm),
    )


INSTRUMENT: Final = Instrument(
    settings=LoadstarSettings,
    make=Loadstar,
    emulate=emulate,
    example={
        "channels": {
            "force_n": {
                "input": 1,
                "raw_range": [-200_000, 200_000],
                "calibration": {"scale": 0.0044482216, "raw_unit": "mlbf"},
            }
        }
    },
)
