"""A known weight or length at one sensor of the simulated bench, to practise a calibration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.simulation.plant_stream import PlantStream


class HeldLoad:
    """A plant whose sensor of one channel feels a constant more; see `PlantStream`.

    Parameters
    ----------
    plant : PlantStream
    channel : str
    load : float
        In the channel's unit.
    """

    def __init__(self, plant: PlantStream, channel: str, load: float) -> None:
        self._plant = plant
        self._channel = channel
        self._load = load

    def read(self, channel: str, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return sensor readings, the load included."""
        values = self._plant.read(channel, time_s)
        return values + self._load if channel == self._channel else values

    def trigger(self, time_s: float) -> object:
        """Switch the tool on."""
        return self._plant.trigger(time_s)
