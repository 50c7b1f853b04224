"""The strokes of a trial as the fit of k_Fc takes them: means over cells of the crank angle, stroke by stroke."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from sawbench.bench.errors import InputError
from sawbench.bench.processed import ProcessedTrial
from sawbench.bench.recording import Floats
from sawbench.bench.units import CHANNEL_BY_NAME
from sawbench.modeling.measured_cycles import TWO_PI, MeasuredCycles
from sawbench.processing.binning import AngleGrid

FIT_BINS: Final = 64


def measured_cycles(trial: ProcessedTrial) -> MeasuredCycles:
    """Lay the strokes of a trial's longest running phase over the crank angle.

    Parameters
    ----------
    trial : ProcessedTrial
        With its channels, so not one that was read back from a file.

    Raises
    ------
    InputError
        If the trial has no running strokes or no crank angle with a known zero.
    """
    where = trial.source_path or trial.trial.trial_id
    if trial.angle is None or trial.period is None:
        raise InputError(f"contains no running strokes ({trial.status})", where=where)
    if not trial.angle.is_absolute:
        raise InputError(
            "has no displacement, so the zero of the crank angle is unknown and k_Fc cannot be fitted",
            where=where,
            remedy="record displacement_mm",
        )
    running = [phase for phase in trial.phases if phase.kind == "running"]
    if not running:
        raise InputError("never reaches a steady speed", where=where)
    longest = max(running, key=lambda phase: phase.end_s - phase.start_s)
    channels = {
        name: (signal.time_s, signal.values * CHANNEL_BY_NAME[name].si_factor)
        for name, signal in trial.channels.items()
        if name in CHANNEL_BY_NAME
    }
    return cycles_from_samples(
        trial.angle.time_s,
        trial.angle.angle_rad,
        trial.angle.speed_rad_s,
        channels,
        n_bins=FIT_BINS,
        start_s=longest.start_s,
        end_s=longest.end_s,
        duty=trial.trial.duty,
        label=trial.trial.trial_id,
    )


# Size: arrays of any origin, each on its own.
def cycles_from_samples(
    angle_time_s: ArrayLike,
    unwrapped_angle_rad: ArrayLike,
    speed_rad_s: ArrayLike | None,
    channels: Mapping[str, tuple[ArrayLike, ArrayLike]],
    *,
    n_bins: int = 64,
    start_s: float | None = None,
    end_s: float | None = None,
    duty: float | None = None,
    label: str = "trial",
) -> MeasuredCycles:
    """Lay samples over the crank angle, stroke by stroke.

    The angle at each sample is interpolated linearly between the angle samples; a bin holds the mean of
    the samples that fall into it. A bin mean of a curve of curvature f'' is off by f''*width^2/24, and the
    fit evaluates its model the same way.

    Parameters
    ----------
    angle_time_s : array_like, shape (n,), s
        Increasing.
    unwrapped_angle_rad : array_like, shape (n,), rad
        Never decreasing; 0 (mod 2*pi) is the dead centre with the smallest displacement.
    speed_rad_s : array_like, shape (n,), rad/s, or None
        Crank speed at `angle_time_s`.
    channels : mapping of str to (time, values)
        By channel name: `force_n`, `motor_current_a`, `battery_voltage_v`, `battery_current_a`; each channel
        has its own times, s, and SI values. Others are ignored.
    n_bins : int
        Bins a stroke.
    start_s, end_s : float, optional
        Only complete strokes inside this stretch are used.
    duty : float, optional
    label : str

    Raises
    ------
    InputError
        If the arrays do not fit together or hold no complete stroke.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 1.0, 2001)
    >>> cycles = cycles_from_samples(t, 2 * np.pi * 10 * t, None, {"force_n": (t, t)}, n_bins=16, end_s=0.55)
    >>> cycles.n_cycles, round(float(cycles.mean_speed_rad_s / (2 * np.pi)), 6)
    (5, 10.0)
    """
    time_s, angle_rad = _pair(angle_time_s, unwrapped_angle_rad, "angle", label)
    if n_bins < 4:
        raise InputError(f"n_bins is {n_bins}, allowed is 4 or more", where=label)
    first, stop = _whole_strokes(time_s, angle_rad, start_s, end_s, label)
    boundaries_s = np.interp(TWO_PI * np.arange(first, stop + 1), angle_rad, time_s)
    bins = AngleGrid(first_turn=first, n_rows=stop - first, n_bins=n_bins)
    strokes = AngleGrid(first_turn=first, n_rows=stop - first, n_bins=1)

    def means(grid: AngleGrid, name: str) -> Floats | None:
        if name not in channels:
            return None
        sample_s, values = _pair(*channels[name], name, label)
        is_there = np.isfinite(values)
        return grid.means(grid.place_samples(time_s, angle_rad, sample_s[is_there]), values[is_there])

    def stroke_means(name: str) -> Floats | None:
        found = means(strokes, name)
        return None if found is None else found[:, 0]

    speed = None
    if speed_rad_s is not None:
        speed = bins.means(bins.place(angle_rad), _pair(time_s, speed_rad_s, "crank speed", label)[1])
    return MeasuredCycles(
        angle_rad=bins.middles_rad,
        cycle_start_s=boundaries_s[:-1],
        period_s=np.diff(boundaries_s),
        current_a=means(bins, "motor_current_a"),
        force_n=means(bins, "force_n"),
        crank_speed_rad_s=speed,
        battery_voltage_v=stroke_means("battery_voltage_v"),
        battery_current_a=stroke_means("battery_current_a"),
        duty=duty,
        label=label,
    )


def _whole_strokes(
    time_s: Floats, angle_rad: Floats, start_s: float | None, end_s: float | None, label: str
) -> tuple[int, int]:
    """Turn numbers of the first whole stroke inside the stretch, and of the one after the last."""
    if len(angle_rad) < 2 or np.diff(angle_rad).min() < 0:
        raise InputError("the crank angle must have two samples or more and must not decrease", where=label)
    first_s = time_s[0] if start_s is None else max(start_s, time_s[0])
    last_s = time_s[-1] if end_s is None else min(end_s, time_s[-1])
    span = np.interp([first_s, last_s], time_s, angle_rad) / TWO_PI
    first, stop = int(np.ceil(span[0] - 1e-9)), int(np.floor(span[1] + 1e-9))
    if stop - first < 1 or last_s <= first_s:
        raise InputError(
            f"no complete stroke between {first_s:.4g} s and {last_s:.4g} s",
            where=label,
            remedy="record longer, or fit a trial in which the blade runs",
        )
    return first, stop


def _pair(time: ArrayLike, values: ArrayLike, name: str, label: str) -> tuple[Floats, Floats]:
    time_s, array = np.asarray(time, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if time_s.ndim != 1 or time_s.shape != array.shape:
        raise InputError(f"{name}: {time_s.shape} times but {array.shape} values", where=label)
    if len(time_s) > 1 and not np.diff(time_s).min() > 0:
        raise InputError(f"{name}: time does not increase", where=label)
    return time_s, array
