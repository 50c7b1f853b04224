"""A recording in Rerun, with the layout of the live view."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from sawbench.bench.errors import WritingError
from sawbench.bench.processed import CrankAngle, Frame, ProcessedTrial
from sawbench.bench.recording import Floats, Recording, Signal
from sawbench.bench.units import DISPLACEMENT, FORCE
from sawbench.modeling.machines.words import words_of
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.processing.binning import AngleGrid
from sawbench.visualization.layout import (
    CYCLE_PATH,
    MECHANISM_PATH,
    STROKE_RATE,
    STROKE_RATE_PATH,
    TIMELINE,
    log_event,
    log_simulated_style,
    log_style,
    log_trial,
    make_blueprint,
    series_of,
)
from sawbench.visualization.motion import cycle_as_it_grows, frame_times, log_mechanism
from sawbench.visualization.rerun_view import open_rrd, send_samples
from sawbench.visualization.sdk import rr
from sawbench.visualization.stroke_rate import LiveStrokeRate
from sawbench.visualization.viewer import ViewerProcess

_REMOVED_COLOUR: Final = (120, 120, 120)
_N_BARS: Final = 90


def view_recording(
    recording: Recording,
    *,
    save_path: str | Path | None = None,
    spawn: bool = True,
    processed: ProcessedTrial | None = None,
    model: Mapping[str, Floats] | None = None,
    overwrite: bool = False,
) -> ViewerProcess | None:
    """Write a recording as `.rrd` and, if asked, open it in a viewer.

    Every sample is written; a gap breaks the line. Without a display, `spawn=False` and a `save_path` need no
    viewer and no graphics.

    Parameters
    ----------
    recording : Recording
    save_path : str or Path, optional
        Where the `.rrd` goes. With `spawn` and no path, a file in a new temporary folder.
    spawn : bool
        Open the viewer; it stays when this program ends.
    processed : ProcessedTrial, optional
        Adds the mechanism at its crank angle, the folded force cycle as it builds up stroke by stroke (whole before the
        first stroke is complete), the stroke rate found by the processing, and the results as text.
    model : mapping of str to ndarray, shape (n,), optional
        One turn of the fitted model, `angle_rad` and channels by name; laid over the measurement while the saw runs.
    overwrite : bool
        Allow `save_path` to exist.

    Returns
    -------
    ViewerProcess or None
        The viewer, None where `spawn` is False.

    Raises
    ------
    InputError
        If `save_path` exists and `overwrite` is not set, or cannot be written.
    WritingError
        If the disk is full.
    """
    if save_path is None:
        if not spawn:
            return None
        import tempfile

        save_path = Path(tempfile.mkdtemp(prefix="sawbench-")) / f"{uuid.uuid4().hex}.rrd"
    stream = rr.RecordingStream("sawbench", recording_id=uuid.uuid4())
    try:
        stream.set_sinks(open_rrd(save_path, overwrite=overwrite))
        _fill(stream, recording, processed, model or {})
        stream.flush(timeout_sec=60.0)
    except RuntimeError as error:
        # Rerun's only word for a disk that refuses; half a file would be taken for a view.
        if Path(save_path).is_file():
            Path(save_path).unlink()
        raise WritingError.of(error, where=save_path) from error
    finally:
        stream.disconnect()
    return ViewerProcess([str(save_path)]) if spawn else None


def _fill(stream: Any, recording: Recording, processed: ProcessedTrial | None, model: Mapping[str, Floats]) -> None:
    has_cycle = processed is not None and FORCE.name in processed.folded
    angle = None if processed is None else processed.angle
    frame: Frame = "crank" if processed is None else processed.frame
    words = words_of(frame)
    has_mechanism = frame == "crank" and angle is not None and angle.is_absolute and angle.radius_m > 0.0
    simulated = sorted(set(model) & set(recording.signals)) if has_mechanism else []
    stream.send_recording_name(recording.trial.trial_id)
    units = {name: signal.unit for name, signal in recording.signals.items()}
    stream.send_blueprint(
        make_blueprint(
            words=words, channels=units, has_cycle=has_cycle, has_mechanism=has_mechanism, simulated=simulated
        )
    )
    log_trial(stream, recording.trial, processed, words)
    for event in recording.events:
        log_event(stream, event)
    stream.reset_time()
    for name, signal in recording.signals.items():
        series = series_of(name, signal.unit, words)
        log_style(stream, series)
        send_samples(stream, series.path, *_with_breaks(signal))
    rates = _stroke_rates(recording, processed)
    if len(rates):
        log_style(stream, series_of(STROKE_RATE, "Hz", words))
        # Without these the panel would begin at the first stroke, out of line with the others.
        ends = [[signal.time_s[end], np.nan] for signal in recording.signals.values() for end in (0, -1)]
        rates = np.array(sorted([*rates.tolist(), min(ends), max(ends)]))
        send_samples(stream, STROKE_RATE_PATH, rates[:, 0], rates[:, 1])
    if processed is not None and has_cycle:
        _log_cycle(stream, recording, processed)
    if processed is not None and angle is not None and has_mechanism:
        mechanism = Mechanism(radius_m=angle.radius_m, rod_length_m=angle.rod_length_m)
        log_mechanism(stream, MECHANISM_PATH, TIMELINE, mechanism, angle)
        for name in simulated:
            series = series_of(name, units[name])
            log_simulated_style(stream, series)
            send_samples(stream, series.simulated_path, *_simulated(processed, angle, model, name))


def _simulated(
    processed: ProcessedTrial, angle: CrankAngle, model: Mapping[str, Floats], name: str
) -> tuple[Floats, Floats]:
    """Return times and the model's values at the measured crank angle, NaN while the saw does not run steadily."""
    time_s = frame_times(angle)
    at_rad = np.interp(time_s, angle.time_s, angle.angle_rad)
    values = np.interp(at_rad, model["angle_rad"], model[name], period=2.0 * np.pi)
    is_running = np.zeros(len(time_s), dtype=bool)
    for phase in processed.phases:
        is_running |= (phase.kind == "running") & (time_s >= phase.start_s) & (time_s <= phase.end_s)
    return time_s, np.where(is_running, values, np.nan)


