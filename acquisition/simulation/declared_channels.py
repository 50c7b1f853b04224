"""Values for the channels that a bench declares beyond those of the plant."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.bench.units import CHANNEL_BY_NAME, Channel

_SWING_HZ: Final = 0.5
_SWING_SHARE: Final = 0.1


class DeclaredChannels:
    """A plant that answers for declared channels too: a slow sine in the middle of the plausible range.

    Parameters
    ----------
    plant : PlantStream
    channels : mapping of str to Channel
        All channels of the bench.
    """

    def __init__(self, plant: PlantStream, channels: Mapping[str, Channel]) -> None:
        self._plant = plant
        self._declared = {name: c for name, c in channels.items() if name not in CHANNEL_BY_NAME}

    def read(self, channel: str, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return sensor readings."""
        if channel not in self._declared:
            return self._plant.read(channel, time_s)
        low, high = self._declared[channel].plausible
        swing = _SWING_SHARE * (high - low) * np.sin(2.0 * np.pi * _SWING_HZ * np.asarray(time_s))
        return 0.5 * (low + high) + swing

    def trigger(self, time_s: float) -> object:
        """Switch the tool on."""
        return self._plant.trigger(time_s)
