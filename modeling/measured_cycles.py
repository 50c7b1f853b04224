"""What a fit sees of one trial: every stroke laid over the crank angle, in SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.errors import InputError

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
        Mean over each stroke; NaN where the stroke has no sample.
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
                raise InputError(f"{name} has values that are not finite", where=self.label)
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
        raise InputError(f"{name} has infinite values", where=cycles.label)
    array.flags.writeable = False
    object.__setattr__(cycles, name, array)