def _with_breaks(signal: Signal) -> tuple[Floats, Floats]:
    """Return times and values with a NaN inside every gap."""
    if not signal.gaps:
        return signal.time_s, signal.values
    middle_s = np.array([0.5 * (gap.start_s + gap.end_s) for gap in signal.gaps])
    at = np.searchsorted(signal.time_s, middle_s)
    return np.insert(signal.time_s, at, middle_s), np.insert(signal.values, at, np.nan)


def _stroke_rates(recording: Recording, processed: ProcessedTrial | None) -> Floats:
    """Return time and stroke rate, shape (n, 2): one value a turn of the crank."""
    if processed is not None and processed.angle is not None and len(processed.angle.time_s) > 1:
        turns = processed.angle.angle_rad / (2.0 * np.pi)
        whole = np.arange(np.ceil(turns[0]), np.floor(turns[-1]) + 1.0)
        is_rising = np.r_[True, np.diff(turns) > 0]
        at_s = np.interp(whole, turns[is_rising], processed.angle.time_s[is_rising])
        return np.column_stack((at_s[1:], 1.0 / np.diff(at_s))) if len(at_s) > 1 else np.empty((0, 2))
    if DISPLACEMENT.name not in recording.signals:
        return np.empty((0, 2))
    signal = recording.signals[DISPLACEMENT.name]
    estimator, found = LiveStrokeRate(), []
    block = max(1, round(0.1 * signal.rate_hz))
    for first in range(0, len(signal.time_s), block):
        part = slice(first, first + block)
        found += estimator.update(signal.time_s[part], signal.values[part])
    return np.asarray(found, dtype=np.float64).reshape(-1, 2)


def _log_cycle(stream: Any, recording: Recording, processed: ProcessedTrial) -> None:
    """Draw the mean force over the crank angle, measured in grey, what counts as cutting in colour.

    Before the first stroke is complete it is the mean of all; from then on it builds up.
    """
    measured, angle = processed.folded[FORCE.name], processed.angle
    signal = recording.signals.get(FORCE.name)
    rows = [(0.0, _in_bars(measured.angle_rad, measured.mean))]
    if angle is not None and angle.is_absolute and signal is not None:
        rows += zip(*cycle_as_it_grows(angle, signal, _N_BARS), strict=True)
    removed = processed.removed
    for at_s, mean in rows:
        stream.set_time(TIMELINE, duration=at_s)
        _log_bars(stream, f"{CYCLE_PATH}/measured", mean, _REMOVED_COLOUR)
        if removed is not None:
            is_first = np.arange(_N_BARS) < _N_BARS // 2
            is_cutting = ~is_first if removed.half == "zero_to_pi" else is_first
            _log_bars(stream, f"{CYCLE_PATH}/cutting", np.where(is_cutting, mean, 0.0), series_of(FORCE.name).colour)
    stream.reset_time()


def _in_bars(angle_rad: Floats, mean: Floats) -> Floats:
    """Means over neighbouring cells: more than 90 bars flicker on a screen."""
    finite = np.isfinite(mean)
    grid = AngleGrid(first_turn=0, n_rows=1, n_bins=_N_BARS)
    return grid.means(grid.place(angle_rad[finite]), mean[finite])[0]


def _log_bars(stream: Any, path: str, height: Floats, colour: tuple[int, int, int]) -> None:
    is_filled = np.isfinite(height)
    if not is_filled.any():
        return
    angle_deg = 360.0 * (np.flatnonzero(is_filled) + 0.5) / _N_BARS
    width = np.full(len(angle_deg), 360.0 / _N_BARS)
    stream.log(path, rr.BarChart(height[is_filled], abscissa=angle_deg, widths=width, color=colour))
