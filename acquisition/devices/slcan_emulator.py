"""An slcan adapter as the host sees it: Lawicel ASCII commands in, lines of CAN frames out."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final, NamedTuple

_BITRATES: Final = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
_IDENTITY: Final = MappingProxyType({"V": b"V1013\r", "N": b"NSIMU\r"})
# Status, and the receipts of frames that the host sends.
_WHEN_OPEN: Final = MappingProxyType({"F": b"F00\r", "t": b"z\r", "r": b"z\r", "T": b"Z\r", "R": b"Z\r"})


class SentFrame(NamedTuple):
    """A frame on its way to the host.

    Attributes
    ----------
    time_s : float
        Bench time, s.
    line : bytes
        As the adapter writes it.
    """

    time_s: float
    line: bytes


def line_of(identifier: int, payload: bytes, *, is_extended: bool = False) -> bytes:
    r"""Write one frame as the adapter does.

    Examples
    --------
    >>> line_of(0x181, bytes([0x0A, 0xFF]))
    b't18120AFF\r'
    """
    head = b"T%08X%d" if is_extended else b"t%03X%d"
    return head % (identifier, len(payload)) + payload.hex().upper().encode() + b"\r"


class SlcanAdapter:
    """The adapter; what is on the bus behind it is added by `_due` and `_hear`.

    Parameters
    ----------
    bitrate : int
        Of the bus; an adapter set to another one receives nothing.
    """

    def __init__(self, *, bitrate: int = 500_000) -> None:
        self._bitrate = bitrate
        self.power_cycle()

    @property
    def is_streaming(self) -> bool:
        """Whether the adapter passes frames on."""
        return self._is_open and self._adapter_bitrate == self._bitrate

    def power_cycle(self) -> None:
        """Close the adapter; the nodes on the bus go on."""
        self._is_open = False
        self._adapter_bitrate: int | None = None
        self._incoming = b""

    def receive(self, commands: bytes, now_s: float) -> bytes:
        """Obey the commands; each is answered by a carriage return, or a bell if refused."""
        *lines, self._incoming = (self._incoming + commands).split(b"\r")
        return b"".join(self._obey(line, now_s) for line in lines)

    def advance(self, now_s: float) -> bytes:
        r"""Lines such as `t1004..\r` of all frames up to `now_s`, in order of time."""
        due = sorted(self._due(now_s), key=lambda sent: sent.time_s)
        return b"".join(sent.line for sent in due) if self.is_streaming else b""

    def _due(self, now_s: float) -> list[SentFrame]:
        """Frames that the nodes send up to `now_s`; asked also while nobody listens."""
        del now_s
        return []

    def _hear(self, identifier: int, payload: bytes, now_s: float) -> bytes:
        """Lines of the frames that nodes answer at once to a frame of the host."""
        del identifier, payload, now_s
        return b""

    def _obey(self, line: bytes, now_s: float) -> bytes:
        if not line:
            return b""
        command = line[:1].decode("ascii", "replace")
        if command in "VN":
            return _IDENTITY[command]
        return self._obey_open(command, line, now_s) if self._is_open else self._obey_closed(command, line)

    def _obey_closed(self, command: str, line: bytes) -> bytes:
        if command == "S" and len(line) == 2 and line[1:] in b"012345678":
            self._adapter_bitrate = _BITRATES[int(line[1:])]
            return b"\r"
        if command in "OL" and self._adapter_bitrate is not None:
            self._is_open = True
            return b"\r"
        return b"\a"

    def _obey_open(self, command: str, line: bytes, now_s: float) -> bytes:
        if command == "C":
            self._is_open = False
            return b"\r"
        answers = b""
        if command in "tT" and self.is_streaming:
            n_digits = 3 if command == "t" else 8
            try:
                payload = bytes.fromhex(line[2 + n_digits :].decode("ascii"))
                answers = self._hear(int(line[1 : 1 + n_digits], 16), payload, now_s)
            except ValueError:
                return b"\a"
        return _WHEN_OPEN.get(command, b"\a") + answers
