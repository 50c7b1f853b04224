"""A measured trial as a stream of what its sensors say, for the instruments of a simulated bench."""

from __future__ import annotations

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.blindcheck.plant import Floats
from sawbench.blindcheck.readings import Readings


class Playback:
    """Readings that begin when the tool is switched on; before and after, every sensor stands still.

    Parameters
    ----------
    readings : Readings
        Sampled several times as fast as the instruments do: what they ask for lies on the line between two samples.

    Examples
    --------
    >>> played = Playback(Readings(time_s=np.array([0.0, 0.1]), values={"force_n": np.array([0.0, 5.0])}))
    >>> played.trigger(2.0)
    2.0
    >>> played.read("force_n", np.array([1.0, 2.06, 9.0]))
    array([0., 3., 5.])
    """

    def __init__(self, readings: Readings) -> None:
        self._readings = readings
        self._on_s = np.inf

    @property
    def seconds(self) -> float:
        """Length of the trial."""
        return float(self._readings.time_s[-1])

    def trigger(self, time_s: float) -> float:
        """Begin at `time_s`, which is returned."""
        self._on_s = float(time_s)
        return self._on_s

    def read(self, channel: str, time_s: Floats) -> Floats:
        """Return what the sensor of `channel` says at the times (s), shape (n,), in the channel's unit.

        Raises
        ------
        InputError
            If the trial has no such channel.
        """
        if channel not in self._readings.values:
            raise InputError(f"the trial has no channel {channel!r}")
        since_s = np.maximum(np.asarray(time_s, dtype=np.float64) - self._on_s, 0.0)
        return np.interp(since_s, self._readings.time_s, self._readings.values[channel])
