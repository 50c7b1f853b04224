"""What was found in the pieces of a long recording, as what is found in the whole."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain, compress
from typing import Final

import numpy as np
from sawbench.bench.config import BenchConfig
from sawbench.bench.folded import pooled
from sawbench.bench.processed import ChannelQuality, PeriodEstimate, Phase, ProcessedTrial, TrialStatus
from sawbench.processing.return_stroke import zero_return_stroke

# The first that any piece has is that of the whole.
_STATUS: Final[tuple[TrialStatus, ...]] = ("stalled", "cutting", "no_cutting", "moving", "no_stroke")
_CONFIDENCE: Final = ("low", "moderate", "high")
# Of the piece whose force follows the stroke most: one with less is in air but for a few strokes.
_LEAST_SHARE: Final = 0.25
# Phases of one kind belong together over a cut, where no more than this lies between them.
_CUT_S: Final = 0.1
_FORCE: Final = "force_n"


def which_count(pieces: Sequence[ProcessedTrial]) -> list[bool]:
    """Say of each piece whether its strokes are among those of the trial: not where it is in air and others cut.

    Parameters
    ----------
    pieces : sequence of ProcessedTrial
        n of them, at least one.

    Returns
    -------
    list of bool, length n
        All True where no piece cuts, as in an idle run.
    """
    swings_n = [None if p.cutting_force is None else float(np.ptp(p.folded[_FORCE].mean)) for p in pieces]
    least_n = _LEAST_SHARE * max((swing_n for swing_n in swings_n if swing_n is not None), default=0.0)
    # Without a force the status is all that is known.
    cuts = [
        piece.status == "cutting" if swing_n is None else swing_n > least_n
        for piece, swing_n in zip(pieces, swings_n, strict=True)
    ]
    return cuts if any(cuts) else [True] * len(pieces)


def join_processed(pieces: Sequence[ProcessedTrial], config: BenchConfig) -> ProcessedTrial:
    """Join what was found in pieces that were cut out of one recording, one behind the other.

    Status, quality and phases are those of all pieces; all else is that of the pieces that count (`which_count`). Means
    are weighted with the strokes of each piece, the scatter of the folded cycle is that of all strokes about their
    common mean. The stroke that a cut goes through is in neither piece, so some are missing: one or two a cut.

    Parameters
    ----------
    pieces : sequence of ProcessedTrial
        At least one, in their order. Angle, channels, steady part and offsets between the instruments are those of the
        last one that counts and has an angle.
    config : BenchConfig
        `cutting` says which half of the joined force cycle is zeroed.
    """
    if len(pieces) == 1:
        return pieces[0]
    first, counts = pieces[0], which_count(pieces)
    counted = list(compress(pieces, counts))
    folded = {name: pooled([p.folded[name] for p in counted if name in p.folded]) for name in _names(counted, "folded")}
    cutting, removed = None, None
    if _FORCE in folded and any(piece.cutting_force is not None for piece in counted):
        cutting, removed = zero_return_stroke(folded[_FORCE], config.cutting.cutting_half)
    peak = _peak(counted)
    drawn = next((piece for piece in reversed(counted) if piece.angle is not None), counted[0])
    return replace(
        first,
        status=next(status for status in _STATUS if any(piece.status == status for piece in pieces)),
        period=_period([piece.period for piece in counted if piece.period is not None]),
        angle=drawn.angle,
        steady=drawn.steady,
        channels=drawn.channels,
        offsets=drawn.offsets,
        phases=_phases(
            phase if is_counted or phase.kind != "running" else replace(phase, kind="in_air")
            for piece, is_counted in zip(pieces, counts, strict=True)
            for phase in piece.phases
        ),
        folded=folded,
        cutting_force=cutting,
        removed=removed,
        peak_force_n=None if peak is None else peak[0],
        peak_force_std_n=None if peak is None else peak[1],
        mean_values=_weighted(counted, "mean_values", lambda value: value, lambda mean: mean),
        rms_values=_weighted(counted, "rms_values", np.square, np.sqrt),
        quality=tuple(
            _quality([q for piece in pieces for q in piece.quality if q.channel == name], len(pieces))
            for name in dict.fromkeys(q.channel for piece in pieces for q in piece.quality)
        ),
        warnings=_told([piece.warnings for piece in pieces], len(pieces)),
    )


def _names(pieces: Sequence[ProcessedTrial], attribute: str) -> list[str]:
    return list(dict.fromkeys(name for piece in pieces for name in getattr(piece, attribute)))


def _period(periods: Sequence[PeriodEstimate]) -> PeriodEstimate | None:
    """Mean over all strokes; the confidence is the lowest of the pieces."""
    if not periods:
        return None
    n = np.array([period.n_cycles for period in periods], dtype=float)
    of_piece = np.array([period.period_s for period in periods])
    mean_s = float(n @ of_piece / n.sum())
    spread_s = np.array([period.spread_s for period in periods])
    std_s = np.array([period.period_std_s for period in periods])
    doubted = min(periods, key=lambda period: _CONFIDENCE.index(period.confidence))
    return replace(
        doubted,
        period_s=mean_s,
        period_std_s=float(np.sqrt(np.sum((n * std_s) ** 2)) / n.sum()),
        spread_s=float(np.sqrt(n @ (spread_s**2 + (of_piece - mean_s) ** 2) / n.sum())),
        n_cycles=int(n.sum()),
    )


def _peak(pieces: Sequence[ProcessedTrial]) -> tuple[float, float] | None:
    """Mean of the largest cutting force over all strokes, and its standard uncertainty."""
    found = [
        (p.folded[_FORCE].n_cycles, p.peak_force_n, p.peak_force_std_n or 0.0)
        for p in pieces
        if p.peak_force_n is not None and _FORCE in p.folded
    ]
    if not found:
        return None
    n, peak_n, std_n = np.array(found, dtype=float).T
    return float(n @ peak_n / n.sum()), float(np.sqrt(np.sum((n * std_n) ** 2)) / n.sum())


def _weighted(
    pieces: Sequence[ProcessedTrial], attribute: str, into: Callable[[float], float], back: Callable[[float], float]
) -> Mapping[str, float]:
    """Averages over all strokes of what is averaged over those of each piece."""
    found = {}
    for name in _names(pieces, attribute):
        rows = [(p.folded[name].n_cycles, into(getattr(p, attribute)[name])) for p in pieces if name in p.folded]
        n, values = np.array(rows, dtype=float).T
        found[name] = float(back(n @ values / n.sum()))
    return found


def _phases(phases: Iterable[Phase]) -> tuple[Phase, ...]:
    joined: list[Phase] = []
    for phase in phases:
        if joined and joined[-1].kind == phase.kind and phase.start_s - joined[-1].end_s < _CUT_S:
            joined[-1] = replace(joined[-1], end_s=phase.end_s)
        else:
            joined.append(phase)
    return tuple(joined)


def _quality(rows: Sequence[ChannelQuality], n_pieces: int) -> ChannelQuality:
    """Health of a channel over all pieces: counts added up, noise and jitter as mean squares."""
    n = np.array([row.n_samples for row in rows], dtype=float)

    def rms(name: str) -> float:
        return float(np.sqrt(n @ np.array([getattr(row, name) for row in rows]) ** 2 / n.sum()))

    return replace(
        rows[0],
        rate_hz=float(np.median([row.rate_hz for row in rows])),
        n_samples=int(n.sum()),
        n_missing=sum(row.n_missing for row in rows),
        jitter_std_s=rms("jitter_std_s"),
        noise_std=rms("noise_std"),
        n_spikes=sum(row.n_spikes for row in rows),
        n_clipped=sum(row.n_clipped for row in rows),
        n_impacts=sum(row.n_impacts for row in rows),
        problems=_told([row.problems for row in rows], n_pieces),
        doubts=_told([row.doubts for row in rows], n_pieces),
    )


def _told(texts: Sequence[Sequence[str]], n_pieces: int) -> tuple[str, ...]:
    """Say once what several pieces say with other numbers, as the first of them says it."""
    said: dict[str, list[str]] = {}
    for text in chain.from_iterable(texts):
        said.setdefault(re.sub(r"\d+(\.\d+)?(e[+-]?\d+)?", "#", text), []).append(text)
    return tuple(found[0] + f" (so or alike in {len(found)} of {n_pieces} pieces)" for found in said.values())
