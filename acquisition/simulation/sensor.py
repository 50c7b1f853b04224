"""A sensor on an input of an emulated instrument: what the plant feels -> what the converter reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.bench.errors import ConfigError
from sawbench.bench.units import Channel

if TYPE_CHECKING:
    from sawbench.acquisition.devices.device import ChannelTable

_CONVERTER_STEPS: Final = 1 << 24
_LARGEST_RAW_SPAN: Final = 1e6


@dataclass(frozen=True, kw_only=True, slots=True)
class EmulatedSensor:
    """A sensor on an input.

    Attributes
    ----------
    channel : str
        Of the plant.
    input : int
        From 1.
    scale, offset, zero_raw : float
        value = offset + scale * (raw - zero_raw), as the configuration says.
    quantum : float
        Step of the converter, in the raw unit.
    """

    channel: str
    input: int
    scale: float
    offset: float = 0.0
    zero_raw: float = 0.0
    quantum: float = 0.0

    @classmethod
    def of(cls, channel: Channel, table: ChannelTable) -> EmulatedSensor:
        """Return the sensor that a channel table describes, on a 24-bit converter over its raw range.

        Raises
        ------
        ConfigError
            If the calibration is a polynomial.
        """
        calibration = table.calibration
        if calibration.polynomial is not None:
            raise ConfigError(f"{channel.name} has a polynomial calibration, which cannot be emulated")
        low, high = table.raw_range
        return cls(
            channel=channel.name,
            input=table.input,
            scale=calibration.scale,
            offset=calibration.offset,
            zero_raw=calibration.zero_raw,
            quantum=(high - low) / _CONVERTER_STEPS if high - low < _LARGEST_RAW_SPAN else 0.0,
        )

    def raw(self, plant: PlantStream, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Readings at bench times `time_s`, shape (n,), in the raw unit."""
        raw = self.zero_raw + (plant.read(self.channel, time_s) - self.offset) / self.scale
        return np.round(raw / self.quantum) * self.quantum if self.quantum > 0 else raw
