"""Recordings of an axis that moves to and fro at a constant rate, as states over the phase of its cycle.

Phase 0 is where the fundamental of the displacement is lowest. Every channel is fitted over whole cycles by a
Fourier series in the phase, which needs no equal spacing and gives speed and acceleration without differences.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from sawbench.bench.recording import Floats, Signal
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.machines.linear_axis import AxisState
from sawbench.modeling.state import TWO_PI, TrialSetting

N_POINTS = 128
N_HARMONICS = 40
_MOTION_HARMONICS = 20
_SAMPLES_PER_COEFFICIENT = 3.0
_TARGET_UNITS = 16
_RATE_HARMONICS = 3
_NUMBERS = SETTINGS.reading


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
    """

    rate_hz: float
    lowest_s: float
    starts_s: Floats
    per_unit: int

    def fit(self, signal: Signal, n_harmonics: int = N_HARMONICS) -> Floats:
        """Fourier coefficients of a channel, shape (n_units, 2 n_harmonics + 1): mean, cosines, sines."""
        rows = []
        for start_s in self.starts_s:
            end_s = start_s + self.per_unit / self.rate_hz
            inside = (signal.time_s >= start_s) & (signal.time_s < end_s)
            basis = fourier(TWO_PI * self.rate_hz * (signal.time_s[inside] - self.lowest_s), n_harmonics)
            normal = basis.T @ basis + 1e-6 * np.eye(basis.shape[1])
            rows.append(np.linalg.solve(normal, basis.T @ signal.values[inside]))
        return np.array(rows)


def fourier(phase_rad: Floats, n_harmonics: int) -> Floats:
    """Columns 1, cos k phase, sin k phase, shape (n, 2 n_harmonics + 1).

    Examples
    --------
    >>> fourier(np.zeros(1), 2).tolist()
    [[1.0, 1.0, 1.0, 0.0, 0.0]]
    """
    angle = np.outer(phase_rad, np.arange(1, n_harmonics + 1))
    return np.hstack([np.ones((len(phase_rad), 1)), np.cos(angle), np.sin(angle)])


def derivative(coefficients: Floats) -> Floats:
    """Coefficients of the derivative with respect to the phase, same shape."""
    n = (coefficients.shape[-1] - 1) // 2
    order = np.arange(1, n + 1)
    cosine, sine = coefficients[..., 1 : n + 1], coefficients[..., n + 1 :]
    return np.concatenate([np.zeros_like(coefficients[..., :1]), order * sine, -order * cosine], axis=-1)


