"""A GSV-8 as the host sees it: answers requests, streams frames as `devices.gsv8_frames` describes them.

Written from the protocol, not from the driver: it shares no code with it.
"""

from __future__ import annotations

import math
import struct

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sensor import EmulatedSensor

_HIGHEST_RATE_HZ = 48_000.0
_MODEL_GSV8 = 0x08
_FIRMWARE = b"\x01\x2a"


class Gsv8Emulator:
    """One amplifier, float32 frames.

    Parameters
    ----------
    plant : PlantStream
    inputs : tuple of EmulatedSensor
        Inputs in between that nothing is connected to read 0.
    rate_hz : float
        After switching on.
    clock_error_ppm : float
        How much faster than nominal its quartz runs.
    serial_number : int
        32 bit.
    """

    def __init__(
        self,
        plant: PlantStream,
        inputs: tuple[EmulatedSensor, ...],
        *,
        rate_hz: float = 6000.0,
        clock_error_ppm: float = 0.0,
        serial_number: int = 20_250_815,
    ) -> None:
        self._plant = plant
        self._serial_number = serial_number
        self._inputs = inputs
        self._n_values = max(i.input for i in inputs)
        self._speed = 1.0 + clock_error_ppm * 1e-6
        self._initial_rate_hz = rate_hz
        self._latest = np.zeros(self._n_values)
        self.power_cycle()

    @property
    def is_streaming(self) -> bool:
        """Whether it sends measured-value frames."""
        return self._streaming

    def power_cycle(self) -> None:
        """Not transmitting, nothing zeroed."""
        self._streaming = False
        self._rate_hz = self._initial_rate_hz
        self._zero = np.zeros(self._n_values)
        self._incoming = b""
        self._begun_s = 0.0
        self._n_sent = 0

    def receive(self, commands: bytes, now_s: float) -> bytes:
        """Answer the requests in `commands`."""
        self._incoming += commands
        answers = b""
        while True:
            start = self._incoming.find(b"\xaa")
            if start < 0:
                self._incoming = b""
                return answers
            self._incoming = self._incoming[start:]
            if len(self._incoming) < 4:
                return answers
            n_parameters = self._incoming[1] & 0x0F
            if self._incoming[1] & 0xF0 != 0x90:
                self._incoming = self._incoming[1:]
                continue
            if len(self._incoming) < 4 + n_parameters:
                return answers
            frame, self._incoming = self._incoming[: 4 + n_parameters], self._incoming[4 + n_parameters :]
            if frame[-1] != 0x85:
                answers += _answer(0x42)
                continue
            answers += self._obey(frame[2], frame[3:-1], now_s)

    def advance(self, now_s: float) -> bytes:
        """Frames of the samples up to `now_s`."""
        if not self._streaming:
            return b""
        rate_hz = self._rate_hz * self._speed
        n_due = math.floor((now_s - self._begun_s) * rate_hz) + 1
        if n_due <= self._n_sent:
            return b""
        time_s = self._begun_s + np.arange(self._n_sent, n_due) / rate_hz
        self._n_sent = n_due
        return self._frames(time_s)

    def _frames(self, time_s: NDArray[np.float64]) -> bytes:
        raw = np.zeros((len(time_s), self._n_values))
        for sensor in self._inputs:
            raw[:, sensor.input - 1] = sensor.raw(self._plant, time_s)
        self._latest = raw[-1]
        frames = np.empty((len(time_s), 4 + 4 * self._n_values), dtype=np.uint8)
        frames[:, 0] = 0xAA
        frames[:, 1] = 0x10 | (self._n_values - 1)
        frames[:, 2] = 0x80 | 3 << 4
        frames[:, 3:-1] = (raw - self._zero).astype(">f4").view(np.uint8).reshape(len(time_s), -1)
        frames[:, -1] = 0x85
        return frames.tobytes()

    def _obey(self, command: int, parameters: bytes, now_s: float) -> bytes:
        commands = {
            0x01: (1, self._identify),
            0x0C: (1, self._set_zero),
            0x1F: (0, lambda *_: _answer(0, struct.pack(">I", self._serial_number))),
            0x23: (0, self._stop),
            0x24: (0, self._start),
            0x2B: (0, lambda *_: _answer(0, _FIRMWARE)),
            0x8A: (0, lambda *_: _answer(0, struct.pack(">f", self._rate_hz))),
            0x8B: (4, self._set_rate),
        }
        if command not in commands:
            return _answer(0x40)
        n_parameters, act = commands[command]
        return act(parameters, now_s) if len(parameters) == n_parameters else _answer(0x5B)

    def _identify(self, _parameters: bytes, _now_s: float) -> bytes:
        content = self._n_values << 4 | (8 if self._streaming else 0) | 3
        return _answer(0, bytes((_MODEL_GSV8, content, 0, 1)))

    def _stop(self, _parameters: bytes, _now_s: float) -> bytes:
        self._streaming = False
        return _answer(0)

    def _start(self, _parameters: bytes, now_s: float) -> bytes:
        self._streaming, self._begun_s, self._n_sent = True, now_s, 0
        return _answer(0)

    def _set_rate(self, parameters: bytes, now_s: float) -> bytes:
        (rate_hz,) = struct.unpack(">f", parameters)
        if not rate_hz > 0:
            return _answer(0x55)
        if rate_hz > _HIGHEST_RATE_HZ:
            return _answer(0x54)
        self._rate_hz, self._begun_s, self._n_sent = rate_hz, now_s, 0
        return _answer(0)

    def _set_zero(self, parameters: bytes, _now_s: float) -> bytes:
        which = parameters[0]
        if which > self._n_values:
            return _answer(0x51)
        chosen = slice(None) if which == 0 else slice(which - 1, which)
        self._zero[chosen] = self._latest[chosen]
        return _answer(0)


def _answer(error: int, payload: bytes = b"") -> bytes:
    return bytes((0xAA, 0x50 | len(payload), error)) + payload + b"\x85"
