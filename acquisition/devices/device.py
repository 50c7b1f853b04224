"""What every instrument is to the recorder: streams of channels, chunks of samples, four verbs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo
from sawbench.acquisition.calibration import Calibration
from sawbench.bench.units import CHANNEL_BY_NAME, Channel

STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamChannel:
    """One channel of a stream.

    Attributes
    ----------
    name, unit : str
    calibration : Calibration
        Raw value to `unit`.
    valid_range : tuple of float
        Lowest and highest value the instrument can mean, in `unit`.
    noise_std : float, optional
        Expected standard deviation at rest, in `unit`; None where nobody said.
    resolution : float
        Smallest step, in `unit`; 0 where the instrument sends its noise too, so that no two samples need be equal.
    """

    name: str
    unit: str
    calibration: Calibration
    valid_range: tuple[float, float]
    noise_std: float | None = None
    resolution: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Stream:
    """Channels that an instrument samples together.

    Attributes
    ----------
    name : str
        Unique within the device.
    rate_hz : float
        Nominal rate; 0 where each sample carries its own time (polled instruments).
    channels : tuple of StreamChannel
    own_time : str
        Where the times come from, in words, where each sample carries its own.
    """

    name: str
    rate_hz: float
    channels: tuple[StreamChannel, ...]
    own_time: str = "middle between question and answer of each sample"

    @property
    def period_s(self) -> float:
        """Nominal time between two samples, s; 0 where each sample carries its own time."""
        return 1.0 / self.rate_hz if self.rate_hz > 0 else 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Chunk:
    """Samples of one stream that came without a break.

    Attributes
    ----------
    stream : str
    raw : ndarray, shape (n, n_channels)
        As sent, in the raw unit; columns in the order of `Stream.channels`.
    arrival_s : ndarray, shape (1,) or (n,), s
        When the newest sample (or each one) had arrived, monotonic clock.
    n_lost : int
        Samples known to be missing before the first one.
    is_loss_exact : bool
        Whether `n_lost` was counted (by a sample counter) or only bounded from below by broken bytes.
    time_s : ndarray, shape (n,), s, optional
        Monotonic time of each sample, where the instrument was asked for it.
    warning : str
        What the driver found wrong with the instrument here, once.
    """

    stream: str
    raw: NDArray[np.float64]
    arrival_s: NDArray[np.float64]
    n_lost: int = 0
    is_loss_exact: bool = True
    time_s: NDArray[np.float64] | None = None
    warning: str = ""


class Device(Protocol):
    """An instrument. The constructor does no input or output; `open` may be called again after `stop`."""

    name: str
    port: str

    @property
    def streams(self) -> tuple[Stream, ...]:
        """Streams it will deliver; rates are final once `open` returned."""
        ...

    @property
    def n_discarded_bytes(self) -> int:
        """Received bytes that were part of no valid frame, since construction."""
        ...

    def open(self) -> None:
        """Connect, identify, configure.

        Raises
        ------
        DeviceError
            If it is missing, or answers as another instrument would.
        """
        ...

    def start(self) -> None:
        """Make it send samples."""
        ...

    def read(self) -> list[Chunk]:
        """Return what arrived, waiting at most about 0.1 s; DeviceError if the link broke."""
        ...

    def stop(self) -> None:
        """Make it stop and close the link; never raises, may be called twice."""
        ...

    def describe(self) -> dict[str, str]:
        """Facts for the record: model, firmware, rates, where its times come from; `serial_number` where it has one."""
        ...


@runtime_checkable
class Receiver(Protocol):
    """A device that can receive now and decode later, all at once what was received several times."""

    def receive(self) -> None:
        """Take over what arrived, as `Device.read` does, and decode nothing."""
        ...

    def decoded(self) -> list[Chunk]:
        """Decode what was received since the last call; no input or output."""
        ...


def joined(before: Sequence[Chunk], after: Sequence[Chunk]) -> list[Chunk]:
    """Chunks of two reads, those that follow each other without a break as one.

    Where a chunk has one arrival for all its samples, that of the later one holds for both.
    """
    out = list(before)
    latest = {chunk.stream: k for k, chunk in enumerate(out)}
    for chunk in after:
        k = latest.pop(chunk.stream, None)
        if k is None or chunk.n_lost or not chunk.is_loss_exact or chunk.time_s is not None or chunk.warning:
            out.append(chunk)
            continue
        first = out[k]
        each_has_its_own = all(len(c.arrival_s) == len(c.raw) for c in (first, chunk))
        arrival_s = np.concatenate((first.arrival_s, chunk.arrival_s)) if each_has_its_own else chunk.arrival_s
        out[k] = replace(first, raw=np.concatenate((first.raw, chunk.raw)), arrival_s=arrival_s)
    return out


class ChannelTable(BaseModel):
    """`[devices.NAME.channels.CHANNEL]` of a multi-channel instrument.

    Attributes
    ----------
    input : int
        Input of the instrument the sensor is connected to, from 1.
    calibration : Calibration
    raw_range : tuple of float
        Lowest and highest raw value the input can mean; a sample outside was damaged on the way and becomes a
        gap.
    noise_std : float, optional
        Noise to expect at rest (1 std), in the channel's unit; `sawbench check` compares with it.
    """

    model_config = STRICT
    input: int
    calibration: Calibration = Calibration()
    raw_range: tuple[float, float] = (-1e9, 1e9)
    noise_std: float | None = Field(default=None, gt=0)

    def stream_channel(self, channel: Channel) -> StreamChannel:
        """Return `channel` with the range that `raw_range` maps to."""
        ends = sorted(float(v) for v in self.calibration.apply(np.array(self.raw_range)))
        return StreamChannel(
            name=channel.name,
            unit=channel.unit,
            calibration=self.calibration,
            valid_range=(ends[0], ends[1]),
            noise_std=self.noise_std,
        )


def _known_channel(name: Any, info: ValidationInfo) -> Any:
    """Turn a name into the channel of the bench; the context names those declared beyond `bench.units`."""
    known = (info.context or {}).get("channels", CHANNEL_BY_NAME)
    if not isinstance(name, str) or name not in known:
        raise ValueError(
            f"unknown channel {name!r}; channels are {', '.join(known)}; declare an additional channel as"
            f" [channels.{name}]"
        )
    return known[name]


# A key of a settings table: written as the channel's name, read as the channel with its unit.
BenchChannel = Annotated[Channel, BeforeValidator(_known_channel)]


def inputs_within(
    channels: dict[Channel, ChannelTable], highest: int, what: str = "inputs"
) -> dict[Channel, ChannelTable]:
    """Return `channels`; ValueError unless their inputs lie in 1..`highest` and no two are the same."""
    inputs = [channel.input for channel in channels.values()]
    if not all(1 <= i <= highest for i in inputs):
        raise ValueError(f"{what} are numbered 1..{highest}, got {inputs}")
    if len(set(inputs)) < len(inputs):
        raise ValueError(f"two channels read the same input: {inputs}")
    return channels


def _has_one_input(channels: dict[Channel, ChannelTable]) -> dict[Channel, ChannelTable]:
    for channel, table in channels.items():
        if table.input != 1:
            raise ValueError(f"{channel.name}: the instrument has one input, got input {table.input}")
    return channels


# `[devices.NAME.channels.CHANNEL]` of an instrument with one input.
OneChannel = Annotated[
    dict[BenchChannel, ChannelTable], Field(min_length=1, max_length=1), AfterValidator(_has_one_input)
]
