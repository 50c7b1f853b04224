"""The Lawicel ASCII protocol (slcan) of serial CAN adapters, received in bulk.

python-can has a driver for the same protocol; it reads byte by byte and sleeps for two seconds after opening.
At 2000 frames/s that costs several ten thousand system calls a second, which a recorder on a small machine
does not have. Its driver is the independent judge in `tests/protocol/test_slcan.py`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from sawbench.acquisition.transports.can_batch import CanBatch, ParsedFrame
from sawbench.acquisition.transports.serial_port import SerialPort
from sawbench.bench.errors import ConfigError, DeviceError

BITRATE_COMMANDS: Final = {
    10_000: b"S0",
    20_000: b"S1",
    50_000: b"S2",
    100_000: b"S3",
    125_000: b"S4",
    250_000: b"S5",
    500_000: b"S6",
    800_000: b"S7",
    1_000_000: b"S8",
}
_LONGEST_LINE: Final = 64
_STANDARD, _EXTENDED = ord("t"), ord("T")


class SlcanDecoder:
    r"""Bytes in, CAN frames out; counts what it could not read.

    Notes
    -----
    `tIIIL..` is a frame with an 11-bit identifier, `TIIIIIIIIL..` one with 29 bits; each line ends in `\r`.
    A time stamp of four hexadecimal digits (command `Z1`) may follow and is ignored: its millisecond is
    coarser than the arrival. Remote frames carry no sample and are skipped. Source: Lawicel CAN232 manual,
    section 5.

    Examples
    --------
    >>> SlcanDecoder().feed(b"t10021234\r")
    [ParsedFrame(identifier=256, is_extended=False, payload=b'\x124')]
    """

    def __init__(self) -> None:
        self._rest = b""
        self.n_discarded_bytes = 0
        self.n_refused = 0

    def restart(self) -> None:
        """Forget a line that was begun; the counters stay."""
        self._rest = b""

    def feed(self, received: bytes) -> list[ParsedFrame]:
        """Return the frames completed by `received`, in order."""
        *lines, self._rest = (self._rest + received).split(b"\r")
        if len(self._rest) > _LONGEST_LINE:
            self.n_discarded_bytes += len(self._rest)
            self._rest = b""
        frames = []
        for line in lines:
            refused = line.count(b"\a")
            if refused:
                self.n_refused += refused
                line = line.rpartition(b"\a")[2]  # noqa: PLW2901 - what follows the bell is the line
            if not line or line[0] in b"zZVNF":
                continue
            frame = _parse_line(line)
            if frame is not None:
                frames.append(frame)
            elif line[0] not in b"rR":
                self.n_discarded_bytes += len(line) + 1
        return frames


def _parse_line(line: bytes) -> ParsedFrame | None:
    if line[0] == _STANDARD:
        n_digits = 3
    elif line[0] == _EXTENDED:
        n_digits = 8
    else:
        return None
    try:
        identifier = int(line[1 : 1 + n_digits], 16)
        length = int(line[1 + n_digits : 2 + n_digits])
        digits = line[2 + n_digits :]
        if length > 8 or len(digits) not in {2 * length, 2 * length + 4}:
            return None
        payload = bytes.fromhex(digits[: 2 * length].decode("ascii"))
    except ValueError:
        return None
    if len(payload) != length:
        return None
    return ParsedFrame(identifier=identifier, is_extended=n_digits == 8, payload=payload)


class SlcanBus:
    """A CAN bus behind a serial adapter.

    Parameters
    ----------
    url : str
        Serial port or pyserial URL of the adapter.
    device : str
        Name of the instrument, for error messages.
    bitrate : int
        Of the bus, bit/s.
    baud_rate : int
        Of the serial port, bit/s.
    serial_number : str, optional
        Of the adapter that must be at the port.
    clock : callable
        Monotonic seconds.
    """

    def __init__(
        self,
        url: str,
        *,
        device: str,
        bitrate: int,
        baud_rate: int = 115200,
        serial_number: str | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._port = SerialPort(url, device=device, baud_rate=baud_rate, serial_number=serial_number)
        self._where = f"{device} on {url}"
        self._bitrate = bitrate
        self._clock = clock
        self._decoder = SlcanDecoder()

    @property
    def time_source(self) -> str:
        """Where the times come from, in words."""
        return "arrival of the adapter's bytes at this machine"

    @property
    def n_discarded_bytes(self) -> int:
        """Bytes that were part of no frame, since construction."""
        return self._decoder.n_discarded_bytes

    @property
    def facts(self) -> dict[str, str]:
        """`serial_number` of the USB adapter, once open; empty where it states none."""
        return self._port.facts

    def open(self) -> None:
        """Open the adapter and the bus; see `SerialPort.open` for the errors, ConfigError for an odd bit rate."""
        command = BITRATE_COMMANDS.get(self._bitrate)
        if command is None:
            allowed = ", ".join(str(rate) for rate in BITRATE_COMMANDS)
            raise ConfigError(
                f"slcan has no bit rate {self._bitrate}; it has {allowed}",
                where=self._where,
                remedy="correct `bitrate` of the device",
            )
        self._decoder.restart()
        self._port.open()
        # An adapter that was left open answers `C` with `\r`, a closed one with a bell; both are fine.
        self._port.write(b"\rC\r" + command + b"\rO\r")

    def read(self) -> CanBatch:
        """Return the frames that arrived; wait at most 0.1 s for the first."""
        received = self._port.read()
        arrival_s = self._clock()
        return CanBatch.of(self._decoder.feed(received), arrival_s)

    def send(self, frame: ParsedFrame) -> None:
        """Send a frame; DeviceError where the adapter is gone."""
        head = b"T%08X%d" if frame.is_extended else b"t%03X%d"
        line = head % (frame.identifier, len(frame.payload)) + frame.payload.hex().upper().encode()
        self._port.write(line + b"\r")

    def close(self) -> None:
        """Close bus and adapter."""
        try:
            self._port.write(b"C\r")
        except DeviceError:
            # Already gone: closing the port is all that is left to do.
            pass
        finally:
            self._port.close()
