"""Where an emulated instrument is plugged in: a pty behind a fixed path, or a TCP port on loopback."""

from __future__ import annotations

import errno
import os
import socket
import struct
from pathlib import Path
from typing import Final, Protocol

# What stands in for the buffers of a USB adapter; when it is full, bytes are lost as they would be there.
_BACKLOG_BYTES: Final = 1 << 18
_READ_BYTES: Final = 4096
# TIOCPKT_FLUSHREAD, which Python's termios does not name on every system.
_FLUSHED_BY_HOST: Final = 1


class Endpoint(Protocol):
    """One plug."""

    address: str
    n_lost_bytes: int

    def plug(self) -> None:
        """Appear."""
        ...

    def unplug(self) -> None:
        """Vanish, with everything that was on the way."""
        ...

    def read(self) -> bytes:
        """Bytes from the host, if any; never waits."""
        ...

    def write(self, data: bytes) -> None:
        """Send as much as fits, keep the rest for the next call; never waits."""
        ...

    def drop_backlog(self) -> None:
        """Forget what was not sent yet."""
        ...


class PtyEndpoint:
    """A pseudo-terminal behind a symbolic link, which stays the same when it is plugged in again.

    Parameters
    ----------
    path : Path
        Of the link.
    """

    def __init__(self, path: Path) -> None:
        self.address = str(path)
        self.n_lost_bytes = 0
        self._path = path
        self._host_side = -1
        self._our_side = -1
        self._backlog = bytearray()

    def plug(self) -> None:
        """Make the pty and the link."""
        import fcntl
        import pty
        import termios
        import tty

        self._our_side, self._host_side = pty.openpty()
        # Each read of ours then begins with a byte that says whether the host threw away what waited for it.
        fcntl.ioctl(self._our_side, termios.TIOCPKT, struct.pack("i", 1))
        # Raw from the beginning; and the host's side stays open here, so that reading ours is no error while
        # nobody is connected.
        tty.setraw(self._host_side)
        os.set_blocking(self._our_side, False)
        self._path.symlink_to(os.ttyname(self._host_side))

    def unplug(self) -> None:
        """Remove link and pty; the host sees the link break."""
        self._path.unlink(missing_ok=True)
        for side in (self._our_side, self._host_side):
            if side >= 0:
                os.close(side)
        self._our_side = self._host_side = -1
        self.drop_backlog()

    def read(self) -> bytes:
        """Bytes from the host."""
        if self._our_side < 0:
            return b""
        try:
            kind, *data = os.read(self._our_side, _READ_BYTES)
        except BlockingIOError:
            return b""
        if kind & _FLUSHED_BY_HOST:
            # As it opens the port: an adapter keeps nothing for a port that is closed.
            self.drop_backlog()
        return b"" if kind else bytes(data)

    def write(self, data: bytes) -> None:
        """Send what fits."""
        if self._our_side < 0:
            return
        self._backlog += data
        while self._backlog:
            try:
                n_sent = os.write(self._our_side, self._backlog)
            except BlockingIOError:
                break
            del self._backlog[:n_sent]
        self.n_lost_bytes += _limit(self._backlog)

    def drop_backlog(self) -> None:
        """Forget what was not sent yet."""
        self._backlog.clear()


class TcpEndpoint:
    """A listening port on loopback that serves one host at a time, for systems without ptys."""

    def __init__(self) -> None:
        self.address = ""
        self.n_lost_bytes = 0
        self._port = 0
        self._listener: socket.socket | None = None
        self._host: socket.socket | None = None
        self._backlog = bytearray()

    def plug(self) -> None:
        """Listen; on the same port as before."""
        self._listener = socket.create_server(("127.0.0.1", self._port))
        self._listener.setblocking(False)
        self._port = self._listener.getsockname()[1]
        self.address = f"socket://127.0.0.1:{self._port}"

    def unplug(self) -> None:
        """Hang up and stop listening."""
        self._hang_up()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def read(self) -> bytes:
        """Bytes from the host; takes a waiting connection first."""
        if self._listener is not None and self._host is None:
            try:
                self._host, _ = self._listener.accept()
            except BlockingIOError:
                return b""
            self._host.setblocking(False)
            self._host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._host is None:
            return b""
        try:
            received = self._host.recv(_READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            received = b""
        if not received:
            self._hang_up()
        return received

    def write(self, data: bytes) -> None:
        """Send what fits."""
        if self._host is None:
            return
        self._backlog += data
        try:
            while self._backlog:
                del self._backlog[: self._host.send(self._backlog)]
        except BlockingIOError:
            self.n_lost_bytes += _limit(self._backlog)
        except OSError as error:
            if error.errno not in {errno.EPIPE, errno.ECONNRESET, errno.ECONNABORTED, errno.EBADF}:
                raise
            self._hang_up()

    def drop_backlog(self) -> None:
        """Forget what was not sent yet."""
        self._backlog.clear()

    def _hang_up(self) -> None:
        self.drop_backlog()
        if self._host is not None:
            self._host.close()
            self._host = None


def _limit(backlog: bytearray) -> int:
    n_over = max(0, len(backlog) - _BACKLOG_BYTES)
    del backlog[:n_over]
    return n_over
