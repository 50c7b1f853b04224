"""Motor and battery over CAN: whatever messages the DBC describes, one stream a message."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.can_signals import (
    J1939_SOURCE_MASK,
    counts_of,
    find_signal,
    frame_mask,
    is_available,
    load_dbc,
    needed_length,
    raw_signal,
)
from sawbench.acquisition.devices.can_instrument import CanInstrument, CanTable, require_slcan
from sawbench.acquisition.devices.dbc_can_emulator import CanEmulator, EmulatedMessage
from sawbench.acquisition.devices.device import BenchChannel, Chunk, Stream, StreamChannel
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.sample_counter import CountedStream
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.transports.can_batch import CanBatch
from sawbench.bench.errors import ConfigError
from sawbench.bench.units import Channel

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal as DbcSignal


class DbcCanSettings(CanTable):
    """`[devices.NAME]` with `driver = "dbc_can"`.

    Attributes
    ----------
    dbc : str
        DBC file; scaling, unit and range of the signals come from it.
    signals : mapping of Channel to str
        Bench channel -> `Message.Signal`.
    counter : str
        Signal that counts samples, looked for in each message used; "" if there is none.
    rate_hz : mapping of str to float
        Message -> rate, where the DBC states no cycle time.
    calibration : mapping of Channel to Calibration
        Bench channel -> correction of the DBC's physical value; usually not needed.
    noise_std : mapping of Channel to float
        Bench channel -> noise to expect at rest (1 std), in the channel's unit; `sawbench check` compares with it.
    """

    driver: str = "dbc_can"
    dbc: str = "jigsaw_bench.dbc"
    signals: dict[BenchChannel, str] = Field(min_length=1)
    counter: str = "SampleCounter"
    rate_hz: dict[str, Annotated[float, Field(gt=0)]] = Field(default_factory=dict)
    calibration: dict[BenchChannel, Calibration] = Field(default_factory=dict)
    noise_std: dict[BenchChannel, Annotated[float, Field(gt=0)]] = Field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class MessageLayout:
    """One message as this bench reads it.

    Attributes
    ----------
    stream : Stream
    message : cantools Message
    mask, wanted : int
        An identifier is this message where `identifier & mask == wanted`.
    n_bytes : int
        Shortest payload that holds every signal.
    signals : tuple of cantools Signal
        In the order of the stream's channels.
    counter : cantools Signal, optional
    """

    stream: Stream
    message: Message
    mask: int
    wanted: int
    n_bytes: int
    signals: tuple[DbcSignal, ...]
    counter: DbcSignal | None


def message_layouts(name: str, settings: DbcCanSettings) -> tuple[MessageLayout, ...]:
    """Resolve the configured signals in the DBC.

    Raises
    ------
    ConfigError
        If the DBC or a signal is missing, is multiplexed, has another unit than the channel, or has no rate.
    """
    where = f"[devices.{name}]"
    database = load_dbc(settings.dbc)
    by_message: dict[str, tuple[Message, list[tuple[Channel, DbcSignal]]]] = {}
    for channel, path in settings.signals.items():
        message, signal = find_signal(database, path, where=where)
        by_message.setdefault(message.name, (message, []))[1].append((channel, signal))
    _check_counter(where, settings, [message for message, _ in by_message.values()])
    return tuple(_layout(where, settings, message, pairs) for message, pairs in by_message.values())


def _check_counter(where: str, settings: DbcCanSettings, messages: list[Message]) -> None:
    """Refuse a counter that was asked for and is nowhere: lost frames would go unseen."""
    names = sorted({signal.name for message in messages for signal in message.signals})
    if "counter" in settings.model_fields_set and settings.counter and settings.counter not in names:
        raise ConfigError(
            f"counter is {settings.counter!r}, but none of the messages read has this signal",
            where=where,
            remedy=f'choose one of {", ".join(names)}, or counter = "" if there is no sample counter',
        )


def _layout(
    where: str, settings: DbcCanSettings, message: Message, pairs: list[tuple[Channel, DbcSignal]]
) -> MessageLayout:
    rate_hz = settings.rate_hz.get(message.name) or (1000.0 / message.cycle_time if message.cycle_time else 0.0)
    if not rate_hz:
        raise ConfigError(
            f"the DBC states no cycle time for {message.name}",
            where=where,
            remedy=f"add rate_hz = {{ {message.name} = 1000 }}",
        )
    counter = next((s for s in message.signals if s.name == settings.counter), None)
    used = [signal for _, signal in pairs] + ([counter] if counter else [])
    if any(signal.multiplexer_ids for signal in used):
        raise ConfigError(f"{message.name} is multiplexed, which this driver does not support", where=where)
    mask, wanted = frame_mask(message)
    channels = tuple(_channel(where, channel, signal, settings) for channel, signal in pairs)
    return MessageLayout(
        stream=Stream(name=message.name, rate_hz=rate_hz, channels=channels),
        message=message,
        mask=mask,
        wanted=wanted,
        n_bytes=needed_length(used),
        signals=tuple(signal for _, signal in pairs),
        counter=counter,
    )


def _channel(where: str, channel: Channel, signal: DbcSignal, settings: DbcCanSettings) -> StreamChannel:
    calibration = settings.calibration.get(channel)
    if calibration is None:
        if signal.unit and signal.unit != channel.unit:
            raise ConfigError(
                f"{signal.name} is in {signal.unit!r}, but {channel.name} is in {channel.unit!r}",
                where=where,
                remedy=f"add [devices.….calibration.{channel.name}] with the factor between them",
            )
        calibration = Calibration(raw_unit=channel.unit, source=f"scale and offset of {signal.name} in {settings.dbc}")
    has_range = signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum
    ends = np.array([signal.minimum, signal.maximum]) if has_range else np.array([-1e12, 1e12])
    low, high = sorted(float(v) for v in calibration.apply(ends))
    return StreamChannel(
        name=channel.name,
        unit=channel.unit,
        calibration=calibration,
        valid_range=(low, high),
        noise_std=settings.noise_std.get(channel),
        resolution=abs(float(signal.scale) * calibration.scale),
    )


class DbcCan(CanInstrument[DbcCanSettings]):
    """The instruments behind one CAN bus; see `CanInstrument`."""

    MODEL = "DBC"

    def __init__(self, name: str, settings: DbcCanSettings, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(name, settings, clock=clock)
        self._counted: dict[str, CountedStream] = {}
        # Message -> source address that is read, and what to say of others that send it.
        self._sources: dict[str, int] = {}
        self._warnings: dict[str, str] = {}
        self._warned: set[str] = set()
        self._n_other_frames = 0
        self._n_short_frames = 0

    @cached_property
    def layouts(self) -> tuple[MessageLayout, ...]:
        """Messages that are read; ConfigError if DBC and settings do not fit."""
        return message_layouts(self.name, self._settings)

    @property
    def streams(self) -> tuple[Stream, ...]:
        """One stream a message."""
        return tuple(layout.stream for layout in self.layouts)

    def open(self) -> None:
        """Open the bus; see `Device.open`."""
        _ = self.layouts
        self._counted.clear()
        self._sources.clear()
        self._warned.clear()
        self._bus.open()

    def decode(self, batch: CanBatch) -> list[Chunk]:
        """Turn frames into chunks; no input or output."""
        chunks: list[Chunk] = []
        n_taken = 0
        for layout in self.layouts:
            is_ours = (batch.identifier & np.uint32(layout.mask)) == np.uint32(layout.wanted)
            n_taken += int(np.count_nonzero(is_ours))
            is_ours = self._of_one_source(layout, batch, is_ours)
            is_whole = is_ours & (batch.length >= layout.n_bytes)
            self._n_short_frames += int(np.count_nonzero(is_ours) - np.count_nonzero(is_whole))
            if is_whole.any():
                chunks += self._chunks_of(layout, batch.payload[is_whole], batch.arrival_s[is_whole])
        self._n_other_frames += len(batch) - n_taken
        return chunks

    def describe(self) -> dict[str, str]:
        """Bus, DBC, where the times come from, frames that were not ours."""
        return {
            "bus": f"{self._settings.interface}, {self._settings.bitrate} bit/s",
            "dbc": self._settings.dbc,
            "messages": ", ".join(f"{s.name} at {s.rate_hz:g} Hz" for s in self.streams),
            "time_source": self._bus.time_source,
            "n_other_frames": str(self._n_other_frames),
            "n_short_frames": str(self._n_short_frames),
            **self._bus.facts,
        }

    def _chunks_of(
        self, layout: MessageLayout, payload: NDArray[np.uint8], arrival_s: NDArray[np.float64]
    ) -> list[Chunk]:
        name, raw = layout.stream.name, _physical(layout, payload)
        if layout.counter is None:
            chunks = [Chunk(stream=name, raw=raw, arrival_s=arrival_s)]
        else:
            first, n_counts = counts_of(layout.counter)
            if name not in self._counted:
                self._counted[name] = CountedStream(name, modulus=n_counts, rate_hz=layout.stream.rate_hz)
            chunks = self._counted[name].chunks(raw, raw_signal(layout.counter, payload) - first, arrival_s)
        if chunks and name in self._warnings:
            texts = (self._warnings.pop(name), chunks[0].warning)
            chunks[0] = replace(chunks[0], warning="; ".join(filter(None, texts)))
        return chunks

    def _of_one_source(self, layout: MessageLayout, batch: CanBatch, is_ours: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Where a message is of the source that sent it first: several may send a J1939 group, each its values."""
        if layout.mask & J1939_SOURCE_MASK or not is_ours.any():
            return is_ours
        name, source = layout.stream.name, batch.identifier & np.uint32(J1939_SOURCE_MASK)
        taken = self._sources.setdefault(name, int(source[is_ours][0]))
        others = np.unique(source[is_ours & (source != taken)])
        if len(others) and name not in self._warned:
            self._warned.add(name)
            addresses = ", ".join(f"{address:02X}" for address in others)
            text = f"{name}: source address {addresses} sends it too; {taken:02X} is read, which came first"
            self._warnings[name] = text
        return is_ours & (source == taken)


