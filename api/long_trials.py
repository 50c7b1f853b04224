"""A recording that is too long to be in memory: processed piece by piece, kept in outline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, compress
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from sawbench.analysed_trial import AnalysedTrial
from sawbench.analysis import refuse_wrong_effects
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Recording, Signal
from sawbench.inputs import config_for

if TYPE_CHECKING:
    from sawbench.bench.config import LoadedConfig
    from sawbench.bench.processed import ProcessedTrial
    from sawbench.modeling.measured_cycles import MeasuredCycles

# Points a second that are kept of every channel: the lowest and the highest sample of every 0.2 s.
OUTLINE_RATE_HZ: Final = 10.0
# So much of the end of a piece is kept whole: a picture of the next one may begin a little before it.
_EDGE_S: Final = 0.1


def process_long(
    local: Path, config_path: Path | LoadedConfig | None, *, path: str, sha256: str, n_samples: int | None = None
) -> AnalysedTrial:
    """Process a recording piece by piece; the memory that it takes does not grow with its samples.

    Parameters
    ----------
    local : Path
    config_path : Path or LoadedConfig, optional
    path : str
        The name it goes by.
    sha256 : str
        Of the file.
    n_samples : int, optional
        Of a piece; default: `pieces.SAMPLES_A_PIECE`.

    Returns
    -------
    AnalysedTrial
        `strokes` are those of all pieces that count (`joined.which_count`). Angle and channels of `processed` are of
        one piece, of these the one with the most strokes; its samples, and an outline of all others, are the signals of
        `recording`.

    Raises
    ------
    InputError
        As `load_and_process`.
    """
    from sawbench.processing.joined import join_processed, which_count
    from sawbench.processing.process import process_recording
    from sawbench.storage.pieces import SAMPLES_A_PIECE, joined_pieces, read_pieces

    loaded: LoadedConfig | None = None
    found: list[ProcessedTrial] = []
    outlines: list[Recording] = []
    strokes: list[list[MeasuredCycles]] = []
    counts: list[bool] = []
    drawn = 0
    for number, read in enumerate(read_pieces(local, n_samples or SAMPLES_A_PIECE)):
        piece = replace(read, path=path)
        if loaded is None:
            loaded = config_for(piece, config_path)
            refuse_wrong_effects(loaded)
        # That the recording is incomplete is said of all of it, below.
        processed = process_recording(replace(piece, is_complete=True), loaded.config, source_sha256=sha256)
        found.append(processed)
        outlines.append(piece)
        strokes.append(_strokes(processed))
        counts = which_count(found)
        before, drawn = drawn, _drawn(found, counts, drawn)
        for other in {before, number} - {drawn}:
            found[other], outlines[other] = _light(found[other]), _outline(outlines[other])
    assert loaded is not None
    recording, whole = joined_pieces(outlines), join_processed(found, loaded.config)
    return AnalysedTrial(
        recording=recording,
        loaded=loaded,
        processed=replace(whole, warnings=(*recording.interruptions, *whole.warnings, *_note(whole, counts))),
        strokes=_joined_strokes(list(chain.from_iterable(compress(strokes, counts)))),
    )


def _drawn(found: Sequence[ProcessedTrial], counts: Sequence[bool], before: int) -> int:
    """Which of the piece drawn before and the newest one is drawn now: one that counts, with the most strokes."""

    def worth(number: int) -> tuple[bool, int]:
        period = found[number].period
        return counts[number], 0 if period is None else period.n_cycles

    return max(before, len(found) - 1, key=worth)


def _note(whole: ProcessedTrial, counts: Sequence[bool]) -> tuple[str, ...]:
    """Say that a trial was processed in pieces, how many are left out, and which one is drawn."""
    if whole.angle is None or len(counts) == 1:
        return ()
    left_out = f", {counts.count(False)} of them left out (no cut, or next to none)" if not all(counts) else ""
    span = f"{whole.angle.time_s[0]:.0f} s to {whole.angle.time_s[-1]:.0f} s"
    drawn = f"crank angle over time, spectra and offsets are those of {span}"
    return (f"long: processed in {len(counts)} pieces{left_out}; {drawn}",)


def _light(processed: ProcessedTrial) -> ProcessedTrial:
    return replace(processed, angle=None, steady=None, channels={})


def _strokes(processed: ProcessedTrial) -> list[MeasuredCycles]:
    """Strokes of a piece as the fit takes them; none where it has none."""
    from sawbench.processing.measured_cycles import measured_cycles

    try:
        return [measured_cycles(processed)]
    except InputError:
        return []


def _joined_strokes(rows: Sequence[MeasuredCycles]) -> MeasuredCycles | None:
    """Strokes of all pieces that count; of a channel that not every one has, none."""
    if not rows:
        return None
    names = (
        "cycle_start_s", "period_s", "current_a", "force_n", "crank_speed_rad_s", "battery_voltage_v",
        "battery_current_a",
    )  # fmt: skip
    parts = {name: [getattr(row, name) for row in rows] for name in names}
    return replace(
        rows[0],
        **{
            name: None if any(part is None for part in found) else np.concatenate(found)
            for name, found in parts.items()
        },
    )


def _outline(piece: Recording) -> Recording:
    return replace(piece, signals={name: _outlined(signal) for name, signal in piece.signals.items()})


def _outlined(signal: Signal) -> Signal:
    from sawbench.visualization.envelope import envelope_indices

    kept = envelope_indices(signal.time_s, signal.values, max_rate_hz=OUTLINE_RATE_HZ)
    edge = int(np.searchsorted(signal.time_s, signal.time_s[-1] - _EDGE_S))
    kept = np.union1d(kept, np.arange(edge, len(signal.time_s)))
    return replace(signal, time_s=signal.time_s[kept], values=signal.values[kept])
