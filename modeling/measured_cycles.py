"""What a fit sees of one trial: every stroke laid over the crank angle, in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.errors import InputError
from modeling.compilation import kernel

Floats = NDArray[np.float64]
TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, kw_only=True, slots=True)
class MeasuredCycles:
    """Complete strokes of one trial in the crank-angle domain.

    Attributes
    ----------
    angle_rad : ndarray, shape (n_bins,)
        Bin centres, 0..2*pi, equally spaced; 0 is the dead centre with the smallest displacement.
    cycle_start_s : ndarray, shape (n_cycles,)
        Time at which each stroke passes angle 0, s, increasing.
    period_s : ndarray, shape (n_cycles,)
        Duration of each stroke, s.
    current_a, force_n, crank_speed_rad_s : ndarray, shape (n_cycles, n_bins), or None
        Motor current, cutting force (positive when the blade cuts), crank speed; NaN marks an empty bin.
    battery_voltage_v, battery_current_a : ndarray, shape (n_cycles,), or None
        Mean over each stroke; NaN where the stroke holds no sample.
    duty : float or None
        Commanded duty, 0..1.
    label : str
        Named in errors.

    Examples
    --------
    >>> cycles = MeasuredCycles(angle_rad=[1.0, 3.0, 5.0], cycle_start_s=[0.0, 0.1], period_s=[0.1, 0.1],
    ...                         force_n=[[0.0, 1.0, 9.0], [0.0, 1.0, 11.0]], label="example")
    >>> cycles.n_cycles, cycles.mean("force_n").tolist()
    (2, [0.0, 1.0, 10.0])
    """

    angle_rad: Floats
    cycle_start_s: Floats
    period_s: Floats
    current_a: Floats | None = None
    force_n: Floats | None = None
    crank_speed_rad_s: Floats | None = None
    battery_voltage_v: Floats | None = None
    battery_current_a: Floats | None = None
    duty: float | None = None
    label: str = "trial"

    def __post_init__(self) -> None:
        _freeze(self, "angle_rad", 1)
        _freeze(self, "cycle_start_s", 1)
        n_cycles, n_bins = len(self.cycle_start_s), len(self.angle_rad)
        for name in ("period_s", "battery_voltage_v", "battery_current_a"):
            _freeze(self, name, 1, (n_cycles,))
        for name in ("current_a", "force_n", "crank_speed_rad_s"):
            _freeze(self, name, 2, (n_cycles, n_bins))
        for name in ("angle_rad", "cycle_start_s", "period_s"):
            if not np.isfinite(getattr(self, name)).all():
                raise InputError(f"{name} holds values that are not finite", where=self.label)
        if n_cycles > 1 and np.diff(self.cycle_start_s).min() <= 0:
            raise InputError("cycle_start_s does not increase", where=self.label)
        if n_cycles and self.period_s.min() <= 0:
            raise InputError(f"period_s must be positive, got {float(self.period_s.min()):.4g} s", where=self.label)
        if self.duty is not None and not 0.0 < self.duty <= 1.0:
            raise InputError(f"duty is {self.duty!r}, allowed is above 0 and up to 1", where=self.label)

    @property
    def n_cycles(self) -> int:
        """Number of complete strokes."""
        return len(self.cycle_start_s)

    @property
    def n_bins(self) -> int:
        """Number of bins a stroke."""
        return len(self.angle_rad)

    @property
    def mean_speed_rad_s(self) -> float:
        """Crank angle travelled over the time it took, rad/s."""
        return float(TWO_PI / np.mean(self.period_s))

    def mean(self, name: str) -> Floats:
        """Mean over the strokes of an array named like the attribute, NaN where no stroke has a value."""
        values = getattr(self, name)
        if values is None:
            raise InputError(f"has no {name}", where=self.label)
        present = np.isfinite(values)
        count = present.sum(axis=0)
        total = np.where(present, values, 0.0).sum(axis=0)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    def between(self, start: int, stop: int) -> MeasuredCycles:
        """Strokes `start` to `stop` (exclusive) as measured cycles of their own."""

        def part(values: Floats | None) -> Floats | None:
            return None if values is None else values[start:stop]

        return MeasuredCycles(
            angle_rad=self.angle_rad,
            cycle_start_s=self.cycle_start_s[start:stop],
            period_s=self.period_s[start:stop],
            current_a=part(self.current_a),
            force_n=part(self.force_n),
            crank_speed_rad_s=part(self.crank_speed_rad_s),
            battery_voltage_v=part(self.battery_voltage_v),
            battery_current_a=part(self.battery_current_a),
            duty=self.duty,
            label=self.label,
        )


def _freeze(cycles: MeasuredCycles, name: str, ndim: int, shape: tuple[int, ...] | None = None) -> None:
    values = getattr(cycles, name)
    if values is None:
        return
    array = np.array(values, dtype=np.float64)
    if array.ndim != ndim or (shape is not None and array.shape != shape):
        raise InputError(
            f"{name} has shape {array.shape}, expected {shape or f'{ndim} dimension(s)'}", where=cycles.label
        )
    if np.isinf(array).any():
        raise InputError(f"{name} holds infinite values", where=cycles.label)
    array.flags.writeable = False
    object.__setattr__(cycles, name, array)


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

    Returns
    -------
    MeasuredCycles

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
    if len(angle_rad) < 2 or np.diff(angle_rad).min() < 0:
        raise InputError("the crank angle must hold two samples or more and never decrease", where=label)
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
    boundaries_s = np.interp(TWO_PI * np.arange(first, stop + 1), angle_rad, time_s)
    binned = {
        name: _bin(time_s, angle_rad, channels[name], name, (first, stop, n_bins), label)
        for name in ("motor_current_a", "force_n")
        if name in channels
    }
    per_cycle = {
        name: _bin(time_s, angle_rad, channels[name], name, (first, stop, 1), label)[:, 0]
        for name in ("battery_voltage_v", "battery_current_a")
        if name in channels
    }
    speed = None
    if speed_rad_s is not None:
        speed = _bin(time_s, angle_rad, (time_s, speed_rad_s), "crank speed", (first, stop, n_bins), label)
    return MeasuredCycles(
        angle_rad=(np.arange(n_bins) + 0.5) * TWO_PI / n_bins,
        cycle_start_s=boundaries_s[:-1],
        period_s=np.diff(boundaries_s),
        current_a=binned.get("motor_current_a"),
        force_n=binned.get("force_n"),
        crank_speed_rad_s=speed,
        battery_voltage_v=per_cycle.get("battery_voltage_v"),
        battery_current_a=per_cycle.get("battery_current_a"),
        duty=duty,
        label=label,
    )


def _pair(time: ArrayLike, values: ArrayLike, name: str, label: str) -> tuple[Floats, Floats]:
    # Copies: writable and contiguous, so the compiled loop exists in one variant only.
    time_s, array = np.array(time, dtype=np.float64), np.array(values, dtype=np.float64)
    if time_s.ndim != 1 or time_s.shape != array.shape:
        raise InputError(f"{name}: {time_s.shape} times but {array.shape} values", where=label)
    if len(time_s) > 1 and not np.diff(time_s).min() > 0:
        raise InputError(f"{name}: time does not increase", where=label)
    return time_s, array


def _bin(
    time_s: Floats,
    angle_rad: Floats,
    channel: tuple[ArrayLike, ArrayLike],
    name: str,
    layout: tuple[int, int, int],
    label: str,
) -> Floats:
    sample_s, values = _pair(channel[0], channel[1], name, label)
    first, stop, n_bins = layout
    total, count = _accumulate(time_s, angle_rad, sample_s, values, first, stop - first, n_bins)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@kernel()
def _accumulate(time_s, angle_rad, sample_s, values, first, n_cycles, n_bins):  # pragma: no cover - compiled
    """Sum and count of the samples in each bin of each stroke; values that are not finite are left out."""
    total = np.zeros((n_cycles, n_bins))
    count = np.zeros((n_cycles, n_bins), dtype=np.int64)
    bins_per_rad = n_bins / (2.0 * np.pi)
    last = len(time_s) - 1
    k = 0
    for j in range(len(sample_s)):
        t = sample_s[j]
        if t < time_s[0] or t > time_s[last] or not np.isfinite(values[j]):
            continue
        while k < last - 1 and time_s[k + 1] < t:
            k += 1
        share = (t - time_s[k]) / (time_s[k + 1] - time_s[k])
        angle = angle_rad[k] + share * (angle_rad[k + 1] - angle_rad[k])
        index = int(np.floor(angle * bins_per_rad)) - first * n_bins
        if 0 <= index < n_cycles * n_bins:
            total[index // n_bins, index % n_bins] += values[j]
            count[index // n_bins, index % n_bins] += 1
    return total, count
