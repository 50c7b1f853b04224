"""What the instruments that are read through their maker's own Python package have in common."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from sawbench.acquisition.devices.device import BenchChannel, ChannelTable, Chunk, Stream
from sawbench.acquisition.devices.driver import Driver, InstrumentTable


class PackageTable(InstrumentTable):
    """Keys of every such instrument.

    Attributes
    ----------
    port : str
        As the maker's package names the device.
    channels : mapping of Channel to ChannelTable
        Bench channel -> analogue input as `input`, from 1.
    rate_hz : float
        Samples per second and channel.
    serial_number : str, optional
        Of the device; another one is refused.
    """

    HAS_OWN_NUMBER = True

    channels: dict[BenchChannel, ChannelTable] = Field(min_length=1)
    rate_hz: float = Field(default=6000.0, gt=0)


Settings = TypeVar("Settings", bound=PackageTable)


class PackageInstrument(Driver[Settings]):
    """One device; see `Driver`. A driver adds `open`, `start`, `read` and `_close`."""

    def __init__(self, name: str, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(name, settings, clock)
        self.n_discarded_bytes = 0
        self._handle: Any = None  # whatever the maker's package opens
        self._facts: dict[str, str] = {}

    @property
    def streams(self) -> tuple[Stream, ...]:
        """One stream: all configured channels at the rate of the device."""
        return self._one_stream(self._settings.channels, self._settings.rate_hz)

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
