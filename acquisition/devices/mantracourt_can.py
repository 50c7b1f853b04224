"""Mantracourt DSC and DCell digitisers, MantraCAN protocol: polled, or a stream that the module was set to.

To the base identifier go descriptor (read: 1) and command number, from the identifier behind it come descriptor
(response: 6, refused: 21), command number and a float, high byte first. A module set to STRMTYPE 2 sends its message
between the start and the stop message, for which the manual's example takes those of CANopen (identifier 0, data 01 00
and 02 00). Source: DCell & DSC MantraCAN User Manual, chapters 8 and "Streaming Start / Stop Examples".
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from sawbench.acquisition.devices.can_instrument import CanInstrument, CanTable, require_slcan
from sawbench.acquisition.devices.device import Chunk, OneChannel, Stream
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.slcan_emulator import SentFrame, SlcanAdapter, line_of
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sampling import Sampler
from sawbench.acquisition.simulation.sensor import EmulatedSensor
from sawbench.acquisition.transports.can_batch import CanBatch, ParsedFrame
from sawbench.bench.errors import DeviceError

READ, RESPONSE, REFUSED = 0x01, 0x06, 0x15
START_MESSAGE: Final = ParsedFrame(0, False, b"\x01\x00")
STOP_MESSAGE: Final = ParsedFrame(0, False, b"\x02\x00")
_SYSTEM_OUTPUT: Final = 10
_ANSWER_WAIT_S: Final = 0.2


class MantracourtCanSettings(CanTable):
    """`[devices.NAME]` with `driver = "mantracourt_can"`.

    Attributes
    ----------
    channels : mapping of Channel to ChannelTable
        One channel, input 1; its raw value is in the unit the module is calibrated in.
    base_id : int
        Identifier of the module, 11 bit.
    command : int
        Number of what is read; 10 is SYS, the system output.
    stream_id : int, optional
        Identifier of the message that the module was set to send (STRMTYPE 2, start and stop messages of CANopen);
        without it the module is asked for each reading.
    stream_byte : int
        First byte of the float in that message, from 0.
    rate_hz : float
        Messages per second of the stream.
    """

    driver: str = "mantracourt_can"
    channels: OneChannel
    base_id: int = Field(default=1, ge=1, le=0x7FE)
    command: int = Field(default=_SYSTEM_OUTPUT, ge=0, le=255)
    stream_id: int | None = Field(default=None, ge=1, le=0x7FF)
    stream_byte: int = Field(default=0, ge=0, le=4)
    rate_hz: float = Field(default=0.0, ge=0, le=2000)

    @model_validator(mode="after")
    def _stream_has_a_rate(self) -> MantracourtCanSettings:
        if (self.stream_id is None) != (self.rate_hz == 0):
            raise ValueError("stream_id and rate_hz must be given together: give both for a stream, none for polling")
        return self


class MantracourtCan(CanInstrument[MantracourtCanSettings]):
    """One module; see `CanInstrument`."""

    MODEL = "MantraCAN"
    STREAM = "readings"

    def __init__(
        self, name: str, settings: MantracourtCanSettings, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(name, settings, clock=clock)
        self._is_polled = settings.stream_id is None

    @property
    def streams(self) -> tuple[Stream, ...]:
        """One stream of one channel."""
        return self._one_stream(self._settings.channels, self._settings.rate_hz)

    def open(self) -> None:
        """Join the bus, and ask once where the module is polled; see `Device.open`."""
        self._bus.open()
        if not self._is_polled:
            self._bus.send(STOP_MESSAGE)
        elif not self.read():
            raise self._no_answer(
                f"did not answer on identifier {self._settings.base_id}",
                "check power, `base_id` and `bitrate`, the two 120 ohm terminators, and CAN high and low",
            )

    def start(self) -> None:
        """Send the start message where the module streams."""
        if not self._is_polled:
            self._bus.send(START_MESSAGE)

    def read(self) -> list[Chunk]:
        """Return the samples that arrived, or ask for one."""
        if not self._is_polled:
            return super().read()
        asked_s = self._clock()
        self._bus.send(ParsedFrame(self._settings.base_id, False, bytes((READ, self._settings.command))))
        while self._clock() < asked_s + _ANSWER_WAIT_S:
            if chunks := self.answer(self._bus.read(), asked_s):
                return chunks
        return []

    def decode(self, batch: CanBatch) -> list[Chunk]:
        """Turn the frames of a stream into chunks; no input or output."""
        first = self._settings.stream_byte
        is_ours = (batch.identifier == np.uint32(self._settings.stream_id or 0)) & (batch.length >= first + 4)
        if not is_ours.any():
            return []
        raw = _floats(batch.payload[is_ours], first)
        return [Chunk(stream=self.STREAM, raw=raw[:, None], arrival_s=batch.arrival_s[is_ours])]

    def answer(self, batch: CanBatch, asked_s: float) -> list[Chunk]:
        """Turn the response to a question into a chunk; its time is the middle between the two.

        Raises
        ------
        DeviceError
            If the module refuses the question.
        """
        is_ours = batch.identifier == np.uint32(self._settings.base_id + 1)
        is_ours &= (batch.length >= 2) & (batch.payload[:, 1] == self._settings.command)
        if (is_ours & (batch.payload[:, 0] == REFUSED)).any():
            raise self._error(f"refused command number {self._settings.command}", "correct `command`")
        answers = np.flatnonzero(is_ours & (batch.payload[:, 0] == RESPONSE) & (batch.length >= 6))
        if not len(answers):
            return []
        arrival = batch.arrival_s[answers[-1:]]
        raw = _floats(batch.payload[answers[-1:]], 2)
        return [Chunk(stream=self.STREAM, raw=raw[:, None], arrival_s=arrival, time_s=0.5 * (asked_s + arrival))]

    def stop(self) -> None:
        """Send the stop message where the module streams, and leave the bus."""
        try:
            if not self._is_polled:
                self._bus.send(STOP_MESSAGE)
        except DeviceError:
            # Unplugged or never opened: nothing is left to be told to stop.
            pass
        finally:
            super().stop()

    def describe(self) -> dict[str, str]:
        """Model, identifier, where its times come from."""
        return {
            "model": self.MODEL,
            "base_id": str(self._settings.base_id),
            "time_source": "middle between question and answer" if self._is_polled else self._bus.time_source,
            **self._bus.facts,
        }


def _floats(payload: NDArray[np.uint8], first: int) -> NDArray[np.float64]:
    return np.ascontiguousarray(payload[:, first : first + 4]).view(">f4")[:, 0].astype(np.float64)


class MantracourtCanEmulator(SlcanAdapter):
    """An slcan adapter with one module behind it.

    Parameters
    ----------
    plant : PlantStream
    sensor : EmulatedSensor
    settings : MantracourtCanSettings
    clock_error_ppm : float
        How much faster than nominal its quartz runs.
    """

    def __init__(
        self, plant: PlantStream, sensor: EmulatedSensor, settings: MantracourtCanSettings, *, clock_error_ppm: float
    ) -> None:
        self._plant = plant
        self._sensor = sensor
        self._settings = settings
        self._sampler = Sampler(settings.rate_hz or 1.0, clock_error_ppm)
        super().__init__(bitrate=settings.bitrate)

    def power_cycle(self) -> None:
        """Not streaming."""
        super().power_cycle()
        self._sampler.end()

    def _due(self, now_s: float) -> list[SentFrame]:
        time_s = self._sampler.due(now_s)
        identifier, head = self._settings.stream_id or 0, bytes(self._settings.stream_byte)
        return [SentFrame(at_s, line_of(identifier, head + self._reading(at_s))) for at_s in time_s.tolist()]

    def _hear(self, identifier: int, payload: bytes, now_s: float) -> bytes:
        if identifier == 0 and payload == b"\x01\x00" and self._settings.stream_id is not None:
            self._sampler.begin(now_s)
        elif identifier == 0 and payload == b"\x02\x00":
            self._sampler.end()
        elif identifier == self._settings.base_id and payload[:1] == b"\x01" and len(payload) >= 2:
            is_known = payload[1] == self._settings.command
            answer = b"\x06" + payload[1:2] + self._reading(now_s) if is_known else b"\x15" + payload[1:2]
            return line_of(self._settings.base_id + 1, answer)
        return b""

    def _reading(self, at_s: float) -> bytes:
        return self._sensor.raw(self._plant, np.array([at_s])).astype(">f4").tobytes()


def emulate(
    name: str, settings: MantracourtCanSettings, plant: PlantStream, clock_error_ppm: float
) -> MantracourtCanEmulator:
    """Build an slcan adapter with the module of one validated table behind it."""
    require_slcan(name, settings.interface)
    ((channel, table),) = settings.channels.items()
    sensor = EmulatedSensor.of(channel, table)
    return MantracourtCanEmulator(plant, sensor, settings, clock_error_ppm=clock_error_ppm)


INSTRUMENT: Final = Instrument(
    settings=MantracourtCanSettings,
    make=MantracourtCan,
    emulate=emulate,
    example={
        "stream_id": 0x181,
        "rate_hz": 250.0,
        "channels": {"force_n": {"input": 1, "raw_range": [-9999, 9999], "calibration": {"raw_unit": "N"}}},
    },
    # The identifier of a stream is set by whoever installed the module; asked, every one answers.
    searched_as={
        "channels": {"force_n": {"input": 1, "raw_range": [-9999, 9999], "calibration": {"raw_unit": "N"}}},
    },
)
