"""HX711 load cell converter behind a microcontroller that prints a line for each reading.

What the common sketches print is read: a number alone, or one behind a label that ends in a colon, as in
`HX711 reading: 8421`, `Reading: 12.5 lbs` or `one reading:` with a tab and the number. What follows the number is
passed over. A sketch of another kind is a `text_lines` instrument.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

from pydantic import Field
from sawbench.acquisition.devices.device import OneChannel
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.lines import LABELLED_NUMBER, LineFormat, LineFramer
from sawbench.acquisition.devices.row_emulator import RowEmulator
from sawbench.acquisition.devices.row_instrument import RowInstrument, RowProtocol
from sawbench.acquisition.devices.sample_rows import RowTiming
from sawbench.acquisition.devices.serial_instrument import SerialTable
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sampling import Sampler
from sawbench.acquisition.simulation.sensor import EmulatedSensor

_LINE: Final = LineFormat(columns=(1,), pattern=LABELLED_NUMBER)


class Hx711Settings(SerialTable):
    """`[devices.NAME]` with `driver = "hx711"`.

    Attributes
    ----------
    channels : mapping of Channel to ChannelTable
        One channel, input 1; its raw value is the number in the line.
    rate_hz : float
        Lines per second: 10 or 80 by the pin RATE of the converter, less where the sketch waits or averages.
    baud_rate : int
        Bit/s, as in `Serial.begin` of the sketch.
    """

    driver: str = "hx711"
    channels: OneChannel
    rate_hz: float = Field(default=80.0, gt=0, le=160)


class Hx711(RowInstrument[Hx711Settings]):
    """One converter and its microcontroller; see `RowInstrument`."""

    MODEL = "HX711"
    STREAM = "lines"

    def __init__(self, name: str, settings: Hx711Settings, clock: Callable[[], float] = time.monotonic) -> None:
        protocol = RowProtocol(
            new_framer=lambda is_begun: LineFramer(_LINE, is_begun=is_begun),
            timing=RowTiming(rate_hz=settings.rate_hz),
        )
        super().__init__(name, settings, protocol, clock=clock)


def _line(readings: Sequence[float], index: int, time_s: float) -> bytes:
    del index, time_s
    return f"HX711 reading: {readings[0]:.0f}\r\n".encode()


def emulate(_name: str, settings: Hx711Settings, plant: PlantStream, clock_error_ppm: float) -> RowEmulator:
    """Build the converter and a sketch, seen from the other side."""
    ((channel, table),) = settings.channels.items()
    return RowEmulator(
        plant,
        (EmulatedSensor.of(channel, table),),
        render=_line,
        requests={},
        sampler=Sampler(settings.rate_hz, clock_error_ppm),
        is_always_sending=True,
    )


INSTRUMENT: Final = Instrument(
    settings=Hx711Settings,
    make=Hx711,
    emulate=emulate,
    example={
        "channels": {
            "force_n": {"input": 1, "raw_range": [-8388607, 8388606], "calibration": {"scale": 1.2e-4, "raw_unit": "1"}}
        }
    },
    is_searched=False,
)
