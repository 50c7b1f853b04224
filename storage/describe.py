"""What is in an MCAP file, in outline; of a long recording without reading it whole."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from sawbench.bench.recording import Event, Gap, Recording, Signal, Trial
from sawbench.storage.content import Content
from sawbench.storage.pieces import content_pieces, is_long
from sawbench.storage.reader import read_content


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelInfo:
    """One channel of a recording at a glance.

    Attributes
    ----------
    channel, unit, device : str
    n_samples : int
    rate_hz : float
        Median sample rate, Hz.
    start_s, duration_s : float
        Of the samples, s on the recording's clock.
    gaps : tuple of Gap
    """

    channel: str
    unit: str
    device: str
    n_samples: int
    rate_hz: float
    start_s: float
    duration_s: float
    gaps: tuple[Gap, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicInfo:
    """One topic of an MCAP file: its name, message type, encoding and number of readable messages."""

    topic: str
    message_type: str
    encoding: str
    n_messages: int


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingInfo:
    """What is in an MCAP file.

    Attributes
    ----------
    path : str
    size_bytes : int
    is_sawbench : bool
        False for the MCAP of another program: then only `topics`, `size_bytes`, `software`, `problems` and
        `is_complete` (the end record is there and nothing is damaged) say something.
    is_complete : bool
    trial : Trial or None
    channels : tuple of ChannelInfo
    topics : tuple of TopicInfo
    events : tuple of Event
        With one for every damage.
    problems : tuple of str
        What is damaged, in words; empty for a whole file.
    software : str
        What wrote the file.
    has_config : bool
        Whether the bench configuration is in it.
    provenance : dict of str to str
    duration_s : float
        From the first to the last sample of any channel, s.
    """

    path: str
    size_bytes: int
    is_sawbench: bool
    is_complete: bool
    trial: Trial | None
    channels: tuple[ChannelInfo, ...]
    topics: tuple[TopicInfo, ...]
    events: tuple[Event, ...]
    problems: tuple[str, ...]
    software: str
    has_config: bool
    provenance: dict[str, str]
    duration_s: float


@dataclass(kw_only=True, slots=True)
class ChannelOutline:
    """One channel without its samples, put together piece by piece.

    Attributes
    ----------
    first : Signal
        Its first sample, with unit, device and alignment.
    end_s : float
        Time of the last sample, s.
    n_samples : int
    rates_hz : list of float
        Of each piece, Hz.
    gaps : list of Gap
    has_raw : bool
        Whether raw values are in all pieces.
    """

    first: Signal
    end_s: float = 0.0
    n_samples: int = 0
    rates_hz: list[float] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    has_raw: bool = True

    @classmethod
    def of(cls, signal: Signal) -> ChannelOutline:
        """Outline of no sample yet."""
        start = {name: getattr(signal, name)[:1] for name in ("time_s", "values")}
        return cls(first=replace(signal, **start, raw=None, gaps=()))

    def add(self, signal: Signal) -> None:
        """Take in the next piece."""
        self.end_s = float(signal.time_s[-1])
        self.n_samples += len(signal.time_s)
        self.rates_hz.append(signal.rate_hz)
        self.gaps += signal.gaps
        self.has_raw = self.has_raw and signal.raw is not None

    @property
    def rate_hz(self) -> float:
        """Median sample rate, Hz; of several pieces, the median of theirs."""
        return float(np.median(self.rates_hz))

    @property
    def n_missing(self) -> int:
        """Samples in all gaps."""
        return sum(gap.n_missing for gap in self.gaps)

    def info(self) -> ChannelInfo:
        """At a glance."""
        start_s = float(self.first.time_s[0])
        return ChannelInfo(
            channel=self.first.channel,
            unit=self.first.unit,
            device=self.first.device,
            n_samples=self.n_samples,
            rate_hz=self.rate_hz,
            start_s=start_s,
            duration_s=self.end_s - start_s,
            gaps=tuple(self.gaps),
        )


def outline_of(pieces: Iterable[Recording]) -> tuple[Recording, dict[str, ChannelOutline]]:
    """Say what pieces of a recording hold together.

    Parameters
    ----------
    pieces : iterable of Recording
        At least one; the whole recording, or what follows each other.

    Returns
    -------
    recording : Recording
        All but the samples.
    channels : dict of str to ChannelOutline
        Of those that have samples, in the order in which they first appear.
    """
    channels: dict[str, ChannelOutline] = {}
    events: list[Event] = []
    last = None
    for last in pieces:
        events += last.events
        for name, signal in last.signals.items():
            if len(signal.time_s):
                channels.setdefault(name, ChannelOutline.of(signal)).add(signal)
    assert last is not None
    return replace(last, signals={}, events=tuple(events)), channels


def describe_recording(path: str | Path) -> RecordingInfo:
    """Say what is in an MCAP file, also in one of another program; a long recording is read piece by piece.

    Raises
    ------
    RecordingError
        If the file is missing, is not an MCAP file or was written by a newer sawbench.
    """
    content = Content(path=Path(path))
    pieces = content_pieces(content) if is_long(path) else [read_content(content)]
    recording, outlines = outline_of(pieces)
    channels = tuple(outline.info() for outline in outlines.values())
    ends_s = [outline.end_s for outline in outlines.values()]
    # Other programs may leave checksums out, as the format allows; a recording of sawbench has them all.
    is_whole = content.scan.is_finished and not any(damage.n_bytes for damage in content.scan.damages)
    return RecordingInfo(
        path=str(path),
        size_bytes=content.path.stat().st_size,
        is_sawbench=content.is_sawbench,
        is_complete=content.is_complete if content.is_sawbench else is_whole,
        trial=recording.trial if content.is_sawbench else None,
        channels=channels,
        topics=_topics(content),
        events=recording.events if content.is_sawbench else (),
        problems=(*(damage.what for damage in content.scan.damages), *content.problems),
        software=content.provenance.get("software", content.library),
        has_config=bool(content.config_toml),
        provenance=dict(content.provenance),
        duration_s=max(ends_s) - min(channel.start_s for channel in channels) if channels else 0.0,
    )


def _topics(content: Content) -> tuple[TopicInfo, ...]:
    rows = []
    for channel_id in sorted(content.topics.keys() | content.n_messages.keys()):
        topic, message_type = content.topics.get(channel_id, (f"unknown topic {channel_id}", ""))
        channel = content.channels.get(channel_id)
        rows.append(
            TopicInfo(
                topic=topic,
                message_type=message_type,
                encoding=channel.message_encoding if channel else "",
                n_messages=content.n_messages.get(channel_id, 0),
            )
        )
    return tuple(rows)