def _physical(layout: MessageLayout, payload: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Values of a message as the DBC scales them, shape (n, n_channels); NaN where one is not available."""
    columns: list[NDArray[np.float64]] = []
    for signal in layout.signals:
        raw = raw_signal(signal, payload)
        values = raw * float(signal.scale) + float(signal.offset)
        columns.append(np.where(is_available(signal, layout.message, raw), values, np.nan))
    return np.stack(columns, axis=1)


def make(name: str, settings: DbcCanSettings, clock: Callable[[], float]) -> DbcCan:
    """Build the device of one validated table and resolve its DBC, so that a wrong signal shows at once."""
    device = DbcCan(name, settings, clock=clock)
    _ = device.layouts
    return device


def emulate(name: str, settings: DbcCanSettings, plant: PlantStream, clock_error_ppm: float) -> CanEmulator:
    """Build an slcan adapter with the nodes of one validated table behind it.

    Raises
    ------
    ConfigError
        If the interface is another one.
    """
    require_slcan(name, settings.interface)
    database = load_dbc(settings.dbc)
    messages = tuple(
        EmulatedMessage(
            message=database.get_message_by_name(layout.stream.name),
            channels={s.name: c.name for s, c in zip(layout.signals, layout.stream.channels, strict=True)},
            counter=settings.counter if layout.counter is not None else "",
            rate_hz=layout.stream.rate_hz,
        )
        for layout in message_layouts(name, settings)
    )
    return CanEmulator(plant, messages, bitrate=settings.bitrate, clock_error_ppm=clock_error_ppm)


INSTRUMENT: Final = Instrument(
    settings=DbcCanSettings,
    make=make,
    emulate=emulate,
    example={"signals": {"motor_current_a": "MotorStatus.MotorCurrent"}},
)
