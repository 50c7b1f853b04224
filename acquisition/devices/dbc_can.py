"""Motor and battery over CAN: whatever messages the DBC describes, one stream a message."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, Field

from acquisition.calibration import Calibration
from acquisition.can_signals import find_signal, frame_mask, load_dbc, needed_length, raw_signal
from acquisition.devices.device import STRICT, Chunk, Stream, StreamChannel, known_channel
from acquisition.transports.can_batch import CanBatch
from acquisition.transports.can_bus import make_can_source
from bench.errors import ConfigError
from bench.units import CHANNEL_BY_NAME

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal as DbcSignal

# A counter that jumps by more than this share of its range was restarted, not overrun.
_RESTART_SHARE: Final = 0.5
ChannelName = Annotated[str, AfterValidator(known_channel)]


class DbcCanSettings(BaseModel):
    """`[devices.NAME]` with `driver = "dbc_can"`.

    Attributes
    ----------
    interface : str
        Interface of python-can (slcan, socketcan, pcan, virtual, ...).
    port : str
        Its channel: a serial port for slcan, `can0` for socketcan.
    bitrate : int
        Of the bus, bit/s.
    baud_rate : int
        Of the adapter's serial port, bit/s (slcan only).
    dbc : str
        DBC file; scaling, unit and range of the signals come from it.
    signals : mapping of str to str
        Bench channel -> `Message.Signal`.
    counter : str
        Signal that counts samples, looked for in each message used; "" if there is none.
    rate_hz : mapping of str to float
        Message -> rate, where the DBC states no cycle time.
    calibration : mapping of str to Calibration
        Bench channel -> correction of the DBC's physical value; usually not needed.
    noise_std : mapping of str to float
        Bench channel -> noise to expect at rest (1 std), in the channel's unit; `sawbench check` compares with it.
    """

    model_config = STRICT
    driver: str = "dbc_can"
    interface: str = "slcan"
    port: str
    bitrate: int = Field(default=500_000, gt=0)
    baud_rate: int = Field(default=115200, gt=0)
    dbc: str = "jigsaw_bench.dbc"
    signals: dict[ChannelName, str] = Field(min_length=1)
    counter: str = "SampleCounter"
    rate_hz: dict[str, Annotated[float, Field(gt=0)]] = Field(default_factory=dict)
    calibration: dict[ChannelName, Calibration] = Field(default_factory=dict)
    noise_std: dict[ChannelName, Annotated[float, Field(gt=0)]] = Field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class MessageLayout:
    """One message as this bench reads it.

    Attributes
    ----------
    stream : Stream
    mask, wanted : int
        An identifier is this message where `identifier & mask == wanted`.
    n_bytes : int
        Shortest payload that holds every signal.
    signals : tuple of cantools Signal
        In the order of the stream's channels.
    counter : cantools Signal, optional
    """

    stream: Stream
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
    by_message: dict[str, tuple[Message, list[tuple[str, DbcSignal]]]] = {}
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
            f"counter is {settings.counter!r}, but no message that is read has such a signal",
            where=where,
            remedy=f'choose one of {", ".join(names)}, or counter = "" if none counts samples',
        )


def _layout(
    where: str, settings: DbcCanSettings, message: Message, pairs: list[tuple[str, DbcSignal]]
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
        raise ConfigError(f"{message.name} is multiplexed, which this driver does not read live", where=where)
    mask, wanted = frame_mask(message)
    channels = tuple(_channel(where, channel, signal, settings) for channel, signal in pairs)
    return MessageLayout(
        stream=Stream(name=message.name, rate_hz=rate_hz, channels=channels),
        mask=mask,
        wanted=wanted,
        n_bytes=needed_length(used),
        signals=tuple(signal for _, signal in pairs),
        counter=counter,
    )


def _channel(where: str, channel: str, signal: DbcSignal, settings: DbcCanSettings) -> StreamChannel:
    unit = CHANNEL_BY_NAME[channel].unit
    calibration = settings.calibration.get(channel)
    if calibration is None:
        if signal.unit and signal.unit != unit:
            raise ConfigError(
                f"{signal.name} is in {signal.unit!r}, but {channel} is in {unit!r}",
                where=where,
                remedy=f"add [devices.….calibration.{channel}] with the factor between them",
            )
        calibration = Calibration(raw_unit=unit, source=f"scale and offset of {signal.name} in {settings.dbc}")
    has_range = signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum
    ends = np.array([signal.minimum, signal.maximum]) if has_range else np.array([-1e12, 1e12])
    low, high = sorted(float(v) for v in calibration.apply(ends))
    return StreamChannel(
        name=channel,
        unit=unit,
        calibration=calibration,
        valid_range=(low, high),
        noise_std=settings.noise_std.get(channel),
        resolution=abs(float(signal.scale) * calibration.scale),
    )


class DbcCan:
    """The instruments behind one CAN bus.

    Parameters
    ----------
    name : str
        Of the device table.
    settings : DbcCanSettings
    clock : callable
        Monotonic seconds.
    """

    Settings = DbcCanSettings

    def __init__(self, name: str, settings: DbcCanSettings, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.name = name
        self.port = settings.port
        self._settings = settings
        self._clock = clock
        self._bus = make_can_source(
            settings.interface,
            settings.port,
            device=name,
            bitrate=settings.bitrate,
            baud_rate=settings.baud_rate,
            clock=clock,
        )
        self._last_count: dict[str, int] = {}
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

    @property
    def n_discarded_bytes(self) -> int:
        """Received bytes that were part of no valid frame, since construction."""
        return self._bus.n_discarded_bytes

    def open(self) -> None:
        """Open the bus; see `Device.open`."""
        _ = self.layouts
        self._last_count.clear()
        self._bus.open()

    def start(self) -> None:
        """Nothing to do: nodes on a bus send by themselves."""

    def read(self) -> list[Chunk]:
        """Return the samples that arrived; wait at most 0.1 s for the first frame."""
        return self.decode(self._bus.read())

    def decode(self, batch: CanBatch) -> list[Chunk]:
        """Turn frames into chunks; no input or output."""
        chunks: list[Chunk] = []
        n_taken = 0
        for layout in self.layouts:
            is_ours = (batch.identifier & np.uint32(layout.mask)) == np.uint32(layout.wanted)
            n_taken += int(np.count_nonzero(is_ours))
            is_whole = is_ours & (batch.length >= layout.n_bytes)
            self._n_short_frames += int(np.count_nonzero(is_ours) - np.count_nonzero(is_whole))
            if is_whole.any():
                chunks += self._chunks_of(layout, batch.payload[is_whole], batch.arrival_s[is_whole])
        self._n_other_frames += len(batch) - n_taken
        return chunks

    def stop(self) -> None:
        """Leave the bus."""
        self._bus.close()

    def describe(self) -> dict[str, str]:
        """Bus, DBC, where the times come from, frames that were not ours."""
        return {
            "bus": f"{self._settings.interface}, {self._settings.bitrate} bit/s",
            "dbc": self._settings.dbc,
            "messages": ", ".join(f"{s.name} at {s.rate_hz:g} Hz" for s in self.streams),
            "time_source": self._bus.time_source,
            "n_other_frames": str(self._n_other_frames),
            "n_short_frames": str(self._n_short_frames),
        }

    def _chunks_of(
        self, layout: MessageLayout, payload: NDArray[np.uint8], arrival_s: NDArray[np.float64]
    ) -> list[Chunk]:
        columns = [
            raw_signal(signal, payload) * float(signal.scale) + float(signal.offset) for signal in layout.signals
        ]
        raw = np.stack(columns, axis=1)
        if layout.counter is None:
            return [Chunk(stream=layout.stream.name, raw=raw, arrival_s=arrival_s)]
        counts = raw_signal(layout.counter, payload).astype(np.int64)
        keep, n_lost, is_exact = self._lost_before(layout, counts)
        raw, arrival_s, n_lost, is_exact = raw[keep], arrival_s[keep], n_lost[keep], is_exact[keep]
        starts = np.flatnonzero((n_lost > 0) | ~is_exact)
        edges = sorted({0, *starts.tolist(), len(raw)})
        return [
            Chunk(
                stream=layout.stream.name,
                raw=raw[a:b],
                arrival_s=arrival_s[a:b],
                n_lost=int(n_lost[a]),
                is_loss_exact=bool(is_exact[a]),
            )
            for a, b in pairwise(edges)
        ]

    def _lost_before(
        self, layout: MessageLayout, counts: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.bool_]]:
        """For each frame: keep it (not a repeat), samples lost before it, and whether that was counted."""
        assert layout.counter is not None
        modulus = 1 << layout.counter.length
        last = self._last_count.get(layout.stream.name)
        before = np.concatenate(([counts[0] - 1 if last is None else last], counts[:-1]))
        step = (counts - before) % modulus
        keep = step != 0
        restarted = step > _RESTART_SHARE * modulus
        n_lost = np.where(restarted | ~keep, 0, step - 1)
        self._last_count[layout.stream.name] = int(counts[-1])
        return keep, n_lost, ~restarted


def make(name: str, settings: Any, clock: Callable[[], float]) -> DbcCan:
    """Build the device of one validated table and resolve its DBC, so that a wrong signal shows at once."""
    device = DbcCan(name, settings, clock=clock)
    _ = device.layouts
    return device
