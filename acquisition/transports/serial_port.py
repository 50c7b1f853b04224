"""A byte pipe to an instrument: pyserial port, pty, or TCP socket, by URL."""

from __future__ import annotations

import errno
import os
import select
from pathlib import Path
from typing import Any, Final

import serial
from sawbench.bench.errors import DeviceError, OtherInstrumentError
from serial.tools import list_ports

# Emptying or flushing a terminal that is gone raises an error that is not an OSError; Windows has no terminals.
_GONE: tuple[type[Exception], ...] = (OSError,)
if os.name == "posix":
    import termios

    _GONE = (OSError, termios.error)

_WAIT_S: Final = 0.1
# A socket cannot say how much is waiting, so it is read for a fixed short time instead.
_SOCKET_WAIT_S: Final = 0.004
_LARGEST_READ: Final = 65536
# A terminal hands out at most 4095 bytes at a time; more of what has arrived follows at once.
_FULL_READ: Final = 4000
_REST_WAIT_S: Final = 0.001


class SerialPort:
    """One open byte pipe; reads everything that is waiting in one call.

    Parameters
    ----------
    url : str
        `/dev/ttyUSB0`, `COM3`, a pty, or a pyserial URL such as `socket://127.0.0.1:5000`.
    device : str
        Name of the instrument, for error messages.
    baud_rate : int
        Bit/s; of no effect on USB CDC devices, ptys and sockets.
    parity : {"N", "E", "O"}
    serial_number : str, optional
        Of the USB adapter that must be at this port.

    Attributes
    ----------
    facts : dict of str to str
        `serial_number` of the USB adapter at the port, once open; empty where it states none.

    Notes
    -----
    The constructor does no input or output.
    """

    def __init__(
        self,
        url: str,
        *,
        device: str,
        baud_rate: int = 115200,
        parity: str = "N",
        serial_number: str | None = None,
    ) -> None:
        self.url = url
        self.facts: dict[str, str] = {}
        self._wanted_serial_number = serial_number
        self._device = device
        self._baud_rate = baud_rate
        self._parity = parity
        self._is_socket = "://" in url
        self._port: Any = None  # serial.Serial or one of its URL handlers, which share no typed base

    def open(self) -> None:
        """Open the port for this process alone and drop what was waiting in it.

        Raises
        ------
        DeviceError
            If the port is missing, forbidden, or used by another program.
        OtherInstrumentError
            If the USB adapter at the port has another serial number than the one that is wanted.
        """
        options = {} if self._is_socket else {"exclusive": True}
        wait_s = _SOCKET_WAIT_S if self._is_socket else _WAIT_S
        try:
            self._port = serial.serial_for_url(
                self.url,
                baudrate=self._baud_rate,
                # A pseudo-terminal has no parity, and the system refuses to set one a second time.
                parity="N" if _is_pseudo_terminal(self.url) else self._parity,
                timeout=wait_s,
                write_timeout=1.0,
                **options,
            )
        except (*_GONE, ValueError) as error:
            raise self._open_error(error) from error
        if hasattr(self._port, "set_buffer_size"):
            # Windows keeps 4096 bytes unless it is told otherwise; samples gather for longer than that.
            self._port.set_buffer_size(rx_size=_LARGEST_READ)
        self._require_adapter()

    def _require_adapter(self) -> None:
        adapters = {} if self._is_socket or _is_pseudo_terminal(self.url) else usb_adapters()
        present = adapters.get(self.url) or adapters.get(str(Path(self.url).resolve()))
        self.facts = {} if present is None else {"serial_number": present}
        wanted = self._wanted_serial_number
        if wanted in {None, present}:
            return
        self.close()
        elsewhere = next((port for port, number in adapters.items() if number == wanted), None)
        raise OtherInstrumentError(
            f"another adapter is at this port: its serial number is {present or 'not known'}, "
            f"the configuration names {wanted}",
            where=f"{self._device} on {self.url}",
            remedy=(
                f"connect the right one, or correct `serial_number` in [devices.{self._device}]"
                if elsewhere is None
                else f"that adapter is now at {elsewhere}: correct `port` in [devices.{self._device}], or swap the"
                " connectors"
            ),
        )

    def read(self) -> bytes:
        """Return all bytes that have arrived; wait at most 0.1 s for the first one.

        Returns
        -------
        bytes
            Empty where nothing came.

        Raises
        ------
        DeviceError
            If the instrument was unplugged.
        """
        port = self._opened()
        try:
            if self._is_socket:
                return bytes(port.read(_LARGEST_READ))
            return _read_at_once(port) if os.name == "posix" else _read_in_two(port)
        except (OSError, TypeError) as error:
            # TypeError: pyserial's read on a port that another thread has just closed.
            raise self._lost(error) from error

    def drop_waiting(self) -> None:
        """Forget what has arrived and was not read; raise DeviceError if the link is gone."""
        port = self._opened()
        try:
            port.reset_input_buffer()
        except _GONE as error:
            raise self._lost(error) from error

    def write(self, data: bytes) -> None:
        """Send `data`; raise DeviceError if the link is gone."""
        port = self._opened()
        try:
            port.write(data)
            port.flush()
        except _GONE as error:
            raise self._lost(error) from error

    def close(self) -> None:
        """Close the port; closing twice, or after the instrument vanished, is allowed."""
        port, self._port = self._port, None
        if port is not None:
            try:
                port.close()
            except _GONE:
                # The instrument is gone, and so is everything that closing could tidy up.
                return

    def _opened(self) -> Any:
        if self._port is None:
            raise DeviceError("is not open", where=f"{self._device} on {self.url}", remedy="call open() first")
        return self._port

    def _lost(self, error: Exception) -> DeviceError:
        # A terminal's error has number and words, and no text of its own.
        said = error.args[-1] if error.args and not isinstance(error, OSError) else error
        return DeviceError(
            f"the connection was lost: {said}",
            where=f"{self._device} on {self.url}",
            remedy="check cable and power; the recorder keeps trying to reconnect",
        )

    def _open_error(self, error: Exception) -> DeviceError:
        where = f"{self._device} on {self.url}"
        code = getattr(error, "errno", None)
        text = str(error)
        if code in {errno.EACCES, errno.EPERM} or "PermissionError" in text:
            return DeviceError(
                "no permission to open the port, or another program uses it",
                where=where,
                remedy="close other programs; on Linux join the group of the port (often `dialout`)",
            )
        if code in {errno.EBUSY, errno.EAGAIN}:
            return DeviceError(
                "the port is in use by another program",
                where=where,
                remedy="close the other program (another sawbench, a serial monitor)",
            )
        if self._is_socket:
            return DeviceError(
                f"cannot connect: {text}",
                where=where,
                remedy="check that the server is running and the port is correct",
            )
        if code == errno.ENOENT or "FileNotFoundError" in text:
            there = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
            return DeviceError(
                f"no such port; ports on this machine: {there}",
                where=where,
                remedy=f"connect the instrument, or correct `port` in [devices.{self._device}]",
            )
        return DeviceError(f"cannot be opened: {text}", where=where, remedy="check the settings of the port")


def _read_at_once(port: Any) -> bytes:
    """All that is waiting, in two calls of the system where pyserial makes five."""
    descriptor = port.fileno()
    ready, _, _ = select.select([descriptor], [], [], _WAIT_S)
    if not ready:
        return b""
    received = latest = os.read(descriptor, _LARGEST_READ)
    if not received:
        raise OSError("the device is ready to be read but has no data: it was unplugged")
    while len(latest) >= _FULL_READ and select.select([descriptor], [], [], _REST_WAIT_S)[0]:
        latest = os.read(descriptor, _LARGEST_READ)
        received += latest
    return received


def _read_in_two(port: Any) -> bytes:
    """The first byte, for which there is something to wait, and then the rest."""
    first = port.read(1)
    waiting = port.in_waiting if first else 0
    return bytes(first + port.read(waiting)) if waiting else bytes(first)


def usb_adapters() -> dict[str, str]:
    """Port -> serial number of the USB adapter there, for every adapter that states one."""
    return {port.device: port.serial_number for port in list_ports.comports() if port.serial_number}


def _is_pseudo_terminal(url: str) -> bool:
    return "://" not in url and Path(url).resolve().parent == Path("/dev/pts")