def find_cycles(displacement: Signal) -> tuple[Cycles | None, str]:
    """Find the cycles of a trial, counted back from its end.

    Parameters
    ----------
    displacement : Signal

    Returns
    -------
    cycles : Cycles or None
    reason : str
        Why there are none, or which cycles are left out ("" if none).
    """
    if len(displacement.time_s) < 64 or float(np.ptp(displacement.values)) == 0.0:
        return None, "its displacement does not move"
    rate_hz = _rate_hz(displacement)
    time_s, values = displacement.time_s, displacement.values
    basis = fourier(TWO_PI * rate_hz * time_s, _RATE_HARMONICS)
    theta = np.linalg.lstsq(basis, values, rcond=None)[0]
    if float(np.var(values - basis @ theta)) > (1.0 - _NUMBERS.cyclic_share) * float(np.var(values)):
        return None, "its displacement is not cyclic at a constant rate"
    # The fundamental is -cos(phase): lowest where its phase is 0.
    lowest_s = float(np.arctan2(-theta[1 + _RATE_HARMONICS], -theta[1]) / (TWO_PI * rate_hz))
    n = int(displacement.duration_s * rate_hz + 1.0 - _NUMBERS.cycle_share)
    if n < 1:
        return None, "it holds no complete cycle"
    starts_s = time_s[-1] - np.arange(n, 0, -1) / rate_hz
    single = Cycles(rate_hz=rate_hz, lowest_s=lowest_s, starts_s=starts_s, per_unit=1)
    needed = _SAMPLES_PER_COEFFICIENT * (2 * N_HARMONICS + 1) * rate_hz / displacement.rate_hz
    motion = single.fit(displacement, _RATE_HARMONICS)[:, 1:]
    usual = np.median(motion, axis=0)
    deviates = np.linalg.norm(motion - usual, axis=1) > _NUMBERS.other_motion * np.linalg.norm(usual)
    kept = starts_s[int(np.flatnonzero(deviates)[-1]) + 1 :] if deviates.any() else starts_s
    per_unit = max(int(np.ceil(needed)), len(kept) // _TARGET_UNITS, 1)
    n_units = len(kept) // per_unit
    if n_units < 1:
        return None, f"only {len(kept)} of its {n} cycles are alike, too few samples for {N_HARMONICS} harmonics"
    kept = kept[len(kept) - n_units * per_unit :: per_unit]
    said = f"its first {int(deviates.nonzero()[0][-1]) + 1} cycles move differently" if deviates.any() else ""
    return replace(single, starts_s=kept, per_unit=per_unit), said


def _rate_hz(displacement: Signal) -> float:
    """Rate of the cycle: strongest line, refined by least squares with a few harmonics."""
    from scipy.optimize import minimize_scalar

    time_s, values = displacement.time_s, displacement.values
    n = len(time_s)
    even = np.interp(np.linspace(time_s[0], time_s[-1], n), time_s, values)
    spectrum = np.abs(np.fft.rfft((even - even.mean()) * np.hanning(n), 8 * n))
    duration_s = displacement.duration_s
    line_hz = np.arange(len(spectrum)) * (n - 1) / (8 * n * duration_s)
    spectrum[line_hz < 0.7 / duration_s] = 0.0
    crude_hz = float(line_hz[int(np.argmax(spectrum))])
    step = max(1, n // 4000)
    few_s, few = time_s[::step], values[::step]

    def misfit(rate_hz: float) -> float:
        basis = fourier(TWO_PI * rate_hz * few_s, _RATE_HARMONICS)
        rest = few - basis @ np.linalg.lstsq(basis, few, rcond=None)[0]
        return float(rest @ rest)

    reach_hz = min(0.5 / duration_s, 0.3 * crude_hz)
    found = minimize_scalar(misfit, bounds=(crude_hz - reach_hz, crude_hz + reach_hz), method="bounded")
    return float(found.x)


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
        Arrays of shape (n_units, 128); the load's time derivative is in `force_rate_n_s`.
    """
    points = (np.arange(N_POINTS) + 0.5) * TWO_PI / N_POINTS
    wide, narrow = fourier(points, N_HARMONICS).T, fourier(points, _MOTION_HARMONICS).T
    rate = TWO_PI * cycles.rate_hz
    motion = 1e-3 * cycles.fit(displacement)
    motion = np.hstack([motion[:, : _MOTION_HARMONICS + 1], motion[:, N_HARMONICS + 1 :][:, :_MOTION_HARMONICS]])
    force = None if load is None else cycles.fit(load)
    shape = (len(motion), N_POINTS)
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


def average(state: AxisState, blocks: Floats) -> AxisState:
    """Mean of the units of each time block, arrays of shape (n_blocks, n_points)."""
    names = ("angle_rad", "speed_rad_s", "acceleration_rad_s2", "motor_voltage_v", "time_s", "cut_distance_m")
    names += ("charge_used_as", "position_m", "velocity_m_s", "acceleration_m_s2", "drive_n")
    changes = {name: blocks @ getattr(state, name) for name in names}
    if state.force_n is not None and state.force_rate_n_s is not None:
        changes |= {"force_n": blocks @ state.force_n, "force_rate_n_s": blocks @ state.force_rate_n_s}
    return replace(state, **changes)
