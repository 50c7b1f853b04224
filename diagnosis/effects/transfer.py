"""Linear distortions of a reading, applied to periodic strokes in the frequency domain."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bench.recording import Floats
from diagnosis.equations import Baseline, Signature
from diagnosis.state import TWO_PI, State

TransferFunction = Callable[[Floats], NDArray[np.complex128]]


def filtered(wave: Floats, state: State, transfer: TransferFunction) -> Floats:
    """Pass strokes through a transfer function of frequency in Hz.

    Parameters
    ----------
    wave : ndarray, shape (n_units, n_points)
        Equally spaced over the crank angle; the speed ripple within a stroke is neglected.
    state : State
    transfer : callable
        Frequency in Hz -> complex gain.

    Returns
    -------
    ndarray, shape of `wave`; unchanged for a start-up, which is not periodic.
    """
    if state.kind != "running":
        return wave
    n_points = wave.shape[-1]
    rate_hz = 1.0 / (TWO_PI * np.mean(1.0 / state.speed_rad_s, axis=-1, keepdims=True))
    spectrum = np.fft.rfft(wave, axis=-1)
    return np.fft.irfft(spectrum * transfer(rate_hz * np.arange(spectrum.shape[-1])), n_points, axis=-1)


def force_reading(baseline: Baseline, state: State, reading: Floats) -> Signature:
    """Change of the residuals where the load cell shows `reading` instead of the expected force.

    The mechanical equation is evaluated with the reading, so it misses the difference.
    """
    error = reading - baseline.expected_force(state)
    return {"cutting": error, "mechanical": -baseline.load_torque(state, error)}


def current_reading(baseline: Baseline, state: State, error_a: Floats, error_rate_a_s: Floats) -> Signature:
    """Change of the residuals where the motor current is read too high by `error_a`."""
    plant = baseline.plant
    return {
        "electrical": -plant.resistance_ohm.nominal * error_a - plant.inductance_h.nominal * error_rate_a_s,
        "mechanical": plant.torque_constant_n_m_per_a.nominal * error_a,
        "converter": -state.setting.duty * error_a,
    }
