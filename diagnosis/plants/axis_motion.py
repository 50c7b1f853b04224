"""Recordings of an axis that moves back and forth at a constant rate, as states over the phase of its cycle.

Phase 0 is where the fundamental of the displacement is lowest. Every channel is fitted over whole cycles by a
Fourier series in the phase, which needs no equal spacing and gives speed and acceleration without differences. How
many harmonics the motion has is read off the displacement: a sine has one, a move of constant acceleration dozens.
Any other motion: `axis_windows`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats, Signal
from sawbench.diagnosis.inference.features import orders
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.machines.linear_axis import AxisState
from sawbench.modeling.state import TWO_PI, TrialSetting

# Points over the cycle for the most harmonics of a motion; fewer where the motion has fewer.
MOST_HARMONICS: Final = 128
LEAST_POINTS: Final = 128
_LEAST_HARMONICS: Final = 40
_SAMPLES_PER_COEFFICIENT = 3.0
_TARGET_UNITS = 16
_RATE_HARMONICS = 3
_NUMBERS = SETTINGS.reading
# A harmonic of the motion counts where its power is that many times its own variance.
_NOISE_MARGIN = 9.0
_NEIGHBOURS = 5
_MOST_SAMPLES = 10000
_REFINEMENTS = 3
# Where the swing is less than this share of its usual size the axis rests, starts or comes to a halt.
_LEAST_SWING = 0.5
_OTHER_SPEED = 1.5


@dataclass(frozen=True, kw_only=True, slots=True)
class Cycles:
    """Where the cycles of a trial lie.

    Attributes
    ----------
    rate_hz : float
    lowest_s : float
        A time at phase 0.
    starts_s : ndarray, shape (n_units,)
    per_unit : int
        Cycles a unit.
    n_fitted : int
        Harmonics that the samples of a unit allow.
    n_motion : int
        Harmonics of the motion above its noise.
    """

    rate_hz: float
    lowest_s: float
    starts_s: Floats
    per_unit: int
    n_fitted: int = _LEAST_HARMONICS
    n_motion: int = _LEAST_HARMONICS

    def fit(self, signal: Signal, n_harmonics: int | None = None) -> Floats:
        """Fourier coefficients of a channel, shape (n_units, 2 n_harmonics + 1): mean, cosines, sines."""
        rows, n = [], self.n_fitted if n_harmonics is None else n_harmonics
        for start_s in self.starts_s:
            end_s = start_s + self.per_unit / self.rate_hz
            inside = (signal.time_s >= start_s) & (signal.time_s < end_s)
            basis = fourier(TWO_PI * self.rate_hz * (signal.time_s[inside] - self.lowest_s), n)
            rows.append(_fitted(basis, signal.values[inside]))
        return np.array(rows)


def fourier(phase_rad: Floats, n_harmonics: int) -> Floats:
    """Columns 1, cos k phase, sin k phase, shape (n, 2 n_harmonics + 1).

    Examples
    --------
    >>> fourier(np.zeros(1), 2).tolist()
    [[1.0, 1.0, 1.0, 0.0, 0.0]]
    """
    turn = np.exp(1j * phase_rad)
    # Each order is a product more, which costs less than its sine and cosine.
    lines = np.cumprod(np.broadcast_to(turn[:, None], (len(turn), n_harmonics)), axis=1)
    return np.asarray(np.hstack([np.ones((len(turn), 1)), lines.real, lines.imag]), dtype=np.float64)


def _fitted(basis: Floats, values: Floats) -> Floats:
    """Least squares by the normal equations: over whole cycles the columns are nearly orthogonal."""
    normal = basis.T @ basis + 1e-6 * np.eye(basis.shape[1])
    return np.asarray(np.linalg.solve(normal, basis.T @ values), dtype=np.float64)


def derivative(coefficients: Floats) -> Floats:
    """Coefficients of the derivative with respect to the phase, same shape."""
    n = (coefficients.shape[-1] - 1) // 2
    order = np.arange(1, n + 1)
    cosine, sine = coefficients[..., 1 : n + 1], coefficients[..., n + 1 :]
    return np.concatenate([np.zeros_like(coefficients[..., :1]), order * sine, -order * cosine], axis=-1)


def find_cycles(displacement: Signal) -> tuple[Cycles | None, str]:
    """Find the cycles of a trial; rest, ramps and whatever moves differently before and after them are left out.

    Returns
    -------
    cycles : Cycles or None
    reason : str
        Why there are none, or what does not belong to them ("" if nothing).
    """
    if len(displacement.time_s) < 64 or float(np.ptp(displacement.values)) == 0.0:
        return None, "its displacement does not move"
    swinging = _swinging(displacement)
    roughly = _alike_cycles(displacement, swinging, _rate_hz(swinging))
    # Ramps pull at the rate: it is found again from the cycles that are alike.
    closely = roughly if isinstance(roughly, str) else _alike_cycles(displacement, swinging, roughly[2])
    if isinstance(closely, str):
        return None, closely
    cycles, kept, rate_hz = closely
    found, n = replace(cycles, rate_hz=rate_hz), len(cycles.starts_s)
    wanted = _SAMPLES_PER_COEFFICIENT * (2 * _LEAST_HARMONICS + 1) * rate_hz / displacement.rate_hz
    per_unit = max(int(np.ceil(wanted)), len(kept) // _TARGET_UNITS, 1)
    n_units = len(kept) // per_unit
    if n_units < 1:
        return None, f"only {len(kept)} of its {n} cycles agree, too few samples for {_LEAST_HARMONICS} harmonics"
    found = replace(found, starts_s=kept[len(kept) - n_units * per_unit :: per_unit], per_unit=per_unit)
    left_s = kept[0] - displacement.time_s[0], displacement.time_s[-1] - kept[-1] - 1.0 / rate_hz
    return _with_harmonics(found, displacement), _left_out(*(float(seconds) * rate_hz for seconds in left_s))


def _alike_cycles(displacement: Signal, swinging: Signal, rate_hz: float) -> tuple[Cycles, Floats, float] | str:
    """Cycles of a rate, the starts of those that are alike, the rate that these have; or why there are none."""
    found = _fundamental(swinging, rate_hz)
    if isinstance(found, str):
        return found
    first, end = _alike(found.fit(displacement, _RATE_HARMONICS)[:, 1:])
    kept = found.starts_s[first:end]
    if len(kept) == 0:
        return "no two of its cycles are alike"
    return found, kept, _refined(_between(displacement, kept[0], kept[-1] + 1.0 / rate_hz), rate_hz)


def _fundamental(displacement: Signal, rate_hz: float) -> Cycles | str:
    """Whole cycles of a rate, counted back from the end; or why there are none."""
    time_s, values = displacement.time_s, displacement.values
    basis = fourier(TWO_PI * rate_hz * time_s, _RATE_HARMONICS)
    theta = _fitted(basis, values)
    if float(np.var(values - basis @ theta)) > (1.0 - _NUMBERS.cyclic_share) * float(np.var(values)):
        return "its displacement is not cyclic at a constant rate"
    n = int((displacement.duration_s + _NUMBERS.lacking_samples / displacement.rate_hz) * rate_hz)
    if n < 1:
        return "it has no complete cycle"
    # The fundamental is -cos(phase): lowest where its phase is 0.
    lowest_s = float(np.arctan2(-theta[1 + _RATE_HARMONICS], -theta[1]) / (TWO_PI * rate_hz))
    starts_s = time_s[-1] - np.arange(n, 0, -1) / rate_hz
    return Cycles(rate_hz=rate_hz, lowest_s=lowest_s, starts_s=starts_s, per_unit=1)


def _between(signal: Signal, start_s: float, end_s: float) -> Signal:
    inside = (signal.time_s >= start_s) & (signal.time_s <= end_s)
    return Signal(channel=signal.channel, unit=signal.unit, time_s=signal.time_s[inside], values=signal.values[inside])


def _left_out(before: float, after: float) -> str:
    """What is said of cycles at the ends that count for nothing; "" where it is less than one on either side."""
    said = [f"{n:.1f} cycles at the {end}" for n, end in ((before, "beginning"), (after, "end")) if n >= 1.0]
    return f"{' and '.join(said)} differ (rest, ramp)" if said else ""


def _swinging(displacement: Signal) -> Signal:
    """Longest part that swings: without rest, and without ramps that would blur the rate.

    The swing is the root mean square about a straight line over stretches of two cycles of the strongest line.
    """
    time_s, values = displacement.time_s, displacement.values
    n_stretches = max(int(displacement.duration_s * _crude_rate_hz(displacement) * 2.0), 1)
    if n_stretches < 8:
        return displacement
    edges = np.linspace(time_s[0], time_s[-1], n_stretches + 1)
    swing = np.array(
        [np.ptp(values[(time_s >= a) & (time_s <= b)]) for a, b in zip(edges[:-2], edges[2:], strict=True)]
    )
    first, end = _longest(swing > _LEAST_SWING * float(np.quantile(swing, 0.75)))
    return _between(displacement, edges[first], edges[end + 1])


def _alike(motion: Floats) -> tuple[int, int]:
    """First and one past the last of the longest run of cycles whose motion is the usual one."""
    usual = np.median(motion, axis=0)
    return _longest(np.linalg.norm(motion - usual, axis=1) <= _NUMBERS.other_motion * np.linalg.norm(usual))


def _longest(is_good: np.ndarray) -> tuple[int, int]:
    """First and one past the last of the longest run of true values; the later one of two.

    Examples
    --------
    >>> _longest(np.array([True, False, True, True, False]))
    (2, 4)
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_good.astype(int), [0]])))
    runs = list(pairwise(edges))[::2]
    first, end = max(runs, key=lambda run: (run[1] - run[0], run[1]), default=(0, 0))
    return int(first), int(end)


