"""An slcan adapter with motor and battery nodes behind it: Lawicel ASCII commands in, CAN frames out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.simulation.plant_stream import PlantStream

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal as DbcSignal

_BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)

_IDENTITY = MappingProxyType({"V": b"V1013\r", "N": b"NSIMU\r"})
# Status, and the receipts of frames that the host sends.
_WHEN_OPEN = MappingProxyType({"F": b"F00\r", "t": b"z\r", "r": b"z\r", "T": b"Z\r", "R": b"Z\r"})


@dataclass(frozen=True, kw_only=True, slots=True)
class EmulatedMessage:
    """A message that a node sends at a fixed rate.

    Attributes
    ----------
    message : cantools Message
    channels : mapping of str to str
        Signal -> plant channel.
    counter : str
        Signal that counts the samples; "" if there is none.
    rate_hz : float
    """

    message: Message
    channels: Mapping[str, str]
    counter: str
    rate_hz: float


class CanEmulator:
    """The adapter and the nodes.

    Parameters
    ----------
    plant : PlantStream
    messages : tuple of EmulatedMessage
    bitrate : int
        Of the bus; an adapter set to another one receives nothing.
    clock_error_ppm : float
        How much faster than nominal the nodes' quartz runs.
    """

    def __init__(
        self,
        plant: PlantStream,
        messages: tuple[EmulatedMessage, ...],
        *,
        bitrate: int = 500_000,
        clock_error_ppm: float = 0.0,
    ) -> None:
        self._plant = plant
        self._messages = messages
        self._bitrate = bitrate
        self._speed = 1.0 + clock_error_ppm * 1e-6
        self._n_sent = [0] * len(messages)
        self.power_cycle()

    @property
    def is_streaming(self) -> bool:
        """Whether the adapter passes frames on."""
        return self._is_open and self._adapter_bitrate == self._bitrate

    def power_cycle(self) -> None:
        """Close the adapter; the nodes go on, their counters do not restart."""
        self._is_open = False
        self._adapter_bitrate: int | None = None
        self._incoming = b""

    def receive(self, commands: bytes, now_s: float) -> bytes:
        """Obey the commands; each is answered by a carriage return, or a bell if refused."""
        del now_s
        *lines, self._incoming = (self._incoming + commands).split(b"\r")
        return b"".join(self._obey(line) for line in lines)

    def advance(self, now_s: float) -> bytes:
        r"""Lines such as `t1004..\r` of all frames up to `now_s`, in order of time."""
        due: list[tuple[float, bytes]] = []
        for k, sent in enumerate(self._messages):
            rate_hz = sent.rate_hz * self._speed
            # Nodes are not in step with each other: each is late by its own part of a period.
            phase_s = (k + 0.5) / (len(self._messages) * rate_hz)
            n_due = math.floor((now_s - phase_s) * rate_hz) + 1
            index = np.arange(self._n_sent[k], n_due)
            if not len(index):
                continue
            self._n_sent[k] = n_due
            if self.is_streaming:
                time_s = phase_s + index / rate_hz
                due += zip(time_s.tolist(), self._lines(sent, index, time_s), strict=True)
        due.sort(key=lambda item: item[0])
        return b"".join(line for _, line in due)

    def _lines(self, sent: EmulatedMessage, index: NDArray[np.int64], time_s: NDArray[np.float64]) -> list[bytes]:
        message = sent.message
        bits = np.zeros((len(index), 64), dtype=np.uint8)
        for signal in message.signals:
            if signal.name == sent.counter:
                put_bits(bits, signal, index % (1 << signal.length))
            elif signal.name in sent.channels:
                physical = self._plant.read(sent.channels[signal.name], time_s)
                put_bits(bits, signal, to_raw(signal, physical))
        payload = np.packbits(bits, axis=1)[:, : message.length]
        head = b"T%08X%d" if message.is_extended_frame else b"t%03X%d"
        start = head % (message.frame_id, message.length)
        return [start + row.tobytes().hex().upper().encode() + b"\r" for row in payload]

    def _obey(self, line: bytes) -> bytes:
        if not line:
            return b""
        command = line[:1].decode("ascii", "replace")
        if command in "VN":
            return _IDENTITY[command]
        return (self._obey_open if self._is_open else self._obey_closed)(command, line)

    def _obey_closed(self, command: str, line: bytes) -> bytes:
        if command == "S" and len(line) == 2 and line[1:] in b"012345678":
            self._adapter_bitrate = _BITRATES[int(line[1:])]
            return b"\r"
        if command in "OL" and self._adapter_bitrate is not None:
            self._is_open = True
            return b"\r"
        return b"\a"

    def _obey_open(self, command: str, line: bytes) -> bytes:
        del line
        if command == "C":
            self._is_open = False
            return b"\r"
        return _WHEN_OPEN.get(command, b"\a")


def to_raw(signal: DbcSignal, physical: NDArray[np.float64]) -> NDArray[np.int64]:
    """Quantise to the signal's steps and hold at the ends of what its bits can say."""
    steps = np.round((physical - float(signal.offset)) / float(signal.scale))
    if signal.is_signed:
        low, high = -(1 << (signal.length - 1)), (1 << (signal.length - 1)) - 1
    else:
        low, high = 0, (1 << signal.length) - 1
    return np.clip(steps, low, high).astype(np.int64)


def put_bits(bits: NDArray[np.uint8], signal: DbcSignal, raw: NDArray[np.int64]) -> None:
    """Write `raw` into `bits`, shape (n, 64), one column a bit in the order of transmission."""
    for k in range(signal.length):
        if signal.byte_order == "little_endian":
            position = signal.start + k
            column = 8 * (position // 8) + 7 - position % 8
            shift = k
        else:
            column = 8 * (signal.start // 8) + 7 - signal.start % 8 + k
            shift = signal.length - 1 - k
        bits[:, column] = (raw >> shift) & 1
