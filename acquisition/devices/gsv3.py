"""ME-Systeme GSV-3 strain-gauge amplifier on a serial port: driver and emulator.

A frame is `A5` and a big-endian 16-bit number x that stands for (x - 32768) / 32768 of full scale. Commands are
single bytes. Frames carry neither counter nor checksum, and the amplifier does not identify itself; its data rate is
set with the maker's program and compared with what arrives.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from sawbench.acquisition.devices.device import Chunk, OneChannel
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.serial_instrument import SerialInstrument, SerialTable
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sensor import EmulatedSensor

SET_ZERO: Final = b"\x0c"
STOP_TRANSMISSION: Final = b"\x23"
START_TRANSMISSION: Final = b"\x24"
_PREFIX: Final = 0xA5
_FRAME_BYTES: Final = 3
_ZERO_CODE: Final = 32768
_LAST_CODE: Final = 65535
# So many frames in a row make a new beginning after bytes were lost.
_FRAMES_TO_LOCK: Final = 6


class Gsv3Settings(SerialTable):
    """`[devices.NAME]` with `driver = "gsv3"`.

    Attributes
    ----------
    rate_hz : float
        Frames per second that the amplifier was set to.
    channels : mapping of Channel to ChannelTable
        One channel, input 1; its raw value is in the unit of `full_scale`.
    baud_rate : int
        Bit/s; a frame needs 30 bit, so 38400 Bd carry 1.28 kHz.
    full_scale : float
        Raw value at the largest code, mV/V.
    """

    driver: str = "gsv3"
    rate_hz: float = Field(default=1000.0, gt=0, le=1280)
    channels: OneChannel
    baud_rate: int = Field(default=38400, gt=0)
    full_scale: float = Field(default=2.0, gt=0)


class Gsv3Framer:
    """Find the frames in a byte stream, and find them again after bytes were lost or garbled.

    Notes
    -----
    `A5` may occur in the number too. While frames follow each other the next one begins where the last ended; after
    that fails, a beginning counts where six frames stand in a row, and of two such the one that continues the last
    value. The frame before a failure is dropped, as its number may hold bytes of the next. What the protocol
    cannot tell: three lost bytes; a garbled number; one lost byte while the upper byte of the numbers is `A5`.

    Examples
    --------
    >>> Gsv3Framer().feed(bytes.fromhex("a58000 a5c000"))
    (array([0. , 0.5]), 0)
    """

    def __init__(self) -> None:
        self._buffer = b""
        self._is_locked = True
        self._n_skipped = 0
        self._latest = 0.0
        self.n_discarded_bytes = 0

    def feed(self, received: bytes) -> tuple[NDArray[np.float64], int]:
        """Return what `received` completes.

        Returns
        -------
        values : ndarray, shape (n,)
            Shares of full scale; without a break since the last call, or since the frames that were lost.
        n_lost : int
            Frames lost before the first value, a lower bound; frames after a second break wait for the next call.
        """
        self._buffer += received
        if not self._is_locked and not self._lock():
            return np.empty(0), 0
        n_lost = -(-self._n_skipped // _FRAME_BYTES)
        frames = self._frames(0)
        is_good = frames[:, 0] == _PREFIX
        n_good = len(frames) if is_good.all() else int(np.argmin(is_good))
        taken = n_good
        if n_good < len(frames):
            self._is_locked = False
            taken = max(0, n_good - 1)
        self._skip(_FRAME_BYTES * taken, is_frame=True)
        values = _shares(frames[:taken])
        if taken:
            self._n_skipped, self._latest = 0, float(values[-1])
        return values, n_lost if taken else 0

    def _lock(self) -> bool:
        """Move to the next beginning; False where the bytes do not show one yet."""
        while len(self._buffer) >= _FRAME_BYTES * (_FRAMES_TO_LOCK + 1):
            candidates = [self._frames(k)[:_FRAMES_TO_LOCK] for k in range(_FRAME_BYTES)]
            sound = [k for k, frames in enumerate(candidates) if (frames[:, 0] == _PREFIX).all()]
            if sound:
                nearest = min(sound, key=lambda k: abs(float(_shares(candidates[k])[0]) - self._latest))
                self._skip(nearest)
                self._is_locked = True
                return True
            self._skip(_FRAME_BYTES)
        return False

    def _frames(self, offset: int) -> NDArray[np.uint8]:
        whole = (len(self._buffer) - offset) // _FRAME_BYTES * _FRAME_BYTES
        return np.frombuffer(self._buffer, np.uint8, whole, offset).reshape(-1, _FRAME_BYTES)

    def _skip(self, n_bytes: int, *, is_frame: bool = False) -> None:
        self._buffer = self._buffer[n_bytes:]
        if not is_frame:
            self._n_skipped += n_bytes
            self.n_discarded_bytes += n_bytes


def _shares(frames: NDArray[np.uint8]) -> NDArray[np.float64]:
    codes = frames[:, 1].astype(np.int64) * 256 + frames[:, 2]
    return _shares_of(codes)


def _shares_of(codes: Any) -> Any:
    """Share of full scale that a number stands for."""
    return (codes - _ZERO_CODE) / _ZERO_CODE


class Gsv3(SerialInstrument[Gsv3Settings, Gsv3Framer]):
    """One amplifier; see `SerialInstrument`."""

    MODEL = "GSV-3"

    def __init__(self, name: str, settings: Gsv3Settings, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(
            name, settings, Gsv3Framer(), clock=clock, rate_hz=settings.rate_hz, farewell=STOP_TRANSMISSION
        )

    def open(self) -> None:
        """Connect and stop the transmission; see `Device.open`."""
        self._link.open()
        self._link.write(STOP_TRANSMISSION)
        self._wait_until_quiet()
        self._begin_anew(Gsv3Framer())

    def start(self) -> None:
        """Start the continuous transmission."""
        self._link.write(START_TRANSMISSION)

    def decode(self, received: bytes, arrival_s: float) -> list[Chunk]:
        """Turn received bytes into chunks; no input or output."""
        shares, n_lost = self._framer.feed(received)
        if not len(shares):
            return []
        # An overloaded input stands on the first or last number: that is no measurement.
        is_overloaded = (shares <= _shares_of(0)) | (shares >= _shares_of(_LAST_CODE))
        raw = np.where(is_overloaded, np.nan, shares * self._settings.full_scale)[:, None]
        return [
            Chunk(
                stream=self.STREAM, raw=raw, arrival_s=np.array([arrival_s]), n_lost=n_lost, is_loss_exact=n_lost == 0
            )
        ]

    def set_zero(self, channel: str) -> None:
        """Make the present reading the zero of the amplifier (command 0C); it has one channel."""
        del channel
        self._link.write(SET_ZERO)

    def describe(self) -> dict[str, str]:
        """Model, rate, where its times come from."""
        return {
            "model": self.MODEL,
            "rate_hz": f"{self._settings.rate_hz:g}",
            "time_source": "sample count and arrival of the bytes at this machine",
            **self._link.facts,
        }


class Gsv3Emulator:
    """The amplifier as the host sees it.

    Parameters
    ----------
    plant : PlantStream
    sensor : EmulatedSensor
    settings : Gsv3Settings
    clock_error_ppm : float
        How much faster than nominal its quartz runs.
    """

    def __init__(
        self, plant: PlantStream, sensor: EmulatedSensor, settings: Gsv3Settings, *, clock_error_ppm: float = 0.0
    ) -> None:
        self._plant = plant
        self._sensor = sensor
        self._full_scale = settings.full_scale
        self._rate_hz = settings.rate_hz * (1.0 + clock_error_ppm * 1e-6)
        self.power_cycle()

    @property
    def is_streaming(self) -> bool:
        """Whether it sends frames."""
        return self._begun_s is not None

    def power_cycle(self) -> None:
        """Not transmitting, nothing zeroed."""
        self._begun_s: float | None = None
        self._n_sent = 0
        self._zero = self._latest = 0.0

    def receive(self, commands: bytes, now_s: float) -> bytes:
        """Obey each byte; nothing is answered."""
        for command in commands:
            if command == STOP_TRANSMISSION[0]:
                self._begun_s = None
            elif command == START_TRANSMISSION[0]:
                self._begun_s, self._n_sent = now_s, 0
            elif command == SET_ZERO[0]:
                self._zero = self._latest
        return b""

    def advance(self, now_s: float) -> bytes:
        """Frames of the samples up to `now_s`."""
        if self._begun_s is None:
            return b""
        n_due = math.floor((now_s - self._begun_s) * self._rate_hz) + 1
        if n_due <= self._n_sent:
            return b""
        raw = self._sensor.raw(self._plant, self._begun_s + np.arange(self._n_sent, n_due) / self._rate_hz)
        self._n_sent, self._latest = n_due, float(raw[-1])
        codes = np.round((raw - self._zero) / self._full_scale * 32768) + 32768
        frames = np.empty((len(raw), 3), dtype=np.uint8)
        frames[:, 0] = 0xA5
        frames[:, 1:] = np.clip(codes, 0, 65535).astype(">u2").view(np.uint8).reshape(-1, 2)
        return frames.tobytes()


def emulate(_name: str, settings: Gsv3Settings, plant: PlantStream, clock_error_ppm: float) -> Gsv3Emulator:
    """Build the amplifier of one validated table, seen from the other side."""
    ((channel, table),) = settings.channels.items()
    return Gsv3Emulator(plant, EmulatedSensor.of(channel, table), settings, clock_error_ppm=clock_error_ppm)


INSTRUMENT: Final = Instrument(
    settings=Gsv3Settings,
    make=Gsv3,
    emulate=emulate,
    example={"channels": {"force_n": {"input": 1, "raw_range": [-2.0, 2.0], "calibration": {"scale": 250.0}}}},
)
