"""Motor and battery nodes behind an slcan adapter, sending what a DBC describes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.can_signals import counts_of
from sawbench.acquisition.devices.slcan_emulator import SentFrame, SlcanAdapter, line_of
from sawbench.acquisition.simulation.plant_stream import PlantStream

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal as DbcSignal


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


class CanEmulator(SlcanAdapter):
    """The adapter and the nodes, whose counters go on while nobody listens.

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
        self._speed = 1.0 + clock_error_ppm * 1e-6
        self._n_sent = [0] * len(messages)
        super().__init__(bitrate=bitrate)

    def _due(self, now_s: float) -> list[SentFrame]:
        due: list[SentFrame] = []
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
                due += map(SentFrame, time_s.tolist(), self._lines(sent, index, time_s))
        return due

    def _lines(self, sent: EmulatedMessage, index: NDArray[np.int64], time_s: NDArray[np.float64]) -> list[bytes]:
        message = sent.message
        bits = np.zeros((len(index), 64), dtype=np.uint8)
        for signal in message.signals:
            if signal.name == sent.counter:
                first, n_counts = counts_of(signal)
                put_bits(bits, signal, first + index % n_counts)
            elif signal.name in sent.channels:
                physical = self._plant.read(sent.channels[signal.name], time_s)
                put_bits(bits, signal, to_raw(signal, physical))
        payload = np.packbits(bits, axis=1)[:, : message.length]
        return [line_of(message.frame_id, row.tobytes(), is_extended=message.is_extended_frame) for row in payload]


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
