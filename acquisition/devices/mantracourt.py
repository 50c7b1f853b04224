"""Mantracourt DSC, DSCUSB and DCell digitisers, ASCII protocol: one question, one reading.

A question is `!`, the station in three digits, `:`, a parameter, `?` and a carriage return; the answer a decimal number
and a carriage return, or `?` where it is refused. Source: DSC User Manual, Appendix B, and DSCUSB Advanced User's
Manual, "Response Message Formats".
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable
from typing import Final

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

REFUSED: Final = "?"


class MantracourtSettings(SerialTable):
    """`[devices.NAME]` with `driver = "mantracourt"`.

    Attributes
    ----------
    channels : mapping of Channel to ChannelTable
        One channel, input 1; its raw value is what `parameter` reads, in the unit the module is calibrated in.
    station : int
        Of the module on its bus; 1 for a DSCUSB.
    parameter : str
        What is read: SOUT is the selected output, SYS the system output.
    serial_number : str, optional
        Of the module; another one at this port is refused. `sawbench init` writes it.
    """

    HAS_OWN_NUMBER = True

    driver: str = "mantracourt"
    channels: OneChannel
    station: int = Field(default=1, ge=1, le=999)
    parameter: str = Field(default="SOUT", pattern=r"^[A-Z][A-Z0-9]{0,3}$")


def question(station: int, parameter: str) -> bytes:
    r"""Request that reads `parameter`.

    Examples
    --------
    >>> question(1, "SOUT")
    b'!001:SOUT?\r'
    """
    return b"!%03d:%s?\r" % (station, parameter.encode())


class Mantracourt(RowInstrument[MantracourtSettings]):
    """One module; see `RowInstrument`."""

    MODEL = "Mantracourt"
    STREAM = "readings"

    def __init__(self, name: str, settings: MantracourtSettings, clock: Callable[[], float] = time.monotonic) -> None:
        protocol = RowProtocol(
            new_framer=lambda is_begun: LineFramer(LineFormat(columns=(1,), line_end="\r"), is_begun=is_begun),
            timing=RowTiming(),
            question=question(settings.station, settings.parameter),
        )
        super().__init__(name, settings, protocol, clock=clock)

    def describe(self) -> dict[str, str]:
        """Model, serial number, station, where its times come from."""
        return {**super().describe(), "station": f"{self._settings.station:03d}"}

    def _open_dialogue(self) -> None:
        station = self._settings.station
        low, high = (self._ask_text(question(station, name)) for name in ("SERL", "SERH"))
        try:
            self._number = str(65536 * int(float(high)) + int(float(low)))
        except ValueError:
            # Refused, or silent: the question for a reading will tell.
            self._number = ""
        self._require_number(self._number)


def emulate(name: str, settings: MantracourtSettings, plant: PlantStream, _clock_error_ppm: float) -> RowEmulator:
    """Build the module of one validated table, seen from the other side; its name gives it a serial number."""
    ((channel, table),) = settings.channels.items()
    number = zlib.crc32(name.encode())
    address = f"!{settings.station:03d}:"
    return RowEmulator(
        plant,
        (EmulatedSensor.of(channel, table),),
        render=lambda readings, index, time_s: f"{readings[0]:+010.3f}\r".encode(),
        requests={
            f"{address}{settings.parameter}?\r".encode(): RowEmulator.one_row,
            f"{address}SERL?\r".encode(): lambda _module, _now_s: f"{number % 65536:+010.3f}\r".encode(),
            f"{address}SERH?\r".encode(): lambda _module, _now_s: f"{number // 65536:+010.3f}\r".encode(),
        },
        sampler=Sampler(1.0),
    )


INSTRUMENT: Final = Instrument(
    settings=MantracourtSettings,
    make=Mantracourt,
    emulate=emulate,
    example={"channels": {"force_n": {"input": 1, "raw_range": [-9999, 9999], "calibration": {"raw_unit": "N"}}}},
)
