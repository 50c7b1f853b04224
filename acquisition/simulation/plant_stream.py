"""What the simulated bench needs from a plant, and nothing more."""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

# What a proximity switch faces: the displacement, read beside the displacement sensor and with noise of its own.
SWITCH_CHANNEL: Final = "switch_mm"


class PlantStream(Protocol):
    """A tool with sensors, asked for what the sensors see."""

    def read(self, channel: str, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return sensor readings, noise included.

        Parameters
        ----------
        channel : str
            Name from `bench.units`, or `SWITCH_CHANNEL`.
        time_s : ndarray, shape (n,), s
            Bench time, increasing within a call and from call to call of the same channel.

        Returns
        -------
        ndarray, shape (n,), in the channel's unit
        """
        ...

    def trigger(self, time_s: float) -> object:
        """Switch the tool on at bench time `time_s`; before that it is at rest."""
        ...


class EmulatedInstrument(Protocol):
    """An emulated instrument: commands in, frames out, no ports and no clock of its own."""

    @property
    def is_streaming(self) -> bool:
        """Whether it sends samples."""
        ...

    def receive(self, commands: bytes, now_s: float) -> bytes:
        """Take bytes from the host at bench time `now_s`; return the answers."""
        ...

    def advance(self, now_s: float) -> bytes:
        """Return the frames of all samples up to bench time `now_s` that were not returned before."""
        ...

    def power_cycle(self) -> None:
        """Go back to the state after switching on."""
        ...
