"""What a recording tells while it runs and after it ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from types import MappingProxyType
from typing import Any, Literal, Protocol, runtime_checkable

from sawbench.bench.recording import Event, SampleBlock, loss_in_words


@runtime_checkable
class BlockWriter(Protocol):
    """Where blocks and events go: `storage.writer.RecordingWriter`, or anything like it."""

    def write_block(self, block: SampleBlock, /) -> Any:
        """Store one block."""
        ...

    def write_event(self, event: Event, /) -> Any:
        """Store one event."""
        ...

    def close(self, *, provenance: Mapping[str, str], is_complete: bool) -> Any:
        """Finish what was stored, with what only the end knows of it."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingStart:
    """What is known once all instruments stream, just before the first sample is stored.

    Attributes
    ----------
    started_at : datetime
        UTC of t = 0.
    provenance : mapping of str to str
        Alignment of each stream, calibration of each channel, facts about each instrument.
    """

    started_at: datetime
    provenance: Mapping[str, str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelStatus:
    """One channel, now or at the end.

    Attributes
    ----------
    device, channel, unit : str
    n_samples : int
        Stored.
    rate_hz : float
        Stored samples per second of stream time, gaps left out (0 until two samples are stored).
    n_gaps, n_missing : int
        Gaps, and samples that should have been in them.
    latest : float or None
        Newest value, in `unit`.
    """

    device: str
    channel: str
    unit: str
    n_samples: int
    rate_hz: float
    n_gaps: int
    n_missing: int
    latest: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingStatus:
    """Live counters, about five times a second.

    Attributes
    ----------
    elapsed_s : float
        Since t = 0.
    channels : tuple of ChannelStatus
    lost_devices : tuple of str
        Devices whose link is down at the moment.
    warnings : tuple of str
        What is wrong at the moment, see `live_warnings`.
    is_spoilt : bool
        One of them spoils the trial: it is not reliable if this goes on.
    phase : {"recording", "finishing"}
        "finishing": the end is decided, what is on its way is stored and the file closed.
    """

    elapsed_s: float
    channels: tuple[ChannelStatus, ...]
    lost_devices: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    is_spoilt: bool = False
    phase: Literal["recording", "finishing"] = "recording"

    @property
    def light(self) -> Literal["ok", "look", "stop"]:
        """One word for somebody who looks up for a second.

        "stop": a link is lost, a channel misses more than a hundredth of its samples, or a warning spoils the trial.
        "look": another warning, or a gap.
        """
        if self.lost_devices or self.is_spoilt or any(_loss(channel) for channel in self.channels):
            return "stop"
        return "look" if self.reasons else "ok"

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the light is not "ok", the gravest first."""
        lost = [f"the link to {device} is lost" for device in self.lost_devices]
        much = [text for text in map(_loss, self.channels) if text]
        little = [
            f"{c.channel}: {c.n_missing} samples are missing" for c in self.channels if c.n_missing and not _loss(c)
        ]
        return (*lost, *much, *self.warnings, *little)


@dataclass(frozen=True, kw_only=True, slots=True)
class DeviceSummary:
    """One instrument over the whole recording.

    Attributes
    ----------
    device, port : str
    n_discarded_bytes : int
        Received bytes that were part of no valid frame, while recording.
    n_reconnects : int
    facts : mapping of str to str
        What the instrument says of itself.
    """

    device: str
    port: str
    n_discarded_bytes: int
    n_reconnects: int
    facts: Mapping[str, str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "facts", MappingProxyType(dict(self.facts)))


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingSummary:
    """How a recording went.

    Attributes
    ----------
    started_at : datetime
        UTC of t = 0.
    duration_s : float
        Time of the last stored sample of any channel.
    end_reason : str
    is_complete : bool
        False where something other than the wish of the caller ended it, or an instrument was gone at the end.
    channels : tuple of ChannelStatus
    devices : tuple of DeviceSummary
    n_dropped_for_observers : int
        Blocks the live view was too slow for; the recording has them.
    provenance : mapping of str to str
        As in `RecordingStart`, with the alignment as it was at the end.
    """

    started_at: datetime
    duration_s: float
    end_reason: str
    is_complete: bool
    channels: tuple[ChannelStatus, ...]
    devices: tuple[DeviceSummary, ...]
    n_dropped_for_observers: int
    provenance: Mapping[str, str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    @property
    def losses(self) -> tuple[str, ...]:
        """Channels that miss more than a hundredth of their samples, in words; then the trial is not reliable."""
        return tuple(text for text in map(_loss, self.channels) if text)


def _loss(channel: ChannelStatus) -> str:
    return loss_in_words(channel.channel, channel.n_samples, channel.n_missing)
