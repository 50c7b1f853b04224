"""A long recording, so much of it at a time as fits into memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from google.protobuf.message import DecodeError
from mcap.reader import SeekingReader
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Event, Gap, Recording, SampleBlock, Signal, Trial
from sawbench.storage.amendments import amended
from sawbench.storage.assembly import join_blocks
from sawbench.storage.codec import EVENT_TOPIC, SIGNAL_TOPIC, decode_event
from sawbench.storage.container import BROKEN
from sawbench.storage.content import Content, damage_events, iter_samples, require_sawbench
from sawbench.storage.reader import alignment_of

# A recording with more samples than this is read piece by piece, of so many samples each.
LONG_FROM_SAMPLES: Final = 12_000_000
SAMPLES_A_PIECE: Final = 4_000_000
# More samples than this are not read at once: 16 bytes each, several times over, would not be left to other programs.
MOST_AT_ONCE: Final = 60_000_000
_BYTES_A_VALUE: Final = 8


def is_long(path: str | Path, n_samples: int = LONG_FROM_SAMPLES) -> bool:
    """Whether a recording holds so much that it is better read piece by piece.

    Asked of the summary of the file; one without, because it was cut off, is not called long.

    Parameters
    ----------
    path : str or Path
    n_samples : int
        Over all channels.
    """
    summary = _summary(Path(path))
    return summary is not None and summary[1] > _BYTES_A_VALUE * n_samples


def _summary(path: Path) -> tuple[dict[str, int], int] | None:
    """Blocks of each channel, and bytes of all chunks when unpacked; None where the file does not say."""
    try:
        with path.open("rb") as stream:
            summary = SeekingReader(stream).get_summary()
    except (OSError, ValueError, LookupError, AssertionError, *BROKEN):
        return None
    if summary is None or summary.statistics is None:
        return None
    counts = summary.statistics.channel_message_counts
    n_blocks = {
        channel.topic.removeprefix(SIGNAL_TOPIC): counts.get(number, 0)
        for number, channel in summary.channels.items()
        if channel.topic.startswith(SIGNAL_TOPIC)
    }
    if not n_blocks:
        return None
    return n_blocks, sum(chunk.uncompressed_size for chunk in summary.chunk_indexes)


def read_pieces(path: str | Path, n_samples: int = SAMPLES_A_PIECE, *, with_raw: bool = False) -> Iterator[Recording]:
    """Yield a recording piece by piece, cut at the same time in all channels.

    Parameters
    ----------
    path : str or Path
    n_samples : int
        Of a piece, over all channels; the last one holds half as many to one and a half times as many.
    with_raw : bool
        Also the raw values.

    Yields
    ------
    Recording
        Times are those of the whole recording. A gap at a cut belongs to the piece behind it; what is damaged, and
        that the recording is incomplete, is told by the last piece.

    Raises
    ------
    RecordingError
        As `read_recording`.
    """
    return content_pieces(Content(path=Path(path)), n_samples, with_raw=with_raw)


def content_pieces(
    content: Content, n_samples: int = SAMPLES_A_PIECE, *, with_raw: bool = False
) -> Iterator[Recording]:
    """Yield the pieces of a file; `content`, with its `path`, receives the rest. See `read_pieces`."""
    summary = _summary(content.path)
    pending = _Pending(
        blocks_left=dict(summary[0]) if summary else {},
        is_told=summary is not None,
        with_raw=with_raw,
    )
    # Known once samples come. Amendments name the file by its hash, which is worked out once, not with each piece.
    trial: Trial | None = None
    for item in iter_samples(content):
        if isinstance(item, Event):
            pending.events.append(item)
            continue
        pending.add(item)
        if pending.n_samples >= 1.5 * n_samples:
            end_s = pending.cut_s(n_samples)
            if end_s is not None:
                trial = trial or amended(content.trial(), content.path)
                yield _piece(content, trial, pending, end_s)
    require_sawbench(content)
    trial = trial or amended(content.trial(), content.path)
    pending.events += damage_events(content, max(pending.last_s.values(), default=0.0))
    yield _piece(content, trial, pending, np.inf)


def read_span(path: str | Path, start_s: float, end_s: float, n_samples: int = SAMPLES_A_PIECE) -> Recording:
    """Read a part of a recording; the rest of it is never in memory.

    Parameters
    ----------
    path : str or Path
    start_s, end_s : float, s
        On the recording's clock; samples from `start_s` up to, not with, `end_s`.
    n_samples : int
        Of a piece, as `read_pieces`.

    Returns
    -------
    Recording
        Times are those of the whole recording; without raw values, and without channels that have no sample there.

    Raises
    ------
    InputError
        If no sample lies there.
    RecordingError
        As `read_recording`.
    """
    kept = []
    for piece in read_pieces(path, n_samples):
        begins_s = min((signal.time_s[0] for signal in piece.signals.values()), default=np.inf)
        if begins_s >= end_s:
            break
        kept.append(_cut_to(piece, start_s, end_s))
    found = joined_pieces(kept) if kept else None
    if found is None or not found.signals:
        raise InputError(
            f"has no sample from {start_s:g} s to {end_s:g} s",
            where=str(path),
            remedy="`sawbench info` shows when its samples begin and end",
        )
    # An imported recording has its events behind all samples.
    told = [event for event in _events(Path(path)) if start_s <= event.time_s < end_s]
    return replace(found, events=tuple(dict.fromkeys((*told, *found.events))))


def _events(path: Path) -> list[Event]:
    """Events of a whole file, found by its index; none where that is damaged."""
    try:
        with path.open("rb") as stream:
            messages = SeekingReader(stream).iter_messages(topics=[EVENT_TOPIC])
            return [decode_event(message.data) for _, _, message in messages]
    except (OSError, ValueError, LookupError, AssertionError, DecodeError, *BROKEN):
        return []


def _cut_to(piece: Recording, start_s: float, end_s: float) -> Recording:
    signals = {}
    for name, signal in piece.signals.items():
        part = slice(*np.searchsorted(signal.time_s, (start_s, end_s)))
        time_s = signal.time_s[part]
        if len(time_s):
            gaps = tuple(gap for gap in signal.gaps if gap.end_s > time_s[0] and gap.start_s < end_s)
            signals[name] = replace(signal, time_s=time_s, values=signal.values[part], gaps=gaps)
    events = tuple(event for event in piece.events if start_s <= event.time_s < end_s)
    return replace(piece, signals=signals, events=events)


def joined_pieces(pieces: Sequence[Recording]) -> Recording:
    """Return one recording of pieces that follow each other."""
    signals = {}
    for name in dict.fromkeys(name for piece in pieces for name in piece.signals):
        rows = [piece.signals[name] for piece in pieces if name in piece.signals]
        signals[name] = replace(
            rows[0],
            time_s=np.concatenate([row.time_s for row in rows]),
            values=np.concatenate([row.values for row in rows]),
            gaps=tuple(gap for row in rows for gap in row.gaps),
        )
    return replace(pieces[-1], signals=signals, events=tuple(event for piece in pieces for event in piece.events))


@dataclass(kw_only=True, slots=True)
class _Pending:
    """Blocks that were read and not yet given out."""

    blocks_left: dict[str, int]
    is_told: bool
    with_raw: bool
    blocks: dict[str, list[SampleBlock]] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    last_s: dict[str, float] = field(default_factory=dict)
    n_samples: int = 0
    # Of the samples given out: time of the last one of each channel, and the index that should follow.
    given: dict[str, tuple[float, int]] = field(default_factory=dict)

    def add(self, block: SampleBlock) -> None:
        self.blocks_left[block.channel] = self.blocks_left.get(block.channel, 1) - 1
        if len(block.time_s):
            kept = block if self.with_raw or block.raw is None else replace(block, raw=None)
            self.blocks.setdefault(block.channel, []).append(kept)
            self.last_s[block.channel] = float(block.time_s[-1])
            self.n_samples += len(block.time_s)

    def goes_on(self, channel: str) -> bool:
        """Whether samples of a channel are still to come."""
        return bool(self.blocks.get(channel)) or (self.is_told and self.blocks_left.get(channel, 0) > 0)

    def cut_s(self, n_samples: int) -> float | None:
        """Time up to which every channel is known and about `n_samples` lie; None where there is none yet."""
        going_on = [channel for channel, left in self.blocks_left.items() if left > 0]
        if not self.is_told or any(channel not in self.last_s for channel in going_on):
            return None
        known_s = min((self.last_s[channel] for channel in going_on), default=np.inf)
        fullest = max(self.blocks.values(), key=lambda row: sum(len(block.time_s) for block in row))
        times = np.concatenate([block.time_s for block in fullest])
        end_s = min(known_s, float(times[int(len(times) * n_samples / self.n_samples)]))
        return end_s if end_s > times[0] else None

    def taken(self, end_s: float) -> dict[str, list[SampleBlock]]:
        """Take out what lies before a time."""
        found: dict[str, list[SampleBlock]] = {}
        for channel, row in self.blocks.items():
            parts = [_split(block, end_s) for block in row]
            found[channel] = [before for before, _ in parts if before is not None]
            self.blocks[channel] = [after for _, after in parts if after is not None]
        self.n_samples = sum(len(block.time_s) for row in self.blocks.values() for block in row)
        return {channel: row for channel, row in found.items() if row}


def _split(block: SampleBlock, end_s: float) -> tuple[SampleBlock | None, SampleBlock | None]:
    k = int(np.searchsorted(block.time_s, end_s))
    if k == len(block.time_s):
        return block, None
    if k == 0:
        return None, block
    before, after = (
        replace(
            block, first_index=block.first_index + first, time_s=block.time_s[part], values=block.values[part],
            raw=None if block.raw is None else block.raw[part],
        )
        for first, part in ((0, slice(k)), (k, slice(k, None)))
    )  # fmt: skip
    return before, after


def _piece(content: Content, trial: Trial, pending: _Pending, end_s: float) -> Recording:
    """What lies before a time, as a recording of its own."""
    signals: dict[str, Signal] = {}
    events = [event for event in pending.events if event.time_s < end_s]
    pending.events = [event for event in pending.events if event.time_s >= end_s]
    for channel, row in pending.taken(end_s).items():
        signal, warnings = join_blocks(row, events, alignment=alignment_of(content, channel))
        events += warnings
        signal = _with_gap_before(signal, row[0], pending.given.get(channel))
        last = row[-1]
        if pending.goes_on(channel):
            # A gap that an event tells of behind the last sample here is counted before the first of a later piece.
            known = tuple(gap for gap in signal.gaps if gap.start_s < signal.time_s[-1])
            signal = replace(signal, gaps=known)
        signals[channel] = signal
        pending.given[channel] = (float(last.time_s[-1]), last.first_index + len(last.time_s))
    return Recording(
        trial=trial,
        signals=signals,
        events=tuple(events),
        config_toml=content.config_toml or "",
        provenance=content.provenance,
        is_complete=end_s < np.inf or content.is_complete,
        path=str(content.path),
    )


def _with_gap_before(signal: Signal, first: SampleBlock, given: tuple[float, int] | None) -> Signal:
    """Add the gap between the piece before and this one, if samples are missing there."""
    if given is None or first.first_index <= given[1]:
        return signal
    gap = Gap(
        start_s=given[0], end_s=float(first.time_s[0]), n_missing=first.first_index - given[1],
        reason="samples were lost",
    )  # fmt: skip
    return replace(signal, gaps=(gap, *signal.gaps))