def _with_harmonics(cycles: Cycles, displacement: Signal) -> Cycles:
    """Take the number of harmonics from the samples of a unit, and that of the motion from the displacement."""
    samples = displacement.rate_hz / cycles.rate_hz * cycles.per_unit
    n_fitted = int(np.clip((samples / _SAMPLES_PER_COEFFICIENT - 1.0) // 2, _LEAST_HARMONICS, MOST_HARMONICS))
    motion = cycles.fit(displacement, n_fitted)
    lines = motion[:, 1 : n_fitted + 1] + 1j * motion[:, n_fitted + 1 :]
    power = np.abs(lines.mean(axis=0)) ** 2
    if len(lines) > 2:
        variance = np.var(lines, axis=0, ddof=1) / len(lines)
    else:
        variance = np.full(n_fitted, float(np.median(power[n_fitted // 2 :])))
    width = np.ones(_NEIGHBOURS) / _NEIGHBOURS
    above = np.convolve(power, width, "same") > _NOISE_MARGIN * np.convolve(variance, width, "same")
    n_motion = int(np.flatnonzero(above)[-1]) + 1 if above.any() else 1
    return replace(cycles, n_fitted=n_fitted, n_motion=n_motion)


def _crude_rate_hz(displacement: Signal) -> float:
    """Strongest line of the spectrum."""
    time_s, values = displacement.time_s, displacement.values
    n = len(time_s)
    even = np.interp(np.linspace(time_s[0], time_s[-1], n), time_s, values)
    spectrum = np.abs(np.fft.rfft((even - even.mean()) * np.hanning(n), 8 * n))
    duration_s = displacement.duration_s
    line_hz = np.arange(len(spectrum)) * (n - 1) / (8 * n * duration_s)
    spectrum[line_hz < 0.7 / duration_s] = 0.0
    return float(line_hz[int(np.argmax(spectrum))])


def _rate_hz(displacement: Signal) -> float:
    """Rate of the cycle: strongest line, refined by least squares with a few harmonics."""
    from scipy.optimize import minimize_scalar

    crude_hz, duration_s = _crude_rate_hz(displacement), displacement.duration_s
    step = max(1, len(displacement.time_s) // 4000)
    few_s, few = displacement.time_s[::step], displacement.values[::step]

    def misfit(rate_hz: float) -> float:
        basis = fourier(TWO_PI * rate_hz * few_s, _RATE_HARMONICS)
        rest = few - basis @ _fitted(basis, few)
        return float(rest @ rest)

    reach_hz = min(0.5 / duration_s, 0.3 * crude_hz)
    found = minimize_scalar(misfit, bounds=(crude_hz - reach_hz, crude_hz + reach_hz), method="bounded")
    return float(found.x)


def _refined(displacement: Signal, rate_hz: float) -> float:
    """Rate with all harmonics that count: a cycle that is cut too late by a millisecond jumps at its ends.

    Gauss-Newton: beside the harmonics, the change of the motion with the rate is fitted.
    """
    time_s, values = displacement.time_s, displacement.values
    step = max(1, len(time_s) // _MOST_SAMPLES)
    since_s, few = time_s[::step] - time_s[0], values[::step]
    most = int(len(few) / (displacement.duration_s * rate_hz) / _SAMPLES_PER_COEFFICIENT) // 2
    n = min(_LEAST_HARMONICS, most)
    if n <= _RATE_HARMONICS:
        return rate_hz
    for _ in range(_REFINEMENTS):
        basis = fourier(TWO_PI * rate_hz * since_s, n)
        rest = few - basis @ (theta := _fitted(basis, few))
        change = TWO_PI * since_s * (basis @ derivative(theta))
        # What the harmonics take of the change is theirs.
        change -= basis @ _fitted(basis, change)
        step_hz = float(change @ rest) / max(float(change @ change), 1e-300)
        rate_hz += float(np.clip(step_hz, -0.1 / displacement.duration_s, 0.1 / displacement.duration_s))
    return rate_hz


def n_points(n_harmonics: int) -> int:
    """Points over a cycle for so many harmonics: four or more each, a power of two.

    Examples
    --------
    >>> n_points(20), n_points(100)
    (128, 512)
    """
    return max(LEAST_POINTS, 1 << int(np.ceil(np.log2(4 * n_harmonics))))


def axis_state(
    cycles: Cycles, setting: TrialSetting, displacement: Signal, drive: Signal, load: Signal | None, newton: float
) -> AxisState:
    """Put the cycles of a trial on a grid.

    Parameters
    ----------
    cycles : Cycles
    setting : TrialSetting
    displacement : Signal, mm
    drive : Signal
        A or N.
    load : Signal or None, N
    newton : float
        Force for one unit of `drive`, N.

    Returns
    -------
    AxisState
        Arrays of shape (n_units, n_points); the load's time derivative is in `force_rate_n_s`.
    """
    n, n_motion = cycles.n_fitted, cycles.n_motion
    points = (np.arange(n_points(n_motion)) + 0.5) * TWO_PI / n_points(n_motion)
    # Beyond half of the points a harmonic would be taken for another one.
    wide = fourier(points, n).T * (orders(n) < len(points) // 2)[:, None]
    narrow = fourier(points, n_motion).T
    rate = TWO_PI * cycles.rate_hz
    motion = 1e-3 * cycles.fit(displacement)
    motion = np.hstack([motion[:, : n_motion + 1], motion[:, n + 1 :][:, :n_motion]])
    force = None if load is None else cycles.fit(load)
    shape = (len(motion), len(points))
    middle_s = (cycles.starts_s + 0.5 * cycles.per_unit / cycles.rate_hz)[:, None]
    return AxisState(
        kind="running",
        setting=setting,
        angle_rad=np.broadcast_to(points, shape),
        speed_rad_s=np.full(shape, rate),
        acceleration_rad_s2=np.zeros(shape),
        current_a=None,
        current_rate_a_s=None,
        force_n=None if force is None else force @ wide,
        force_rate_n_s=None if force is None else rate * derivative(force) @ wide,
        battery_voltage_v=None,
        battery_current_a=None,
        motor_voltage_v=np.full(shape, np.nan),
        time_s=middle_s,
        cut_distance_m=np.zeros_like(middle_s),
        charge_used_as=np.zeros_like(middle_s),
        n_strokes=np.full(len(motion), float(cycles.per_unit)),
        position_m=motion @ narrow,
        velocity_m_s=rate * derivative(motion) @ narrow,
        acceleration_m_s2=rate**2 * derivative(derivative(motion)) @ narrow,
        drive_n=newton * (cycles.fit(drive) @ wide),
    )


def has_several_speeds(states: Sequence[AxisState]) -> bool:
    """Whether the fastest move of a campaign is half as fast again as its slowest; a move lies between two reversals.

    Moves slower than the share of the top speed below which friction is whatever holds the axis do not count.
    """
    tops: list[float] = []
    for state in states:
        for velocity in state.velocity_m_s:
            turns = np.flatnonzero(np.diff(np.sign(velocity))) + 1
            moves = np.split(np.abs(velocity), turns)
            # A window may begin and end in the middle of a move.
            tops += [float(move.max()) for move in (moves if state.is_cyclic else moves[1:-1])]
    counted = [top for top in tops if top > SETTINGS.axis.standstill_share * max(tops)]
    return max(counted, default=0.0) > _OTHER_SPEED * min(counted, default=0.0)


def average(state: AxisState, blocks: Floats) -> AxisState:
    """Mean of the units of each time block, arrays of shape (n_blocks, n_points)."""
    names = ("angle_rad", "speed_rad_s", "acceleration_rad_s2", "motor_voltage_v", "time_s", "cut_distance_m")
    names += ("charge_used_as", "position_m", "velocity_m_s", "acceleration_m_s2", "drive_n")
    changes = {name: blocks @ getattr(state, name) for name in names}
    if state.force_n is not None and state.force_rate_n_s is not None:
        changes |= {"force_n": blocks @ state.force_n, "force_rate_n_s": blocks @ state.force_rate_n_s}
    return replace(state, **changes)
