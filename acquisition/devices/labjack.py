"""LabJack T4, T7 and T8, through LabJack's package `labjack-ljm` and its library LJM.

The device streams scans by its own clock. Scans that it lost it fills with a number that means none, so that the count
stays whole and the loss is a gap of known length.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from pydantic import Field, model_validator
from sawbench.acquisition.devices.device import Chunk, inputs_within
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.optional_package import import_optional
from sawbench.acquisition.devices.package_instrument import PackageInstrument, PackageTable
from sawbench.bench.errors import DeviceError

_EXTRA: Final = "labjack"
_READ_S: Final = 0.02
# Negative input of a single-ended one. Inputs of a T4 are always single-ended, those of a T8 always differential.
_GROUND: Final = 199
_WITH_NEGATIVE_INPUT: Final = "T7"


class LabJackSettings(PackageTable):
    """`[devices.NAME]` with `driver = "labjack"`.

    Attributes
    ----------
    port : str
        Serial number, IP address or name of the device; ANY for the only one.
    channels : mapping of Channel to ChannelTable
        Bench channel -> analogue input as `input`: 1 is AIN0. Raw unit: V.
    rate_hz : float
        Scans per second.
    range_v : float
        Of the inputs, V: 10, 1, 0.1 or 0.01 on a T7.
    is_differential : bool
        Each input against the next one: AIN0 against AIN1 (T7).
    """

    driver: str = "labjack"
    rate_hz: float = Field(default=6000.0, gt=0, le=100_000)
    range_v: float = Field(default=10.0, gt=0, le=11)
    is_differential: bool = False

    @model_validator(mode="after")
    def _inputs_exist(self) -> LabJackSettings:
        inputs_within(self.channels, 14)
        return self


class LabJack(PackageInstrument[LabJackSettings]):
    """One device; see `PackageInstrument` for the parameters."""

    MODEL = "LabJack"

    def open(self) -> None:
        """Connect, identify, set the ranges; see `Device.open`."""
        ljm = self._library()
        try:
            self._handle = self._opened(ljm)
            kind, _, number, *_ = ljm.getHandleInfo(self._handle)
            self._facts = {"model": f"T{kind}", "serial_number": str(number)}
            self._require_number(str(number))
            for table in self._settings.channels.values():
                ain = table.input - 1
                ljm.eWriteName(self._handle, f"AIN{ain}_RANGE", self._settings.range_v)
                # The device keeps what another program set until it is switched off, so single-ended is written too.
                if self._settings.is_differential or self._facts["model"] == _WITH_NEGATIVE_INPUT:
                    negative = ain + 1 if self._settings.is_differential else _GROUND
                    ljm.eWriteName(self._handle, f"AIN{ain}_NEGATIVE_CH", negative)
        except ljm.LJMError as error:
            raise self._refused(error) from error

    def start(self) -> None:
        """Start the stream."""
        ljm, rate_hz = self._library(), self._settings.rate_hz
        names = [f"AIN{table.input - 1}" for table in self._settings.channels.values()]
        try:
            addresses, _ = ljm.namesToAddresses(len(names), names)
            n_scans = max(1, math.ceil(_READ_S * rate_hz))
            chosen_hz = float(ljm.eStreamStart(self._handle, n_scans, len(names), addresses, rate_hz))
        except ljm.LJMError as error:
            raise self._refused(error) from error
        if abs(chosen_hz / rate_hz - 1.0) > 0.02:
            raise self._error(f"was set to {rate_hz:g} Hz but uses {chosen_hz:g} Hz", "set rate_hz to that")

    def read(self) -> list[Chunk]:
        """Return the next 20 ms of scans; a scan that the device lost is not a number."""
        ljm = self._library()
        if self._handle is None:
            raise self._error("is not open", "call open() first")
        try:
            values, _, _ = ljm.eStreamRead(self._handle)
        except ljm.LJMError as error:
            raise self._refused(error) from error
        raw = np.array(values, dtype=np.float64).reshape(-1, len(self._settings.channels))
        return self._chunks(np.where(raw == ljm.constants.DUMMY_VALUE, np.nan, raw))

    def _close(self, handle: Any) -> None:
        ljm = self._library()
        for end in (ljm.eStreamStop, ljm.close):
            try:
                end(handle)
            except ljm.LJMError:
                # Not streaming, or unplugged: nothing is left to be ended.
                continue

    def _opened(self, ljm: Any) -> int:
        try:
            return ljm.openS("ANY", "ANY", self.port)
        except AttributeError as error:
            # Without its library the package cannot call anything.
            raise self._error("the library LJM is not installed", "install it from labjack.com") from error

    def _library(self) -> Any:
        return import_optional("labjack.ljm", extra=_EXTRA, where=f"[devices.{self.name}]")

    def _refused(self, error: Exception) -> DeviceError:
        return self._error(f"LJM error: {error}", "check `port`, range and rate in Kipling, and that LJM is installed")


INSTRUMENT: Final = Instrument(
    settings=LabJackSettings,
    make=LabJack,
    example={"channels": {"force_n": {"input": 1, "raw_range": [-10, 10], "calibration": {"scale": 50.0}}}},
    is_searched=False,
)
