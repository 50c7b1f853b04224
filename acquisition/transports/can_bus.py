"""A CAN bus through python-can, with a receive loop of our own.

python-can's Notifier thread ends at the first bus exception; here the exception becomes a DeviceError, upon
which the recorder notes the gap, closes the bus and builds a new one, waiting longer after every failure.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, Protocol

from sawbench.acquisition.transports.can_batch import CanBatch, ParsedFrame
from sawbench.acquisition.transports.slcan import SlcanBus
from sawbench.bench.errors import DeviceError

if TYPE_CHECKING:
    import can

_WAIT_S: Final = 0.1
# Error class of an error frame, as linux/can/error.h and python-can number it.
_BUS_OFF: Final = 0x40
# Frames of one read at most.
MOST_AT_ONCE: Final = 2000
# A bus time further than this from the host's wall clock counts from something else than 1970.
_LARGEST_CLOCK_DIFFERENCE_S: Final = 5.0


class CanSource(Protocol):
    """What a CAN instrument needs from a bus."""

    @property
    def time_source(self) -> str:
        """Where the times come from, in words."""
        ...

    @property
    def n_discarded_bytes(self) -> int:
        """Bytes that were part of no frame."""
        ...

    @property
    def facts(self) -> dict[str, str]:
        """`serial_number` of the adapter, once open; empty where it is not known."""
        ...

    def open(self) -> None:
        """Connect; raise DeviceError where that fails."""
        ...

    def read(self) -> CanBatch:
        """Return what arrived; wait at most 0.1 s; raise DeviceError where the bus is lost."""
        ...

    def send(self, frame: ParsedFrame) -> None:
        """Send a frame; raise DeviceError where the bus is lost."""
        ...

    def close(self) -> None:
        """Disconnect; may be called twice."""
        ...


class PythonCanBus:
    """Any interface of python-can: socketcan, pcan, kvaser, udp_multicast, virtual, ...

    Parameters
    ----------
    interface, channel : str
        As python-can names them.
    device : str
        Name of the instrument, for error messages.
    bitrate : int
        Bit/s; ignored by interfaces whose bit rate is set elsewhere (socketcan).
    clock, wall_clock : callable
        Monotonic seconds, and seconds since 1970.

    Notes
    -----
    Frames carry the bus's own time stamp (kernel or adapter). Where it counts from 1970 it is moved to the
    monotonic clock; otherwise the arrival in this process is used. `time_source` says which. Where the computer's wall
    clock is set meanwhile, frames from before that are moved by the clock as it was.
    """

    def __init__(
        self,
        interface: str,
        channel: str,
        *,
        device: str,
        bitrate: int,
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
    ) -> None:
        self._interface = interface
        self._channel = channel
        self._device = device
        self._bitrate = bitrate
        self._clock = clock
        self._wall_clock = wall_clock
        self._bus: can.BusABC | None = None
        self._is_off = False
        self._read_s = -math.inf
        self._offset_s: float | None = None
        self.time_source = "time stamps of the bus"
        self.n_discarded_bytes = 0
        self.facts: dict[str, str] = {}

    def open(self) -> None:
        """Build the bus.

        Raises
        ------
        DeviceError
            If the interface is unknown, missing, or refuses.
        """
        import can

        self._is_off = False
        self._read_s, self._offset_s = -math.inf, None
        try:
            self._bus = can.Bus(interface=self._interface, channel=self._channel, bitrate=self._bitrate)
        except (can.CanError, OSError, ValueError, ImportError, TypeError, NameError) as error:
            raise DeviceError(
                f"the CAN bus cannot be opened: {error}",
                where=self._where,
                remedy="check `interface` and `port` of the device, and that the adapter's driver is installed; for "
                "socketcan: `ip link set can0 up type can bitrate 500000`",
            ) from error

    def read(self) -> CanBatch:
        """Return the frames that arrived; wait at most 0.1 s for the first; DeviceError once the bus said it is off."""
        import can

        bus = self._opened()
        if self._is_off:
            raise DeviceError(
                "the bus is off: too many errors",
                where=self._where,
                remedy="check bit rate, termination and cable, and that another node is on the bus",
            )
        messages: list[can.Message] = []
        try:
            message = bus.recv(_WAIT_S)
            while message is not None:
                messages.append(message)
                message = bus.recv(0) if len(messages) < MOST_AT_ONCE else None
        except (can.CanError, OSError) as error:
            raise self._failed(error) from error
        self._is_off = any(m.is_error_frame and m.arbitration_id & _BUS_OFF for m in messages)
        usable = [m for m in messages if not (m.is_error_frame or m.is_remote_frame or m.is_fd)]
        self.n_discarded_bytes += sum(len(m.data) for m in messages) - sum(len(m.data) for m in usable)
        frames = [ParsedFrame(m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in usable]
        return CanBatch.of(frames, self._arrivals([m.timestamp for m in usable]))

    def send(self, frame: ParsedFrame) -> None:
        """Send a frame; DeviceError where the bus is lost."""
        import can

        message = can.Message(
            arbitration_id=frame.identifier, is_extended_id=frame.is_extended, data=frame.payload, check=True
        )
        try:
            self._opened().send(message, timeout=_WAIT_S)
        except (can.CanError, OSError) as error:
            raise self._failed(error) from error

    def close(self) -> None:
        """Shut the bus down; may be called twice."""
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.shutdown()

    def _opened(self) -> can.BusABC:
        if self._bus is None:
            raise DeviceError("is not open", where=self._where, remedy="call open() first")
        return self._bus

    def _failed(self, error: Exception) -> DeviceError:
        return DeviceError(f"the bus failed: {error}", where=self._where, remedy="check cable, termination and power")

    @property
    def _where(self) -> str:
        return f"{self._device} on {self._interface} {self._channel}"

    def _arrivals(self, stamps: list[float]) -> list[float]:
        """Bus times on the monotonic clock; a frame came between the read before and now, which tells old from new."""
        now_s = self._clock()
        offset_s = self._wall_clock() - now_s
        before_s = offset_s if self._offset_s is None else self._offset_s
        last_s, self._read_s, self._offset_s = self._read_s, now_s, offset_s
        moved = [stamp - (offset_s if last_s <= stamp - offset_s <= now_s else before_s) for stamp in stamps]
        if any(abs(at_s - now_s) > _LARGEST_CLOCK_DIFFERENCE_S for at_s in moved):
            self.time_source = "arrival of the frames in this process"
            return [now_s] * len(stamps)
        return [min(now_s, at_s) for at_s in moved]


def make_can_source(
    interface: str,
    channel: str,
    *,
    device: str,
    bitrate: int,
    baud_rate: int,
    serial_number: str | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> CanSource:
    """Choose the receiver for `interface`; nothing is opened yet. `baud_rate`, `serial_number`: of slcan alone."""
    if interface == "slcan":
        return SlcanBus(
            channel, device=device, bitrate=bitrate, baud_rate=baud_rate, serial_number=serial_number, clock=clock
        )
    return PythonCanBus(interface, channel, device=device, bitrate=bitrate, clock=clock)
