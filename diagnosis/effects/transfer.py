"""Linear distortions of a reading: periodic strokes in the frequency domain, a start-up on its time grid."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bench.recording import Floats
from diagnosis.equations import Baseline, Signature
from diagnosis.reduction import START_UP_STEP_S, angle_derivative
from diagnosis.state import TWO_PI, State

TransferFunction = Callable[[Floats], NDArray[np.complexfloating]]


def filtered(wave: Floats, state: State, transfer: TransferFunction) -> Floats:
    """Pass strokes, or a start-up, through a transfer function of frequency in Hz.

    Parameters
    ----------
    wave : ndarray, shape (n_units, n_points)
        Of the state's grid. The speed ripple within a stroke is taken into account.
    state : State
    transfer : callable
        Frequency in Hz, shape (n_units or 1, n_frequencies) -> complex gain of a shape that broadcasts to it.

    Returns
    -------
    ndarray, shape of `wave`
        A start-up is taken to come from rest: before it the wave runs back to 0 with its first slope.

    Examples
    --------
    A transfer function of one changes nothing:

    >>> from types import SimpleNamespace
    >>> speed = 90.0 + 15.0 * np.cos(np.arange(32) * TWO_PI / 32)[None, :]
    >>> state = SimpleNamespace(kind="running", speed_rad_s=speed)
    >>> bool(np.allclose(filtered(speed**2, state, np.ones_like), speed**2))
    True
    """
    if state.kind != "running":
        return _filtered_start(wave, transfer)
    n_points = wave.shape[-1]
    orders = np.arange(n_points // 2)
    turns, slowness, period_s = _turns(state)
    weighted = wave * (slowness / period_s) / n_points
    coefficients = (turns.conj() @ weighted[..., None])[..., 0] if len(turns) > 1 else weighted @ turns[0].conj().T
    change = coefficients * (transfer(orders / period_s) - 1.0)
    change[:, 1:] *= 2.0
    back = (change[:, None, :] @ turns)[:, 0] if len(turns) > 1 else change @ turns[0]
    return wave + back.real


_MAX_KEPT = 64
_kept: dict[int, tuple[Floats, tuple[NDArray[np.complexfloating], Floats, Floats]]] = {}


def _turns(state: State) -> tuple[NDArray[np.complexfloating], Floats, Floats]:
    """exp(j n 2 pi t / T) at each crank angle, shape (rows, orders, points); slowness and period, once a state."""
    speed = state.speed_rad_s
    known = _kept.get(id(speed))
    if known is not None and known[0] is speed:
        return known[1]
    shown = speed[:1] if np.all(speed == speed[:1]) else speed  # the strokes of an averaged state are all alike
    slowness = TWO_PI / shown
    period_s = slowness.mean(axis=-1, keepdims=True)
    orders = np.arange(speed.shape[-1] // 2)
    turns = np.exp(1j * _time_phase(slowness / period_s)[..., None, :] * orders[:, None])
    if len(_kept) >= _MAX_KEPT:
        _kept.clear()
    _kept[id(speed)] = (speed, (turns, slowness, period_s))
    return turns, slowness, period_s


def _time_phase(share: Floats) -> Floats:
    """2 pi times the share of the period that has passed at each crank angle; `share` has mean 1."""
    n_points = share.shape[-1]
    spectrum = np.fft.rfft(share, axis=-1)
    spectrum[..., 0] = 0.0
    spectrum[..., 1:] /= 1j * np.arange(1, spectrum.shape[-1])
    return (np.arange(n_points) + 0.5) * TWO_PI / n_points + np.fft.irfft(spectrum, n_points, axis=-1)


def _filtered_start(wave: Floats, transfer: TransferFunction) -> Floats:
    n = wave.shape[-1]
    first, last = wave[..., :1], wave[..., -1:]
    slope = wave[..., 1:2] - first
    before = first + slope * np.arange(-n, 0)
    before = np.where(before * first > 0, before, 0.0)
    before = np.where(np.abs(before) <= np.abs(first), before, first)
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(n) / n)
    after = np.concatenate([np.broadcast_to(last, wave.shape), last * fade], axis=-1)
    long = np.concatenate([before, wave, after], axis=-1)
    spectrum = np.fft.rfft(long, axis=-1)
    frequency_hz = np.arange(spectrum.shape[-1])[None, :] / (long.shape[-1] * START_UP_STEP_S)
    change = np.fft.irfft(spectrum * (transfer(frequency_hz) - 1.0), long.shape[-1], axis=-1)
    return wave + change[..., n : 2 * n]


def low_pass(tau_s: float, damping: float = 0.0) -> TransferFunction:
    """Low-pass that delays slow signals by `tau_s`: of first order, or of second order with a damping above 0."""
    if damping == 0.0:
        return lambda f: 1.0 / (1.0 + 2j * np.pi * f * tau_s)
    natural_rad_s = 2.0 * damping / tau_s
    return lambda f: 1.0 / (1.0 + 2j * np.pi * f * tau_s - (2.0 * np.pi * f / natural_rad_s) ** 2)


def stroke_rate_hz(state: State) -> Floats:
    """Strokes per second of each unit, shape (n_units, 1)."""
    return 1.0 / (TWO_PI * np.mean(1.0 / np.maximum(state.speed_rad_s, 1e-3), axis=-1, keepdims=True))


def time_derivative(wave: Floats, state: State) -> Floats:
    """Differentiate a wave on the state's grid with time, per second."""
    if state.kind == "running":
        return state.speed_rad_s * angle_derivative(wave)
    return np.gradient(wave, START_UP_STEP_S, axis=-1)


def force_reading(baseline: Baseline, state: State, reading: Floats) -> Signature:
    """Change of the residuals where the load cell shows `reading` instead of the expected force.

    The mechanical equation is evaluated with the reading, so it misses the difference.
    """
    return force_error(baseline, state, reading - baseline.expected_force(state))


def force_error(baseline: Baseline, state: State, error_n: Floats) -> Signature:
    """Change of the residuals where the load cell shows `error_n` too much."""
    return {"cutting": error_n, "mechanical": -baseline.load_torque(state, error_n)}


def current_reading(baseline: Baseline, state: State, error_a: Floats, error_rate_a_s: Floats) -> Signature:
    """Change of the residuals where the motor current is read too high by `error_a`."""
    plant = baseline.plant
    return {
        "electrical": -plant.resistance_ohm.nominal * error_a - plant.inductance_h.nominal * error_rate_a_s,
        "mechanical": plant.torque_constant_n_m_per_a.nominal * error_a,
        "converter": -state.setting.duty * error_a,
    }
