"""What moves with the crank: the mechanism at its angle, and the folded cycle as it builds up."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from sawbench.bench.recording import Floats, Signal
from sawbench.processing.binning import TWO_PI, AngleGrid
from sawbench.visualization.sdk import rr

if TYPE_CHECKING:
    from sawbench.bench.processed import CrankAngle
    from sawbench.modeling.parts.mechanism import Mechanism

_FRAMES_PER_STROKE: Final = 48
_MAX_FRAMES: Final = 20_000
_MAX_BUILD_UP_STEPS: Final = 60
_STEEL: Final = (170, 170, 170)
_CRANK: Final = (240, 220, 90)
_BLADE: Final = (230, 110, 20)


def frame_times(angle: CrankAngle) -> Floats:
    """Times at which the mechanism is drawn, s: `_FRAMES_PER_STROKE` a stroke, shape (n,)."""
    turns = angle.angle_rad / TWO_PI
    is_rising = np.r_[True, np.diff(turns) > 0]
    n_frames = int(np.clip(np.ptp(turns) * _FRAMES_PER_STROKE, 2, _MAX_FRAMES))
    even = np.linspace(turns[is_rising][0], turns[is_rising][-1], n_frames)
    return np.interp(even, turns[is_rising], angle.time_s[is_rising])


def mechanism_strips(mechanism: Mechanism, angle_rad: Floats) -> dict[str, Floats]:
    """Lines of a mechanism at crank angles, in crank radii: the blade moves to the right of the crank's centre.

    Parameters
    ----------
    mechanism : Mechanism
        A Scotch yoke or an in-line slider-crank.
    angle_rad : ndarray, shape (n,), rad

    Returns
    -------
    dict of str to ndarray, shape (n, 2, 2), crank radii
        Both ends of `crank`, `link` (the slot of the yoke, or the rod) and `blade`.
    """
    radius_m = float(np.mean(mechanism.radius_m))
    moved = np.asarray(mechanism.displacement(angle_rad)) / radius_m
    sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
    if mechanism.rod_length_m is None:
        # At angle 0 pin and slot are farthest from the blade's tip.
        pin, head_at = np.column_stack((-cosine, sine)), moved - 1.0
    else:
        # At angle 0 crank and rod are in line, and the displacement counts from there.
        pin, head_at = np.column_stack((cosine, sine)), 1.0 + mechanism.rod_length_m / radius_m - moved
    head = np.column_stack((head_at, np.zeros(len(head_at))))
    slot = (head - np.array([0.0, 1.25]), head + np.array([0.0, 1.25]))
    lines = {
        "crank": (np.zeros_like(pin), pin),
        "link": slot if mechanism.rod_length_m is None else (pin, head),
        "blade": (head, head + np.array([3.0, 0.0])),
    }
    return {name: np.stack(ends, axis=1) for name, ends in lines.items()}


def log_mechanism(stream: Any, path: str, timeline: str, mechanism: Mechanism, angle: CrankAngle) -> None:
    """Draw the mechanism below `path` at the crank angle of every moment."""
    time_s = frame_times(angle)
    at_rad = np.interp(time_s, angle.time_s, angle.angle_rad)
    # Before the angle is known the crank stands where it starts.
    time_s, at_rad = np.r_[0.0, time_s[time_s > 0.0]], np.r_[at_rad[0], at_rad[time_s > 0.0]]
    strips = mechanism_strips(mechanism, at_rad)
    around = np.linspace(0.0, TWO_PI, 73)
    circle = np.column_stack((np.cos(around), np.sin(around)))
    blade = strips["blade"]
    # The way of the blade keeps the whole motion in sight.
    way = np.array([blade[:, 0].min(axis=0), blade[:, 1].max(axis=0)])
    stream.log(f"{path}/still", rr.LineStrips2D([circle, way], colors=_STEEL, radii=0.02), static=True)
    for name, colour, radius in (("link", _STEEL, 0.05), ("crank", _CRANK, 0.06), ("blade", _BLADE, 0.1)):
        stream.log(f"{path}/{name}", rr.LineStrips2D.from_fields(colors=[colour], radii=[radius]), static=True)
        stream.send_columns(
            f"{path}/{name}",
            indexes=[rr.TimeColumn(timeline, duration=time_s)],
            columns=rr.LineStrips2D.columns(strips=list(strips[name].astype(np.float32))),
        )


def cycle_as_it_grows(angle: CrankAngle, signal: Signal, n_bins: int) -> tuple[Floats, Floats]:
    """Mean over the strokes so far, after each stroke or each of a few dozen equal numbers of strokes.

    Parameters
    ----------
    angle : CrankAngle
    signal : Signal
    n_bins : int
        Cells a turn.

    Returns
    -------
    end_s : ndarray, shape (n,), s
        When the strokes that count were complete; empty where no stroke is whole.
    means : ndarray, shape (n, n_bins)
        In the unit of the signal, NaN where a cell has no sample yet.
    """
    turns = angle.angle_rad / TWO_PI
    first, last = int(np.ceil(turns[0])), int(np.floor(turns[-1]))
    if last <= first:
        return np.empty(0), np.empty((0, n_bins))
    grid = AngleGrid(first_turn=first, n_rows=last - first, n_bins=n_bins)
    total, count = grid.sums(grid.place_samples(angle.time_s, angle.angle_rad, signal.time_s), signal.values)
    total, count = np.cumsum(total, axis=0), np.cumsum(count, axis=0)
    rows = np.unique(np.linspace(0, last - first - 1, min(last - first, _MAX_BUILD_UP_STEPS)).round().astype(int))
    is_rising = np.r_[True, np.diff(turns) > 0]
    end_s = np.interp(first + rows + 1.0, turns[is_rising], angle.time_s[is_rising])
    return end_s, np.where(count > 0, total / np.maximum(count, 1), np.nan)[rows]
