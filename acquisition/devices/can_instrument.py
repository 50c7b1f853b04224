"""What the instruments on a CAN bus have in common: one bus, frames that are decoded."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from sawbench.acquisition.devices.device import Chunk
from sawbench.acquisition.transports.can_batch import CanBatch
from sawbench.acquisition.transports.can_bus import make_can_source
from sawbench.bench.errors import ConfigError, DeviceError, NoAnswerError, OtherInstrumentError


class CanSettings(Protocol):
    """What the settings of every instrument on a CAN bus hold."""

    @property
    def interface(self) -> str:
        """Interface of python-can."""
        ...

    @property
    def port(self) -> str:
        """Its channel."""
        ...

    @property
    def bitrate(self) -> int:
        """Of the bus, bit/s."""
        ...

    @property
    def baud_rate(self) -> int:
        """Of the adapter's serial port, bit/s."""
        ...

    @property
    def serial_number(self) -> str | None:
        """Of the instrument, or of the adapter at the port."""
        ...


Settings = TypeVar("Settings", bound=CanSettings)


def require_slcan_for_number(settings: CanSettings) -> None:
    """Refuse the serial number of an adapter that nobody can ask for it.

    Raises
    ------
    ValueError
    """
    if settings.serial_number is not None and settings.interface != "slcan":
        raise ValueError(
            f"serial_number is compared for interface slcan alone, not for {settings.interface}: remove it"
        )


class CanInstrument(Generic[Settings]):
    """One instrument; see `devices.device.Device`. A driver adds `streams`, `open`, `start` and `decode`.

    Parameters
    ----------
    name : str
        Of the device table.
    settings : CanSettings
    clock : callable
        Monotonic seconds.
    has_own_number : bool
        The instrument states a serial number of its own, which the driver compares; otherwise that of the USB adapter
        is compared.
    """

    MODEL = ""

    def __init__(
        self,
        name: str,
        settings: Settings,
        *,
        clock: Callable[[], float] = time.monotonic,
        has_own_number: bool = False,
    ) -> None:
        self.name = name
        self.port = settings.port
        self._settings = settings
        self._clock = clock
        self._bus = make_can_source(
            settings.interface,
            settings.port,
            device=name,
            bitrate=settings.bitrate,
            baud_rate=settings.baud_rate,
            serial_number=None if has_own_number else settings.serial_number,
            clock=clock,
        )

    @property
    def n_discarded_bytes(self) -> int:
        """Received bytes that were part of no valid frame, since construction."""
        return self._bus.n_discarded_bytes

    def start(self) -> None:
        """Nothing to do where nodes send by themselves."""

    def read(self) -> list[Chunk]:
        """Return the samples that arrived; wait at most 0.1 s for the first frame."""
        return self.decode(self._bus.read())

    def decode(self, batch: CanBatch) -> list[Chunk]:
        """Turn frames into chunks; no input or output."""
        raise NotImplementedError

    def stop(self) -> None:
        """Leave the bus."""
        self._bus.close()

    def _require_number(self, present: str) -> None:
        """Refuse another instrument than the one whose own serial number the configuration names."""
        wanted = self._settings.serial_number
        if wanted not in {None, present}:
            raise OtherInstrumentError(
                f"another instrument is on the bus: its serial number is {present or 'not known'}, "
                f"the configuration names {wanted}",
                where=self._where,
                remedy=f"correct the node or `serial_number` in [devices.{self.name}]",
            )

    @property
    def _where(self) -> str:
        return f"{self.name} ({self.MODEL}) on {self._settings.interface} {self.port}"

    def _error(self, what: str, remedy: str) -> DeviceError:
        return DeviceError(what, where=self._where, remedy=remedy)

    def _no_answer(self, what: str, remedy: str) -> NoAnswerError:
        return NoAnswerError(what, where=self._where, remedy=remedy)


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
