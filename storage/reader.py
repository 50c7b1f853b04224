"""Reads recordings: whole ones, running ones (`.part`), truncated and damaged ones."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from sawbench.bench.errors import InputError, RecordingError
from sawbench.bench.recording import Alignment, Event, Floats, Recording, SampleBlock, Signal, Trial, alignment_key
from sawbench.storage.amendments import amended
from sawbench.storage.assembly import join_blocks
from sawbench.storage.codec import is_equally_spaced
from sawbench.storage.content import Content, damage_events, iter_samples, require_sawbench
from sawbench.storage.writer import RecordingWriter

_SAMPLES_PER_BLOCK = 2000


def read_recording(path: str | Path) -> Recording:
    """Read one trial.

    A truncated, damaged or unfinished file gives what can be saved of it: `is_complete` is False and an event
    says what was lost, where the file still tells. A jump of the sample index or of the time becomes a gap of
    the signal.

    Parameters
    ----------
    path : str or Path
        A `.mcap` or `.part` file.

    Returns
    -------
    Recording
        Signals in the order in which they first appear.

    Raises
    ------
    RecordingError
        If the file is missing, is not an MCAP file, was written by another program or by a newer sawbench.
    """
    content = Content(path=Path(path))
    recording = read_content(content)
    require_sawbench(content)
    return recording


def read_content(content: Content) -> Recording:
    """Read all samples of an MCAP file, also of one of another program, which has none.

    Parameters
    ----------
    content : Content
        With its `path`; receives the rest.

    Raises
    ------
    RecordingError
        If the file is missing, is not an MCAP file or was written by a newer sawbench.
    """
    blocks: dict[str, list[SampleBlock]] = {}
    events: list[Event] = []
    for item in iter_samples(content):
        if isinstance(item, Event):
            events.append(item)
        elif len(item.time_s):
            blocks.setdefault(item.channel, []).append(item)
    trial = amended(content.trial(), content.path) if content.is_sawbench else Trial(trial_id=content.path.stem)
    last_s = max((float(block.time_s[-1]) for row in blocks.values() for block in row), default=0.0)
    events += damage_events(content, last_s)
    signals: dict[str, Signal] = {}
    for channel, row in blocks.items():
        signals[channel], warnings = join_blocks(row, events, alignment=alignment_of(content, channel))
        events += warnings
    return Recording(
        trial=trial,
        signals=signals,
        events=tuple(events),
        config_toml=content.config_toml or "",
        provenance=content.provenance,
        is_complete=content.is_complete,
        path=str(content.path),
    )


def alignment_of(content: Content, channel: str) -> Alignment | None:
    """Return what the recorder, or the map of a table, stated of a channel's times; None where nothing did."""
    name = alignment_key(channel)
    if name not in content.provenance:
        return None
    try:
        return Alignment(**json.loads(content.provenance[name]))
    except (ValueError, TypeError, RecursionError, InputError) as error:
        raise RecordingError(
            f"`{name}` of its provenance is {content.provenance[name]!r}, which is not a valid alignment",
            where=content.path,
            remedy="record again, or remove the entry with the program that changed it",
        ) from error


def iter_blocks(path: str | Path) -> Iterator[SampleBlock]:
    """Yield the blocks of a recording in the order of the file, without reading it whole.

    Yields
    ------
    SampleBlock
        Exactly as it was written; blocks in damaged chunks are left out.

    Raises
    ------
    RecordingError
        As `read_recording`.
    """
    content = Content(path=Path(path))
    for item in iter_samples(content):
        if isinstance(item, SampleBlock):
            yield item
    require_sawbench(content)


def write_recording(recording: Recording, path: str | Path, overwrite: bool = False) -> Path:
    """Write a recording that is in memory, for example an imported one.

    Parameters
    ----------
    recording : Recording
        Its gaps are kept as jumps of the sample index; a gap with a reason also becomes an event, unless
        there is one already.
    path : str or Path
    overwrite : bool

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    RecordingError
        If the file exists and `overwrite` is False, or cannot be written.
    """
    path = Path(path)
    writer = RecordingWriter(
        path=path,
        trial=recording.trial,
        config_toml=recording.config_toml,
        provenance=recording.provenance,
        started_at=recording.trial.started_at,
        overwrite=overwrite,
    )
    with writer:
        for block in _interleaved_blocks(recording):
            writer.write_block(block)
        for event in (*recording.events, *_gap_events(recording)):
            writer.write_event(event)
        writer.close(is_complete=recording.is_complete)
    return path


def _interleaved_blocks(recording: Recording) -> Iterator[SampleBlock]:
    """Cut all signals at the same times, so that times shared by the channels are packed only once."""
    signals = [signal for signal in recording.signals.values() if len(signal.time_s)]
    if not signals:
        return
    fullest = max(signals, key=lambda signal: len(signal.time_s))
    edges_s = fullest.time_s[_SAMPLES_PER_BLOCK::_SAMPLES_PER_BLOCK]
    pieces = []
    for order, signal in enumerate(signals):
        starts = np.array([gap.start_s for gap in signal.gaps])
        behind_gap = np.searchsorted(signal.time_s, starts, side="right")
        cuts = np.unique(np.concatenate((np.searchsorted(signal.time_s, edges_s), behind_gap)))
        bounds = [0, *cuts[(cuts > 0) & (cuts < len(signal.time_s))].tolist(), len(signal.time_s)]
        index_shift = 0
        missing = {int(k): gap.n_missing for k, gap in zip(behind_gap, signal.gaps, strict=True)}
        for first, end in pairwise(bounds):
            index_shift += missing.get(first, 0)
            window = int(np.searchsorted(edges_s, signal.time_s[first], side="right"))
            pieces.append((window, order, first, end, first + index_shift))
    for _, order, first, end, first_index in sorted(pieces):
        yield _piece(signals[order], slice(first, end), first_index)


def _piece(signal: Signal, part: slice, first_index: int) -> SampleBlock:
    time_s = signal.time_s[part]
    return SampleBlock(
        device=signal.device,
        channel=signal.channel,
        unit=signal.unit,
        first_index=first_index,
        time_s=time_s,
        values=signal.values[part],
        raw=None if signal.raw is None else signal.raw[part],
        period_s=_period(time_s),
    )


def _period(time_s: Floats) -> float | None:
    if len(time_s) < 3:
        return None
    period_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    return period_s if is_equally_spaced(time_s, period_s) else None


def _gap_events(recording: Recording) -> Iterator[Event]:
    told = {(e.channel, e.time_s, e.end_s) for e in recording.events if e.kind == "gap"}
    texts = {event.text for event in recording.events}
    for signal in recording.signals.values():
        for gap in signal.gaps:
            is_told = (signal.channel, gap.start_s, gap.end_s) in told or gap.reason in texts
            if gap.reason and not is_told:
                yield Event(
                    kind="gap",
                    time_s=gap.start_s,
                    end_s=gap.end_s,
                    text=gap.reason,
                    device=signal.device,
                    channel=signal.channel,
                )
