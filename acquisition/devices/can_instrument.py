"""What the instruments on a CAN bus have in common: one bus, frames that are decoded."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

from pydantic import Field, model_validator
from sawbench.acquisition.devices.device import Chunk
from sawbench.acquisition.devices.driver import Driver, InstrumentTable
from sawbench.acquisition.transports.can_batch import CanBatch
from sawbench.acquisition.transports.can_bus import MOST_AT_ONCE, make_can_source
from sawbench.bench.errors import ConfigError


class CanTable(InstrumentTable):
    """Keys of every instrument on a CAN bus.

    Attributes
    ----------
    interface : str
        Interface of python-can (slcan, socketcan, pcan, virtual, ...).
    port : str
        Its channel: a serial port for slcan, `can0` for socketcan.
    bitrate : int
        Of the bus, bit/s.
    baud_rate : int
        Of the adapter's serial port, bit/s (slcan only).
    serial_number : str, optional
        Of the USB adapter (slcan only); another one at this port is refused. `sawbench init` writes it.
    """

    interface: str = "slcan"
    bitrate: int = Field(default=500_000, gt=0)
    baud_rate: int = Field(default=115_200, gt=0)

    @model_validator(mode="after")
    def _adapter_is_known(self) -> CanTable:
        if self.adapter_number is not None and self.interface != "slcan":
            raise ValueError(
                f"serial_number is compared for interface slcan alone, not for {self.interface}: remove it"
            )
        return self


Settings = TypeVar("Settings", bound=CanTable)


class CanInstrument(Driver[Settings]):
    """One instrument; see `Driver`. A driver adds `streams`, `open`, `start` and `decode`."""

    def __init__(self, name: str, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(name, settings, clock)
        self._bus = make_can_source(
            settings.interface,
            settings.port,
            device=name,
            bitrate=settings.bitrate,
            baud_rate=settings.baud_rate,
            serial_number=settings.adapter_number,
            clock=clock,
        )

    @property
    def n_discarded_bytes(self) -> int:
        """Received bytes that were part of no valid frame, since construction."""
        return self._bus.n_discarded_bytes

    def start(self) -> None:
        """Forget the frames that came while other instruments were opened: in a burst they look like a high rate."""
        while len(self._bus.read()) >= MOST_AT_ONCE:
            pass

    def read(self) -> list[Chunk]:
        """Return the samples that arrived; wait at most 0.1 s for the first frame."""
        return self.decode(self._bus.read())

    def decode(self, batch: CanBatch) -> list[Chunk]:
        """Turn frames into chunks; no input or output."""
        raise NotImplementedError

    def stop(self) -> None:
        """Leave the bus."""
        self._bus.close()

    @property
    def _where(self) -> str:
        return f"{self.name} ({self.MODEL}) on {self._settings.interface} {self.port}"


def require_slcan(name: str, interface: str) -> None:
    """Refuse to emulate another interface.

    Raises
    ------
    ConfigError
    """
    if interface != "slcan":
        raise ConfigError(
            f"interface {interface!r} cannot be emulated",
            where=f"[devices.{name}]",
            remedy='set interface = "slcan" for the simulated bench',
        )
