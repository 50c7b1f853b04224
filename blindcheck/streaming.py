"""The plant as a stream of measurements, for the instruments of a simulated bench."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.blindcheck.dynamics import OUTPUT_NAMES
from sawbench.blindcheck.plant import GRID_S, Floats, Plant, PlantSettings

_OUTPUT = MappingProxyType(
    {
        "force_n": ("force_n", 1.0, "force_noise_n"),
        "displacement_mm": ("plunger_m", 1e3, "displacement_noise_mm"),
        "motor_current_a": ("current_a", 1.0, "current_noise_a"),
        "battery_voltage_v": ("battery_v", 1.0, "voltage_noise_v"),
        "battery_current_a": ("battery_a", 1.0, "battery_current_noise_a"),
        # What a proximity switch beside the displacement sensor faces.
        "switch_mm": ("plunger_m", 1e3, "displacement_noise_mm"),
    }
)
_CHUNK_S = 0.25
_CHUNK_ROWS = round(_CHUNK_S / GRID_S)
_KEPT_S = 30.0


class StreamingPlant:
    """A plant that answers `read(channel, time_s)`; it is integrated ahead in chunks when asked.

    What a read returns depends only on the settings, the times, and when the tool was switched; not on how
    the times were split into calls. Before `trigger` the tool is at rest.

    Examples
    --------
    >>> import numpy as np
    >>> stream = StreamingPlant(PlantSettings(force_noise_n=0.0))
    >>> stream.trigger(0.2)
    0.2
    >>> stream.read("force_n", np.array([0.0, 0.1]))
    array([0., 0.])
    """

    def __init__(self, settings: PlantSettings) -> None:
        self.settings = settings
        self._plant = Plant(settings)
        rest = self._plant.advance(0.0)[0]
        rest[OUTPUT_NAMES.index("battery_a")] = 0.0
        self._rest = rest
        self._chunks: dict[int, Floats] = {}
        self._n_chunks = 0
        self._on_s: float | None = None
        self._latest_s = -np.inf
        self._cursor = dict.fromkeys(_OUTPUT, -np.inf)
        seeds = np.random.SeedSequence([settings.seed, 4]).spawn(len(_OUTPUT))
        self._noise = {name: np.random.default_rng(seed) for name, seed in zip(_OUTPUT, seeds, strict=True)}
        self._before_chunk = (self._plant.state.copy(), self._plant.time_s)

    def trigger(self, time_s: float) -> float:
        """Switch the tool on at `time_s`, or at the latest time already read if that is later.

        Returns
        -------
        float
            Time at which the tool was switched on, s.

        Raises
        ------
        InputError
            If the tool is on or was on before.
        """
        if self._on_s is not None:
            raise InputError("the tool has been switched on already", remedy="make a new StreamingPlant")
        self._on_s = max(float(time_s), self._latest_s)
        return self._on_s

    def release(self, time_s: float) -> float:
        """Switch the tool off at `time_s`, or at the latest time already read if that is later; it coasts.

        Returns
        -------
        float
            Time at which the tool was switched off, s.

        Raises
        ------
        InputError
            If the tool is not running.
        """
        if self._on_s is None or time_s < self._on_s or self._plant.record["is_on"][0] == 0.0:
            raise InputError(f"the tool is not running at {time_s!r} s, so it cannot be switched off")
        off_s = max(float(time_s), self._latest_s)
        index = int((off_s - self._on_s) // _CHUNK_S)
        self._fill(index)
        if self._n_chunks != index + 1:
            raise InputError(f"the plant has run on past {off_s!r} s")
        self._plant.state[:], self._plant.time_s = self._before_chunk
        self._n_chunks = index
        n_on = int((off_s - self._on_s - index * _CHUNK_S) / GRID_S)
        head = self._plant.advance(n_on * GRID_S)
        self._plant.switch_off()
        tail = self._plant.advance((_CHUNK_ROWS - n_on) * GRID_S)
        self._chunks[index] = np.concatenate([head[:-1], tail])
        self._n_chunks = index + 1
        return off_s

    def read(self, channel: str, time_s: Floats) -> Floats:
        """Return what the sensor of `channel` says at the times, in the channel's unit.

        Parameters
        ----------
        channel : str
            One of the five of `bench.units`, or `switch_mm`.
        time_s : ndarray, shape (n,), s
            Increasing within a call and from call to call.

        Returns
        -------
        ndarray, shape (n,)

        Raises
        ------
        InputError
            If the channel is unknown, the times go backwards, or lie more than 30 s behind another channel.
        """
        if channel not in _OUTPUT:
            raise InputError(f"the plant has no channel {channel!r}", remedy=f"choose from {', '.join(_OUTPUT)}")
        times = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        if not len(times):
            return np.empty(0)
        if np.any(np.diff(times) < 0) or times[0] < self._cursor[channel]:
            raise InputError(f"times of {channel} go backwards at {times[0]!r} s")
        self._cursor[channel] = float(times[-1])
        self._latest_s = max(self._latest_s, float(times[-1]))
        output, factor, noise_name = _OUTPUT[channel]
        values = factor * self._exact(OUTPUT_NAMES.index(output), times)
        sigma = float(getattr(self.settings, noise_name))
        return values + sigma * self._noise[channel].standard_normal(len(times))

    def _exact(self, index: int, times: Floats) -> Floats:
        """Interpolated output at the times, without noise."""
        values = np.full(len(times), self._rest[index])
        if self._on_s is None:
            return values
        since = times - self._on_s
        running = since >= 0.0
        if not running.any():
            return values
        chunk_of = (since // _CHUNK_S).astype(np.int64)
        for chunk in np.unique(chunk_of[running]):
            here = running & (chunk_of == chunk)
            rows = self._fill(int(chunk))
            position = (since[here] - chunk * _CHUNK_S) / GRID_S
            values[here] = np.interp(position, np.arange(len(rows)), rows[:, index])
        return values

    def _fill(self, chunk: int) -> Floats:
        """Integrate up to and including the chunk, and return its rows."""
        while self._n_chunks <= chunk:
            self._before_chunk = (self._plant.state.copy(), self._plant.time_s)
            self._chunks[self._n_chunks] = self._plant.advance(_CHUNK_S)
            self._n_chunks += 1
            self._chunks.pop(self._n_chunks - 1 - round(_KEPT_S / _CHUNK_S), None)
        if chunk not in self._chunks:
            raise InputError(f"the plant keeps {_KEPT_S:g} s; a channel lags further behind the others")
        return self._chunks[chunk]
