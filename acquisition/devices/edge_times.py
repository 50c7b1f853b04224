"""Inductive switch that gives an edge a stroke, stamped by a microcontroller: a line with the time of each edge.

A proximity switch that faces a mark on crank or blade closes once a turn. A microcontroller catches the edge by
interrupt and prints `micros()`: a number alone, or one behind a label that ends in a colon. The samples are the edges
at their own times; their values are strokes per second since the edge before.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from sawbench.acquisition.devices.device import Chunk, OneChannel, Stream
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.lines import LABELLED_NUMBER, LineFormat, LineFramer
from sawbench.acquisition.devices.sample_rows import OWN_CLOCK
from sawbench.acquisition.devices.serial_instrument import SerialInstrument, SerialTable
from sawbench.acquisition.instrument_clock import InstrumentClock
from sawbench.acquisition.simulation.plant_stream import SWITCH_CHANNEL, PlantStream

Floats = NDArray[np.float64]
_LINE: Final = LineFormat(columns=(1,), pattern=LABELLED_NUMBER)
# A sample of a tool at rest is stamped this much before it was noticed: an edge may still be on its way.
_ON_ITS_WAY_S: Final = 0.1
_REST_EVERY_S: Final = 0.25
_EMULATED_STEP_S: Final = 1e-4
# Near the dead centre of the paper's jigsaw, far enough that vibration closes nothing twice.
_EMULATED_SWITCH_MM: Final = 10.0


class EdgeTimesSettings(SerialTable):
    """`[devices.NAME]` with `driver = "edge_times"`.

    Attributes
    ----------
    channels : mapping of Channel to ChannelTable
        One channel, input 1; its raw value is strokes per second.
    edges_per_stroke : int
        Marks that pass the switch in one stroke.
    tick_s : float
        Step of the stamps, s: 1e-6 for micros(), 1e-3 for millis().
    time_bits : int
        After which the stamps begin at 0 again.
    slowest_hz : float
        Slower strokes count as rest: samples of 0 then say that no edge came.
    """

    driver: str = "edge_times"
    channels: OneChannel
    edges_per_stroke: int = Field(default=1, ge=1, le=1000)
    tick_s: float = Field(default=1e-6, gt=0, le=1e-2)
    time_bits: int = Field(default=32, ge=16, le=53)
    slowest_hz: float = Field(default=1.0, ge=0.6)


class EdgeTimes(SerialInstrument[EdgeTimesSettings, LineFramer]):
    """One switch and its microcontroller; see `SerialInstrument`."""

    MODEL = "edge times"
    STREAM = "edges"

    def __init__(self, name: str, settings: EdgeTimesSettings, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(name, settings, LineFramer(_LINE), clock=clock)
        self._times = self._new_times()
        self._latest_stamp: float | None = None
        self._latest_s = 0.0
        self._n_lost = 0

    @property
    def streams(self) -> tuple[Stream, ...]:
        """One stream: every edge carries its own time."""
        (stream,) = super().streams
        return (replace(stream, own_time=OWN_CLOCK),)

    def open(self) -> None:
        """Connect; see `Device.open`. A tool at rest gives no edge, so that nothing can be waited for."""
        self._link.open()
        self._begin_anew(LineFramer(_LINE))
        self._times = self._new_times()
        self._latest_stamp = None
        self._latest_s = self._clock()
        self._n_lost = 0

    def start(self) -> None:
        """Nothing to do: the microcontroller sends by itself."""

    def decode(self, received: bytes, arrival_s: float) -> list[Chunk]:
        """Turn received bytes into chunks; no input or output."""
        chunks: list[Chunk] = []
        for piece in self._framer.feed(received):
            if piece.n_lost:
                # An interval across a lost edge is that of two strokes.
                self._latest_stamp = None
                self._n_lost += piece.n_lost
            chunks += self._edges(piece.values[:, 0], arrival_s)
        return chunks or self._rest(arrival_s)

    def describe(self) -> dict[str, str]:
        """Model, where its times come from."""
        return {"model": self.MODEL, "time_source": OWN_CLOCK, **self._link.facts}

    def _edges(self, stamps: Floats, arrival_s: float) -> list[Chunk]:
        time_s, is_used = self._times.times(stamps, arrival_s)
        if not is_used.all():
            self._latest_stamp = None
            self._n_lost += int((~is_used).sum())
        if not len(time_s):
            return []
        stamps = stamps[is_used]
        before = np.nan if self._latest_stamp is None else self._latest_stamp
        ticks = np.diff(stamps, prepend=before) % (1 << self._settings.time_bits)
        self._latest_stamp, self._latest_s = float(stamps[-1]), arrival_s
        strokes_hz = 1.0 / (self._settings.edges_per_stroke * self._settings.tick_s * np.maximum(ticks, 1.0))
        # The first edge, and the first one behind a rest, have none before them.
        is_stroke = strokes_hz >= self._settings.slowest_hz
        return self._chunk(strokes_hz[is_stroke], time_s[is_stroke], arrival_s) if is_stroke.any() else []

    def _rest(self, now_s: float) -> list[Chunk]:
        """Say at times that no edge came for longer than a stroke takes."""
        if now_s - self._latest_s < 1.0 / self._settings.slowest_hz + _REST_EVERY_S:
            return []
        self._latest_s = now_s - 1.0 / self._settings.slowest_hz
        return self._chunk(np.zeros(1), np.array([now_s - _ON_ITS_WAY_S]), now_s)

    def _chunk(self, strokes_hz: Floats, time_s: Floats, arrival_s: float) -> list[Chunk]:
        n_lost, self._n_lost = self._n_lost, 0
        return [
            Chunk(
                stream=self.STREAM, raw=strokes_hz[:, None], arrival_s=np.array([arrival_s]), time_s=time_s,
                n_lost=n_lost, is_loss_exact=False,
            )
        ]  # fmt: skip

    def _new_times(self) -> InstrumentClock:
        return InstrumentClock(tick_s=self._settings.tick_s, n_bits=self._settings.time_bits)


class EdgeTimesEmulator:
    """The switch: an edge wherever the displacement rises through its place.

    Parameters
    ----------
    plant : PlantStream
    settings : EdgeTimesSettings
    clock_error_ppm : float
        How much faster than nominal the microcontroller's quartz runs.
    """

    def __init__(self, plant: PlantStream, settings: EdgeTimesSettings, *, clock_error_ppm: float = 0.0) -> None:
        self._plant = plant
        self._settings = settings
        self._speed = 1.0 + clock_error_ppm * 1e-6
        self._n_looked = 0
        self._was_near = self._is_new = True

    @property
    def is_streaming(self) -> bool:
        """It always sends."""
        return True

    def power_cycle(self) -> None:
        """Look on from the next time on: nothing is remembered."""
        self._is_new = True

    def receive(self, commands: bytes, now_s: float) -> bytes:
        """Obey nothing."""
        del commands, now_s
        return b""

    def advance(self, now_s: float) -> bytes:
        """Lines of the edges up to `now_s`."""
        n_due = int(now_s / _EMULATED_STEP_S)
        if self._is_new:
            self._n_looked, self._is_new = n_due, False
        time_s = np.arange(self._n_looked, n_due, dtype=np.float64) * _EMULATED_STEP_S
        if not len(time_s):
            return b""
        self._n_looked = n_due
        lines = b""
        # The switch opens a millimetre further than it closes, as proximity switches do.
        for at_s, displacement_mm in zip(time_s, self._plant.read(SWITCH_CHANNEL, time_s), strict=True):
            if not self._was_near and displacement_mm > _EMULATED_SWITCH_MM:
                self._was_near = True
                ticks = round(at_s * self._speed / self._settings.tick_s)
                lines += b"%d\r\n" % (ticks % (1 << self._settings.time_bits))
            elif self._was_near and displacement_mm < _EMULATED_SWITCH_MM - 1.0:
                self._was_near = False
        return lines


INSTRUMENT: Final = Instrument(
    settings=EdgeTimesSettings,
    make=EdgeTimes,
    emulate=lambda _name, settings, plant, ppm: EdgeTimesEmulator(plant, settings, clock_error_ppm=ppm),
    example={"channels": {"stroke_rate_hz": {"input": 1, "raw_range": [-100, 100]}}},
    is_searched=False,
)
