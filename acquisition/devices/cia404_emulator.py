"""A CiA 404 transmitter behind an slcan adapter: SDO, NMT and one PDO, written from the documents, not the driver."""

from __future__ import annotations

import zlib

import numpy as np
from sawbench.acquisition.devices.slcan_emulator import SentFrame, SlcanAdapter, line_of
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sampling import Sampler
from sawbench.acquisition.simulation.sensor import EmulatedSensor
from sawbench.bench.errors import ConfigError

_DIGITS = 2
# Answer to a question, by the number of bytes that it holds.
_UPLOADED = {1: 0x4F, 2: 0x4B, 3: 0x47, 4: 0x43}
_NO_SUCH_OBJECT = (0x06020000).to_bytes(4, "little")


class Cia404Emulator(SlcanAdapter):
    """The adapter and the transmitter, whose process values are 24-bit integers with two decimal digits.

    Parameters
    ----------
    plant : PlantStream
    sensors : tuple of EmulatedSensor
        At most two: so many 24-bit values a PDO holds.
    name : str
        Gives it a serial number.
    node, bitrate : int
    clock_error_ppm : float
        How much faster than nominal its quartz runs.
    """

    def __init__(
        self,
        plant: PlantStream,
        sensors: tuple[EmulatedSensor, ...],
        *,
        name: str,
        node: int,
        bitrate: int,
        clock_error_ppm: float = 0.0,
    ) -> None:
        if len(sensors) > 2:
            raise ConfigError(f"{len(sensors)} channels do not fit into one PDO of 24-bit values", where=name)
        self._plant = plant
        self._sensors = sensors
        self._node = node
        self._clock_error_ppm = clock_error_ppm
        self._number = zlib.crc32(name.encode())
        self._sampler = Sampler(1.0)
        super().__init__(bitrate=bitrate)

    def power_cycle(self) -> None:
        """Pre-operational, with what was delivered."""
        super().power_cycle()
        self._sampler.end()
        self._objects = {
            (0x1000, 0): bytes.fromhex("94010200"),
            (0x1018, 4): self._number.to_bytes(4, "little"),
            (0x1800, 1): (0x180 + self._node).to_bytes(4, "little"),
            (0x1800, 2): b"\xfe",
            (0x1800, 5): (0).to_bytes(2, "little"),
            (0x1A00, 0): bytes([len(self._sensors)]),
        }
        for k, sensor in enumerate(self._sensors):
            self._objects[0x1A00, k + 1] = bytes([24, sensor.input, 0x30, 0x81])
            self._objects[0x6132, sensor.input] = bytes([_DIGITS])

    def _due(self, now_s: float) -> list[SentFrame]:
        time_s = self._sampler.due(now_s)
        if not len(time_s):
            return []
        codes = [np.round(s.raw(self._plant, time_s) * 10**_DIGITS).astype(int) for s in self._sensors]
        frames = []
        for k, at_s in enumerate(time_s.tolist()):
            payload = b"".join(int(code[k]).to_bytes(3, "little", signed=True) for code in codes)
            frames.append(SentFrame(at_s, line_of(0x180 + self._node, payload)))
        return frames

    def _hear(self, identifier: int, payload: bytes, now_s: float) -> bytes:
        if identifier == 0 and len(payload) == 2 and payload[1] in {0, self._node}:
            self._command(payload[0], now_s)
        elif identifier == 0x600 + self._node and len(payload) == 8:
            return line_of(0x580 + self._node, self._answer(payload))
        return b""

    def _command(self, command: int, now_s: float) -> None:
        if command == 0x01:
            period_ms = int.from_bytes(self._objects[0x1800, 5], "little")
            if period_ms:
                self._sampler = Sampler(1000.0 / period_ms, self._clock_error_ppm)
                self._sampler.begin(now_s)
        elif command in {0x02, 0x80}:
            self._sampler.end()

    def _answer(self, request: bytes) -> bytes:
        key = (int.from_bytes(request[1:3], "little"), request[3])
        if key not in self._objects:
            return b"\x80" + request[1:4] + _NO_SUCH_OBJECT
        if request[0] == 0x40:
            value = self._objects[key]
            return bytes([_UPLOADED[len(value)]]) + request[1:4] + value.ljust(4, b"\0")
        # Expedited download: bits 2 and 3 say how many of the four bytes are none, where bit 0 says that they do.
        n_bytes = 4 - (request[0] >> 2 & 3) if request[0] & 1 else 4
        self._objects[key] = request[4 : 4 + n_bytes]
        return b"\x60" + request[1:4] + bytes(4)
