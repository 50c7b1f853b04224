"""An MSC7xxx controller as the host sees it: one answer a question."""

from __future__ import annotations

import struct

import numpy as np
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sensor import EmulatedSensor


class Msc7xxxEmulator:
    """One controller with one sensor.

    Parameters
    ----------
    plant : PlantStream
    sensor : EmulatedSensor
        Raw unit is volts.
    address : int
    """

    def __init__(self, plant: PlantStream, sensor: EmulatedSensor, *, address: int = 0x7E) -> None:
        self._plant = plant
        self._sensor = sensor
        self._question = bytes((0x10, address, 1, 0x4C, (address + 1 + 0x4C) % 256, 0x16))
        self._address = address
        self.power_cycle()

    @property
    def is_streaming(self) -> bool:
        """It never streams by itself; it counts as ready once it was asked."""
        return self._was_asked

    def power_cycle(self) -> None:
        """Forget everything."""
        self._incoming = b""
        self._was_asked = False

    def receive(self, commands: bytes, now_s: float) -> bytes:
        """Answer each whole question; answers to the same `now_s` hold the same value."""
        self._incoming += commands
        n = self._incoming.count(self._question)
        if not n:
            self._incoming = self._incoming[-len(self._question) :]
            return b""
        self._incoming = self._incoming.rpartition(self._question)[2]
        self._was_asked = True
        volts = float(self._sensor.raw(self._plant, np.array([now_s]))[0])
        body = bytes((1, self._address, 8)) + struct.pack("<ff", volts, 0.0)
        frame = bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) % 256, 0x16))
        return frame * n

    def advance(self, now_s: float) -> bytes:
        """Send nothing: it only answers."""
        del now_s
        return b""
