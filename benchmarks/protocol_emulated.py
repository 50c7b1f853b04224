"""pyserial's handler of `emulated://NAME`: a port of a `scripted_bench.ScriptedBench` in the same process."""

from __future__ import annotations

from typing import Any, Protocol

import serial

serial.protocol_handler_packages.append("benchmarks")


class Plug(Protocol):
    """What stands behind such a port."""

    def write(self, data: bytes, /) -> None:
        """Take bytes from the host."""
        ...

    def read(self) -> bytes:
        """Return all that waits for the host."""
        ...


PLUGS: dict[str, Plug] = {}


class Serial:
    """As much of `serial.Serial` as `transports.serial_port` uses; settings of a line mean nothing here."""

    def __init__(self, port: str | None = None, **_settings: Any) -> None:
        self.port = port
        self._plug: Plug | None = None

    def open(self) -> None:
        """Connect.

        Raises
        ------
        OSError
            If nothing is plugged in there.
        """
        if self.port not in PLUGS:
            raise OSError(f"nothing is connected to {self.port}")
        self._plug = PLUGS[self.port]

    def close(self) -> None:
        """Disconnect."""
        self._plug = None

    def read(self, size: int) -> bytes:
        """Return all that waits; `size` is more than that."""
        del size
        return b"" if self._plug is None else self._plug.read()

    def write(self, data: bytes) -> int:
        """Send."""
        if self._plug is not None:
            self._plug.write(data)
        return len(data)

    def reset_input_buffer(self) -> None:
        """Forget what waits."""
        self.read(0)

    def flush(self) -> None:
        """Nothing waits to be sent."""
