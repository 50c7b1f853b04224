"""What instruments make of a run: lags, resonance, lift-off, clocks, offsets. No motion changes.

Each function takes equally spaced samples, shape (n,), and returns new ones of the same shape. Linear
filters are discretised exactly for an input that is straight between the samples, so that they hold at any
sample rate.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bench.errors import InputError
from modeling.compilation import kernel
from modeling.validation import finite, not_negative, positive

Floats = NDArray[np.float64]


@kernel()
def _lag(values, decay, ramp):
    out = np.empty_like(values)
    out[0] = values[0]
    for k in range(1, len(values)):
        rise = values[k] - values[k - 1]
        out[k] = values[k - 1] + (out[k - 1] - values[k - 1]) * decay + rise * ramp
    return out


@kernel()
def _resonate(values, a, b, c, d, p0, p1, q0, q1):
    out = np.empty_like(values)
    x, v = values[0], 0.0
    out[0] = x
    for k in range(1, len(values)):
        before, now = values[k - 1], values[k]
        x, v = a * x + b * v + p0 * before + p1 * now, c * x + d * v + q0 * before + q1 * now
        out[k] = x
    return out


def lagged(values: Floats, *, rate_hz: float, time_constant_s: float) -> Floats:
    """First-order lag, tau dy/dt + y = x: a load cell's or a current sensor's amplifier.

    Examples
    --------
    >>> lagged(np.array([0.0, 1.0, 2.0]), rate_hz=1.0, time_constant_s=0.0).tolist()
    [0.0, 1.0, 2.0]
    """
    positive("rate_hz", rate_hz, "Hz")
    not_negative("time_constant_s", time_constant_s, "s")
    if time_constant_s == 0.0:
        return values.copy()
    u = 1.0 / (rate_hz * time_constant_s)
    decay = math.exp(-u)
    return _lag(np.ascontiguousarray(values, dtype=np.float64), decay, 1.0 + math.expm1(-u) / u)


def resonant(values: Floats, *, rate_hz: float, frequency_hz: float, damping: float) -> Floats:
    """Second-order resonance, y'' + 2 zeta w y' + w^2 y = w^2 x: the workpiece's carriage on its load cell.

    Parameters
    ----------
    values : ndarray, shape (n,)
    rate_hz : float
        Sample rate.
    frequency_hz : float
        Undamped frequency, 80 to 400 Hz on the bench.
    damping : float
        Relative to critical, in (0, 1).
    """
    positive("rate_hz", rate_hz, "Hz")
    positive("frequency_hz", frequency_hz, "Hz")
    if not 0 < damping < 1:
        raise InputError(f"damping must be in (0, 1), got {damping!r}")
    h, w = 1.0 / rate_hz, 2 * math.pi * frequency_hz
    sigma, turn = damping * w, w * math.sqrt(1 - damping**2)
    decay, cosine, sine = math.exp(-sigma * h), math.cos(turn * h), math.sin(turn * h) / turn
    a, b = decay * (cosine + sigma * sine), decay * sine
    c, d = -w * w * decay * sine, decay * (cosine - sigma * sine)
    # Answer to a ramp x = s t from rest: y = s (t - 2 zeta / w) + homogeneous part.
    lag = 2 * damping / w
    ramp_y = (h - lag + a * lag - b) / h
    ramp_v = (1.0 + c * lag - d) / h
    step_y, step_v = 1.0 - a, -c
    return _resonate(
        np.ascontiguousarray(values, dtype=np.float64),
        a,
        b,
        c,
        d,
        step_y - ramp_y,
        ramp_y,
        step_v - ramp_v,
        ramp_v,
    )


def lifted_off(force_n: Floats, *, preload_n: float) -> Floats:
    """Force clipped at the preload: above it the carriage leaves the load cell, N.

    Examples
    --------
    >>> lifted_off(np.array([10.0, 300.0]), preload_n=200.0).tolist()
    [10.0, 200.0]
    """
    positive("preload_n", preload_n, "N")
    return np.minimum(force_n, preload_n)


def late(values: Floats, *, rate_hz: float, delay_s: float, drift_s_per_s: float = 0.0) -> Floats:
    """Delay samples, as of a device whose clock is late: y(t) = x(t - delay - drift t), straight between.

    Before the first sample the first value holds.
    """
    positive("rate_hz", rate_hz, "Hz")
    finite("delay_s", delay_s, "s")
    finite("drift_s_per_s", drift_s_per_s, "s/s")
    time = np.arange(len(values)) / rate_hz
    return np.interp(time - delay_s - drift_s_per_s * time, time, values)


def offset(values: Floats, *, rate_hz: float, start: float = 0.0, drift_per_s: float = 0.0) -> Floats:
    """Zero of a channel: y = x + start + drift t, in the channel's unit."""
    positive("rate_hz", rate_hz, "Hz")
    finite("start", start, "")
    finite("drift_per_s", drift_per_s, "1/s")
    return values + start + drift_per_s * np.arange(len(values)) / rate_hz
