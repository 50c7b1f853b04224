"""What all drivers have in common: the keys of their tables, the number that is compared, errors that say where."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import ClassVar, Generic, TypeVar

from pydantic import BaseModel, Field
from sawbench.acquisition.devices.device import STRICT, ChannelTable, Stream
from sawbench.bench.errors import DeviceError, NoAnswerError, OtherInstrumentError
from sawbench.bench.units import Channel


class InstrumentTable(BaseModel):
    """Keys of every `[devices.NAME]`.

    Attributes
    ----------
    port : str
        Serial port or pyserial URL.
    serial_number : str, optional
        Of the USB adapter at the port; another one at this port is refused. `sawbench init` writes it.
    """

    # The instrument states a serial number of its own, which the driver compares; otherwise that of the USB adapter is.
    HAS_OWN_NUMBER: ClassVar[bool] = False

    model_config = STRICT
    driver: str
    port: str
    serial_number: str | None = Field(default=None, min_length=1)

    @property
    def adapter_number(self) -> str | None:
        """Serial number that the USB adapter at the port has to have."""
        return None if self.HAS_OWN_NUMBER else self.serial_number


Settings = TypeVar("Settings", bound=InstrumentTable)


class Driver(Generic[Settings]):
    """One instrument; see `devices.device.Device`.

    Parameters
    ----------
    name : str
        Of the device table.
    settings : InstrumentTable
    clock : callable
        Monotonic seconds; stamps the arrival of samples.
    """

    MODEL = ""
    STREAM = "samples"

    def __init__(self, name: str, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        self.name = name
        self.port = settings.port
        self._settings = settings
        self._clock = clock

    def _one_stream(self, channels: Mapping[Channel, ChannelTable], rate_hz: float) -> tuple[Stream, ...]:
        """Return the stream of an instrument that samples all its channels together."""
        of_stream = tuple(table.stream_channel(channel) for channel, table in channels.items())
        return (Stream(name=self.STREAM, rate_hz=rate_hz, channels=of_stream),)

    def _require_number(self, present: str) -> None:
        """Refuse another instrument than the one whose own serial number the configuration names."""
        wanted = self._settings.serial_number
        if wanted not in {None, present}:
            raise OtherInstrumentError(
                f"another instrument is there: its serial number is {present or 'not known'}, "
                f"the configuration names {wanted}",
                where=self._where,
                remedy=f"connect the one that is named, or correct `serial_number` in [devices.{self.name}]",
            )

    @property
    def _where(self) -> str:
        return f"{self.name} ({self.MODEL}) on {self.port}"

    def _error(self, what: str, remedy: str) -> DeviceError:
        return DeviceError(what, where=self._where, remedy=remedy)

    def _no_answer(self, what: str, remedy: str) -> NoAnswerError:
        return NoAnswerError(what, where=self._where, remedy=remedy)
