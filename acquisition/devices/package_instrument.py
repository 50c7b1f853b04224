"""What the instruments that are read through their maker's own Python package have in common."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.devices.device import ChannelTable, Chunk, Stream
from sawbench.bench.errors import DeviceError, OtherInstrumentError
from sawbench.bench.units import Channel


class PackageSettings(Protocol):
    """What the settings of every such instrument hold."""

    @property
    def port(self) -> str:
        """As the maker's package names the device."""
        ...

    @property
    def rate_hz(self) -> float:
        """Samples per second and channel."""
        ...

    @property
    def serial_number(self) -> str | None:
        """Of the device."""
        ...

    @property
    def channels(self) -> Mapping[Channel, ChannelTable]:
        """Channels with their inputs."""
        ...


Settings = TypeVar("Settings", bound=PackageSettings)


class PackageInstrument(Generic[Settings]):
    """One device; see `devices.device.Device`. A driver adds `open`, `start`, `read` and `_close`.

    Parameters
    ----------
    name : str
        Of the device table.
    settings : PackageSettings
    clock : callable
        Monotonic seconds.
    """

    MODEL = ""
    STREAM = "samples"

    def __init__(self, name: str, settings: Settings, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.name = name
        self.port = settings.port
        self.n_discarded_bytes = 0
        self._settings = settings
        self._clock = clock
        self._handle: Any = None  # whatever the maker's package opens
        self._facts: dict[str, str] = {}

    @property
    def streams(self) -> tuple[Stream, ...]:
        """One stream: all configured channels at the rate of the device."""
        channels = tuple(table.stream_channel(channel) for channel, table in self._settings.channels.items())
        return (Stream(name=self.STREAM, rate_hz=self._settings.rate_hz, channels=channels),)

    def stop(self) -> None:
        """Stop sampling and let the device go."""
        handle, self._handle = self._handle, None
        if handle is not None:
            self._close(handle)

    def describe(self) -> dict[str, str]:
        """Model, serial number, rate, where its times come from."""
        return {
            "model": self.MODEL,
            **self._facts,
            "rate_hz": f"{self._settings.rate_hz:g}",
            "time_source": "sample clock of the device, and arrival of the samples at this machine",
        }

    def _close(self, handle: Any) -> None:
        raise NotImplementedError

    def _chunks(self, raw: NDArray[np.float64]) -> list[Chunk]:
        """Samples that arrived just now, shape (n, n_channels)."""
        arrival = np.array([self._clock()])
        return [Chunk(stream=self.STREAM, raw=raw, arrival_s=arrival)] if len(raw) else []

    def _require_number(self, present: str) -> None:
        """Refuse another device than the one whose serial number the configuration names."""
        wanted = self._settings.serial_number
        if wanted not in {None, present}:
            raise OtherInstrumentError(
                f"another device is there: its serial number is {present}, the configuration names {wanted}",
                where=self._where,
                remedy=f"correct `port` or `serial_number` in [devices.{self.name}]",
            )

    @property
    def _where(self) -> str:
        return f"{self.name} ({self.MODEL}) on {self.port}"

    def _error(self, what: str, remedy: str) -> DeviceError:
        return DeviceError(what, where=self._where, remedy=remedy)
