"""Blocks to one signal: joined, with every missing stretch annotated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.recording import Alignment, Event, Floats, Gap, SampleBlock, Signal
from sawbench.bench.spread import robust_std

# An interval is a jump where it exceeds the usual ones, their spread, and its neighbours by these factors.
_JUMP_FACTOR: Final = 1.6
_JUMP_SPREADS: Final = 10.0


def find_time_jumps(time_s: Floats) -> NDArray[np.int64]:
    """Return where samples are missing, judged by the times alone.

    An interval counts as a jump where it is 1.6 times the median interval plus ten robust standard deviations
    of the intervals, and 1.6 times the shorter of its neighbours: slow changes of the rate are no jumps. With
    jitter above about 4 % of the interval a single missing sample is not seen.

    Parameters
    ----------
    time_s : ndarray, shape (n,), s
        Increasing.

    Returns
    -------
    ndarray of int, shape (m,)
        Index of the first sample behind each jump.

    Examples
    --------
    >>> find_time_jumps(np.array([0.0, 0.1, 0.2, 0.3, 0.6, 0.7, 0.8]))
    array([4])
    """
    if len(time_s) < 4:
        return np.zeros(0, dtype=np.int64)
    step = np.diff(time_s)
    nominal = float(np.median(step))
    spread = robust_std(step - nominal)
    candidates = np.flatnonzero(step > _JUMP_FACTOR * nominal + _JUMP_SPREADS * spread)
    padded = np.concatenate(([np.inf], step, [np.inf]))
    neighbour = np.minimum(padded[candidates], padded[candidates + 2])
    return candidates[step[candidates] > _JUMP_FACTOR * neighbour].astype(np.int64) + 1


def join_blocks(
    blocks: Sequence[SampleBlock], events: Sequence[Event], *, alignment: Alignment | None = None
) -> tuple[Signal, list[Event]]:
    """Return the signal of one channel and warnings about what had to be left out.

    Parameters
    ----------
    blocks : sequence of SampleBlock
        Of one channel, in the order of the recording, at least one.
    events : sequence of Event
        A gap takes its reason from the gap or device event it overlaps.
    alignment : Alignment, optional
        Of the channel's times.

    Returns
    -------
    signal : Signal
        A jump of the sample index, or of the time, is a gap, and so is what an event says is missing at the end.
    warnings : list of Event
    """
    first = blocks[0]
    time_s = np.concatenate([block.time_s for block in blocks])
    values = np.concatenate([block.values for block in blocks])
    raws = [block.raw for block in blocks if block.raw is not None]
    warnings = []
    if 0 < len(raws) < len(blocks):
        text = f"{first.channel}: raw values are in only {len(raws)} of {len(blocks)} blocks and are left out"
        warnings.append(Event(kind="warning", time_s=float(time_s[0]), text=text, channel=first.channel))
    raw = np.concatenate(raws) if len(raws) == len(blocks) else None
    missing = _index_jumps(blocks)

    is_later = np.ones(len(time_s), dtype=bool)
    is_later[1:] = time_s[1:] > np.maximum.accumulate(time_s)[:-1]
    if not is_later.all():
        missing = {int(is_later[:position].sum()): n for position, n in missing.items()}
        text = f"{first.channel}: {int((~is_later).sum())} samples with decreasing time are left out"
        at_s = float(time_s[np.argmin(is_later)])
        warnings.append(Event(kind="warning", time_s=at_s, text=text, channel=first.channel))
        time_s, values = time_s[is_later], values[is_later]
        raw = None if raw is None else raw[is_later]
    signal = Signal(
        channel=first.channel,
        unit=first.unit,
        time_s=time_s,
        values=values,
        raw=raw,
        gaps=_gaps(first, time_s, missing, events),
        device=first.device,
        alignment=alignment,
    )
    return signal, warnings


def _index_jumps(blocks: Sequence[SampleBlock]) -> dict[int, int | None]:
    """Return position behind the jump and samples missing; None where the device restarts its count."""
    jumps: dict[int, int | None] = {}
    position = 0
    expected = blocks[0].first_index
    for block in blocks:
        if block.first_index != expected:
            jumps[position] = block.first_index - expected if block.first_index > expected else None
        position += len(block.time_s)
        expected = block.first_index + len(block.time_s)
    return jumps


def _gaps(
    block: SampleBlock, time_s: Floats, missing: dict[int, int | None], events: Sequence[Event]
) -> tuple[Gap, ...]:
    jumps: dict[int, int | None] = dict.fromkeys(find_time_jumps(time_s).tolist()) | missing
    step = np.diff(time_s)
    nominal_s = float(np.median(step)) if len(step) else 0.0
    told = [
        event
        for event in events
        if event.kind in ("gap", "device", "interrupted")
        and event.channel in ("", block.channel)
        and event.device in ("", block.device)
    ]
    starts_s = np.array([event.time_s for event in told])
    ends_s = np.array([event.time_s if event.end_s is None else event.end_s for event in told])
    gaps = []
    for position in sorted(jumps):
        if not 0 < position < len(time_s):
            continue
        start_s, end_s = float(time_s[position - 1]), float(time_s[position])
        n_missing = jumps[position]
        reason = "samples were lost" if n_missing is not None else "the time jumps"
        if position in missing and n_missing is None:
            reason = "the device restarted its counter"
        if n_missing is None:
            n_missing = max(round((end_s - start_s) / nominal_s) - 1, 0)
        # Of the events that overlap the gap, the one that is closest to its start.
        over = np.flatnonzero((starts_s <= end_s) & (ends_s >= start_s))
        if len(over):
            reason = told[over[np.argmin(np.abs(starts_s[over] - start_s))]].text or reason
        gaps.append(
            Gap(
                start_s=start_s,
                end_s=end_s,
                n_missing=n_missing,
                reason=reason,
            )
        )
    return (*gaps, *_gap_at_end(block.channel, float(time_s[-1]), nominal_s, told))


def _gap_at_end(channel: str, last_s: float, nominal_s: float, told: Sequence[Event]) -> list[Gap]:
    """What a gap event of the channel says is missing behind its last sample."""
    ends = [e for e in told if e.kind == "gap" and e.channel == channel and e.end_s is not None]
    ends = [e for e in ends if abs(e.time_s - last_s) <= 1.5 * nominal_s and e.end_s > last_s + 1.5 * nominal_s]
    return [
        Gap(start_s=last_s, end_s=e.end_s, n_missing=round((e.end_s - last_s) / nominal_s), reason=e.text)
        for e in ends[-1:]
        if e.end_s is not None
    ]
