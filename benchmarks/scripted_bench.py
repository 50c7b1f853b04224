"""The simulated bench in time that is scripted: the same bytes, drivers and clocks, as fast as they can be worked off.

Every instrument answers in the thread that reads it, so what a recording holds depends on the settings and the seed,
not on the machine. Bytes wait for the tick at which the host looks, as they do in the buffers of an adapter, and each
link has a latency of its own, with a scatter on top.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import TracebackType
from typing import Final

import numpy as np
from sawbench.acquisition.simulation.bench_server import TICK_S, make_instruments
from sawbench.acquisition.simulation.plant_stream import EmulatedInstrument, PlantStream
from sawbench.bench.config import BenchConfig

from benchmarks import protocol_emulated

# Mean of what a read comes late by beside the constant latency: an idle desktop machine wakes a thread in that time.
_WAKE_S: Final = 1e-4


class ScriptedBench:
    """Every instrument of a configuration on `emulated://` ports; plugged in while the context lasts.

    Parameters
    ----------
    plant : PlantStream
    config : BenchConfig
    latency_s : mapping of str to float, optional
        Device -> constant latency of its link, s; 0 unless given.
    clock_error_ppm : mapping of str to float, optional
        See `bench_server.make_instruments`.
    trigger_after_s : float
        The tool is switched on this long after all instruments stream, s.
    seed : int
        Of the scatter of the latencies.

    Attributes
    ----------
    endpoints : dict of str to str
        Device -> port.
    """

    def __init__(
        self,
        plant: PlantStream,
        config: BenchConfig,
        *,
        latency_s: Mapping[str, float] | None = None,
        clock_error_ppm: Mapping[str, float] | None = None,
        trigger_after_s: float = 1.0,
        seed: int = 0,
    ) -> None:
        self._plant = plant
        self._instruments = make_instruments(plant, config, clock_error_ppm=clock_error_ppm)
        self._trigger_after_s = trigger_after_s
        self._rng = np.random.default_rng(seed)
        self._tick = 0
        self._woken_s = self._seen_s = 0.0
        self._stream_since_s: float | None = None
        self._is_triggered = self._is_stepped = False
        self.endpoints = {name: f"emulated://{id(self)}/{name}" for name in self._instruments}
        waits = {name: (latency_s or {}).get(name, 0.0) for name in self._instruments}
        self._plugs = {
            self.endpoints[name]: _Plug(instrument, partial(self._look, waits[name]), self._wait_for_more)
            for name, instrument in self._instruments.items()
        }

    def __enter__(self) -> ScriptedBench:
        protocol_emulated.PLUGS.update(self._plugs)
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        for port in self._plugs:
            protocol_emulated.PLUGS.pop(port, None)

    def clock(self) -> float:
        """Monotonic seconds as the host sees them: the time of the latest read."""
        return self._seen_s

    def step(self) -> None:
        """Go on to the next tick: everything that the instruments send until then waits for the host."""
        self._is_stepped = True
        self._go_on()

    def _wait_for_more(self) -> None:
        """Go on while instruments are opened: nobody steps, and a read waits for what comes."""
        if not self._is_stepped:
            self._go_on()

    def _go_on(self) -> None:
        self._tick += 1
        self._woken_s = self._seen_s = max(self._seen_s, self._tick * TICK_S) + float(self._rng.exponential(_WAKE_S))
        if self._stream_since_s is None and all(i.is_streaming for i in self._instruments.values()):
            self._stream_since_s = self._woken_s
        if (
            not self._is_triggered
            and self._stream_since_s is not None
            and self._woken_s >= self._stream_since_s + self._trigger_after_s
        ):
            self._is_triggered = True
            self._plant.trigger(self._woken_s)
        for plug in self._plugs.values():
            plug.send_until(self._woken_s)

    def _look(self, latency_s: float) -> float:
        """Time at which commands arrive, which is that of the tick; what waits is seen later by the link's latency."""
        self._seen_s = self._woken_s + latency_s + float(self._rng.exponential(_WAKE_S))
        return self._woken_s


class _Plug:
    """One instrument and what it has sent."""

    def __init__(
        self, instrument: EmulatedInstrument, look: Callable[[], float], wait_for_more: Callable[[], None]
    ) -> None:
        self._instrument, self._look, self._wait_for_more = instrument, look, wait_for_more
        self._waiting = b""

    def send_until(self, now_s: float) -> None:
        self._waiting += self._instrument.advance(now_s)

    def write(self, data: bytes, /) -> None:
        self._waiting += self._instrument.receive(data, self._look())

    def read(self) -> bytes:
        if not self._waiting:
            self._wait_for_more()
        self._look()
        waiting, self._waiting = self._waiting, b""
        return waiting
