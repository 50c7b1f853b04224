"""What the sensors of a simulated bench read where its configuration states a gain or an offset."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.bench.config import SensorConfig


class SensorReadings:
    """A plant whose sensors read as `[sensors]` says, so that processing finds the true values; see `PlantStream`.

    Parameters
    ----------
    plant : PlantStream
    sensors : mapping of str to SensorConfig
        By channel; others read the true values.
    """

    def __init__(self, plant: PlantStream, sensors: Mapping[str, SensorConfig]) -> None:
        self._plant = plant
        self._sensors = sensors

    def read(self, channel: str, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return sensor readings."""
        values = self._plant.read(channel, time_s)
        return self._sensors[channel].reading(values) if channel in self._sensors else values

    def trigger(self, time_s: float) -> object:
        """Switch the tool on."""
        return self._plant.trigger(time_s)
