"""Spectral lines of a signal: Hann window, padded FFT, parabola through the logarithm of the peak."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.recording import Floats
from sawbench.processing.sliding import sliding_median

_MAX_SAMPLES = 1 << 20
_SEGMENT_CYCLES = 8.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Spectrum:
    """Power spectrum of one stretch of signal.

    Attributes
    ----------
    frequency_hz, power : ndarray, shape (m,)
        `power` is the squared amplitude of a sine line at its peak, in unit^2.
    floor : ndarray, shape (m,)
        Running median of the power: what is no line.
    resolution_hz : float
        1 / length of the stretch.
    """

    frequency_hz: Floats
    power: Floats
    floor: Floats
    resolution_hz: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Line:
    """One spectral line: frequency in Hz, squared amplitude in unit^2, ratio to the floor."""

    frequency_hz: float
    power: float
    prominence: float


def steady_stretch(time_s: Floats, values: Floats, min_rate_hz: float, max_rate_hz: float) -> tuple[Floats, float]:
    """Equally spaced samples of the steady part of a signal, for a spectrum.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
        One gap-free stretch.
    min_rate_hz, max_rate_hz : float
        Band of stroke rates looked for; harmonics up to the 12th of the highest are kept.

    Returns
    -------
    values : ndarray, shape (m,)
        The last 85 % (the start-up transient leaks into every line), at most 8 of the slowest strokes long
        and from the middle, so that a drift of speed does not smear the line.
    rate_hz : float
    """
    duration = time_s[-1] - time_s[0]
    begin = time_s[0] + 0.15 * duration
    length = min(time_s[-1] - begin, _SEGMENT_CYCLES / min_rate_hz)
    begin = max(begin, 0.5 * (begin + time_s[-1] - length))
    first, last = np.searchsorted(time_s, [begin, begin + length])
    last = max(int(last), int(first) + 2)
    t, y = time_s[first:last], values[first:last]
    step = float(np.median(np.diff(t)))
    keep_every = max(int(1.0 / (step * 24.0 * max_rate_hz)), 1, -(-len(t) // _MAX_SAMPLES))
    grid = np.arange(t[0], t[-1] + 0.5 * step, step)
    uniform = np.interp(grid, t, y)
    if keep_every > 1:
        uniform = uniform[: len(uniform) // keep_every * keep_every].reshape(-1, keep_every).mean(axis=1)
    return uniform, 1.0 / (step * keep_every)


def power_spectrum(values: Floats, rate_hz: float) -> Spectrum:
    """Hann-windowed spectrum, linear trend removed, four times padded.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Equally spaced.
    rate_hz : float
    """
    n = len(values)
    x = np.linspace(-1.0, 1.0, n)
    level = values - values.mean()
    level = level - x * (x @ level) / (x @ x)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)
    length = _fast_length(4 * n)
    amplitude = 2.0 * np.abs(np.fft.rfft(level * window, length)) / window.sum()
    power = amplitude**2
    coarse = power[:: max(len(power) // 4096, 1)]
    every = max(len(power) // 4096, 1)
    floor = sliding_median(coarse, min(129, len(coarse) // 2 * 2 - 1) if len(coarse) > 4 else 1)
    floor = np.interp(np.arange(len(power)), np.arange(len(coarse)) * every, floor)
    return Spectrum(
        frequency_hz=np.asarray(np.arange(len(power)) * (rate_hz / length), dtype=np.float64),
        power=power,
        floor=np.maximum(floor, 1e-30),
        resolution_hz=rate_hz / n,
    )


def _fast_length(least: int) -> int:
    """Smallest product of powers of 2, 3 and 5 that is not below `least`: a transform of it is quick."""
    best = 1 << (least - 1).bit_length()
    fives = 1
    while fives < best:
        odd = fives
        while odd < best:
            best = min(best, odd << (-(-least // odd) - 1).bit_length())
            odd *= 3
        fives *= 5
    return best


def find_lines(spectrum: Spectrum, low_hz: float, high_hz: float, count: int = 12) -> tuple[Line, ...]:
    """Strongest separate lines in a band, strongest first.

    Notes
    -----
    Log-parabola on a Hann window, four times padded: error below 1 % of the resolution without noise. Lines
    nearer than 2.5 resolutions to a stronger one are its side lobes and left out.
    """
    power = spectrum.power
    inner = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    f = spectrum.frequency_hz[inner]
    inner = inner[(f >= low_hz) & (f <= high_hz)]
    order = inner[np.argsort(power[inner])[::-1]]
    lines: list[Line] = []
    for k in order[: 40 * count]:
        line = _refine(spectrum, int(k))
        if all(abs(line.frequency_hz - other.frequency_hz) > 2.5 * spectrum.resolution_hz for other in lines):
            lines.append(line)
            if len(lines) == count:
                break
    return tuple(lines)


def _refine(spectrum: Spectrum, k: int) -> Line:
    a, b, c = np.log(np.maximum(spectrum.power[k - 1 : k + 2], 1e-300))
    curvature = a - 2 * b + c
    shift = 0.5 * (a - c) / curvature if curvature < 0 else 0.0
    step = spectrum.frequency_hz[1]
    power = float(np.exp(b - 0.25 * (a - c) * shift))
    return Line(frequency_hz=float((k + shift) * step), power=power, prominence=float(power / spectrum.floor[k]))


def power_near(spectrum: Spectrum, frequency_hz: float | NDArray[np.float64]) -> Floats:
    """Largest power within one resolution of each frequency (0 beyond the band).

    Parameters
    ----------
    spectrum : Spectrum
    frequency_hz : float or ndarray, shape (k,)

    Returns
    -------
    ndarray, shape (k,), unit^2
    """
    step = spectrum.frequency_hz[1]
    reach = max(round(spectrum.resolution_hz / step), 1)
    result = []
    for f in np.atleast_1d(frequency_hz):
        k = round(float(f) / step)
        part = spectrum.power[max(k - reach, 0) : k + reach + 1]
        result.append(float(part.max()) if len(part) else 0.0)
    return np.array(result)
