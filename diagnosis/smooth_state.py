"""The state that signatures are computed from: what noise there is in a residual must not be in them as well."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.reduction import N_HARMONICS, derivative_over_turns
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.modeling.state import TWO_PI, State

_MIN_ROWS_TO_SHRINK = 4
_NUMBERS = SETTINGS.reading


def smooth_state(state: State, blocks: Floats, *, mechanism: Mechanism, n_harmonics: int = 5) -> State:
    """State to compute signatures from: averaged over the units, the crank's motion limited to a few harmonics.

    A residual and a signature that share the same noise would shrink every parameter of the equation they stand
    in (errors in variables); averaging first takes that noise out of the signature.

    Parameters
    ----------
    state : State
    blocks : ndarray, shape (n_blocks, n_units)
        Averages units into time blocks; only the slow states differ from block to block.
    mechanism : Mechanism
        What the speed loses in harmonics, the blade's velocity keeps.
    n_harmonics : int

    Returns
    -------
    State
        Arrays of shape (n_blocks, n_points); a start-up comes back as it is.
    """
    if state.kind != "running":
        return state
    shape = (len(blocks), state.angle_rad.shape[1])

    def mean(wave: Floats | None, n: int, *, shrunk: bool = True) -> Floats | None:
        if wave is None:
            return None
        rows = np.fft.rfft(wave, axis=1)
        spectrum = rows.mean(axis=0) * (_signal_share(rows) if shrunk else 1.0)
        spectrum[n + 1 :] = 0.0
        return np.broadcast_to(np.fft.irfft(spectrum, shape[1]), shape)

    speed = mean(state.speed_rad_s, n_harmonics, shrunk=False)
    assert speed is not None
    speed = _certain_ripple(speed, state.ripple_std_rad)
    gained = np.full(1, TWO_PI * state.acceleration_rad_s2.mean() / speed.mean())
    # A machine that settles, or that another load slows, accelerates in one block more than in the next.
    slow = blocks @ state.acceleration_rad_s2.mean(axis=1, keepdims=True)
    acceleration = speed * derivative_over_turns(speed, gained, n_harmonics) + slow - slow.mean()
    changes: dict[str, Any] = {"speed_rad_s": speed, "acceleration_rad_s2": acceleration}
    if state.blade_excess_m_s is not None and len(state.speed_rad_s) < _MIN_ROWS_TO_SHRINK:
        changes["blade_excess_m_s"] = None
    elif state.blade_excess_m_s is not None:
        beyond = (state.speed_rad_s - speed[:1]) * mechanism.lever(state.angle_rad) + state.blade_excess_m_s
        # Half a stroke's cutting speed is the positive part of this: noise would pass for a force at both dead centres.
        wave, changes["excess_std_m_s"] = _certain_excess(beyond)
        changes["blade_excess_m_s"] = np.broadcast_to(wave, shape)
    for name in ("current_a", "current_rate_a_s", "battery_current_a"):
        changes[name] = mean(getattr(state, name), 2 * n_harmonics)
    for name in ("force_n", "force_rate_n_s"):
        changes[name] = mean(getattr(state, name), N_HARMONICS)
    for name in ("angle_rad", "battery_voltage_v", "motor_voltage_v", "time_s", "cut_distance_m", "charge_used_as"):
        wave = getattr(state, name)
        changes[name] = None if wave is None else blocks @ wave
    changes["slow"] = {name: blocks @ track for name, track in state.slow.items()}
    changes["n_strokes"] = (blocks > 0) @ state.n_strokes
    return replace(state, **changes)


def power_by_chance(n_rows: int, n_harmonics: int) -> float:
    """Power of a harmonic of the mean of rows, over its variance, that chance seldom exceeds in any harmonic.

    In one of twenty means, or less where the rows are few. Both are of complex numbers, and the variance is estimated
    from the differences of successive rows, which are worth two thirds of as many rows: a ratio of about the F
    distribution with 2 and 4 (n - 1) / 3 degrees of freedom.

    Parameters
    ----------
    n_rows : int
        At least 2.
    n_harmonics : int
    """
    half = 2.0 * (n_rows - 1) / 3.0
    return float(half * ((_NUMBERS.by_chance / n_harmonics) ** (-1.0 / half) - 1.0))


def _signal_share(spectra: NDArray[np.complex128], least: float = 0.0) -> Floats:
    """`_certain_share` of each harmonic of the mean of rows; 0 where its power is below so many times its variance."""
    n = len(spectra)
    if n < _MIN_ROWS_TO_SHRINK:
        return np.ones(spectra.shape[1])
    variance = _variance_of_mean(spectra)
    power = np.abs(spectra.mean(axis=0)) ** 2
    share = np.where(power < least * variance, 0.0, _certain_share(power, variance))
    share[0] = 1.0
    return share


def _certain_excess(rows: Floats) -> tuple[Floats, Floats]:
    """Mean of a velocity over the crank angle as far as it is certain, and the standard uncertainty of its harmonics.

    Parameters
    ----------
    rows : ndarray, shape (n_units, n_points)

    Returns
    -------
    wave : ndarray, shape (n_points,)
    std : ndarray, shape (N_HARMONICS,)
        Of sine and cosine part, from the first harmonic on; 0 where `wave` has none.
    """
    n_points = rows.shape[1]
    spectra = np.fft.rfft(rows, axis=1)
    share = _signal_share(spectra, power_by_chance(len(rows), N_HARMONICS))
    share[N_HARMONICS + 1 :] = 0.0
    std = share * np.sqrt(2.0 * _variance_of_mean(spectra)) / n_points
    return np.fft.irfft(share * spectra.mean(axis=0), n_points), std[1 : N_HARMONICS + 1]


def _variance_of_mean(spectra: NDArray[np.complex128]) -> Floats:
    """Of the mean of rows, both parts of each harmonic together, by what successive rows differ."""
    n = len(spectra)
    return np.sum(np.abs(np.diff(spectra, axis=0)) ** 2, axis=0) / (2.0 * (n - 1) * n)


def _certain_ripple(speed: Floats, std_rad: Floats) -> Floats:
    """Speed whose harmonics count as far as the one wave of the angle that a trial has is certain.

    All units of a trial share its error, so that their scatter says nothing of it.

    Parameters
    ----------
    speed : ndarray, shape (n_blocks, n_points)
    std_rad : ndarray, shape (k,)
        Of sine and cosine part of the angle's first harmonics.
    """
    spectrum, order = np.fft.rfft(speed, axis=1), np.arange(1, len(std_rad) + 1)
    wave_rad = 2.0 * np.abs(spectrum[:, order]) / (order * spectrum[:, :1].real)
    spectrum[:, order] *= _certain_share(wave_rad**2, 2.0 * std_rad**2)
    return np.fft.irfft(spectrum, speed.shape[1])


def _certain_share(power: Floats, variance: Floats) -> Floats:
    """Factor on a harmonic in a signature: 1 where it is certain, 0 where it is no more than noise.

    Squared noise in a signature is evidence out of nothing wherever the residual holds the same noise.
    """
    return np.clip(1.0 - _NUMBERS.noise_margin * variance / np.maximum(power, 1e-30), 0.0, 1.0)
