"""Phase of one spectral line over time: the crank angle where there is no displacement.

The signal is multiplied by a turning phasor, summed over blocks of an eighth of a cycle and smoothed by a
Hann window of four cycles, whose zeros lie on the mean value, on half the rate and on every harmonic. Unlike
a spectrum over the whole trial it follows a drift of the speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np
from numba import njit
from numpy.typing import NDArray
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Floats
from sawbench.bench.runs import run_ends

_BLOCKS_A_CYCLE = 8
_WINDOW_CYCLES = 4
_MIN_AMPLITUDE_SHARE = 0.3
_MAX_RATE_CHANGE = 0.4


@dataclass(frozen=True, kw_only=True, slots=True)
class LinePhase:
    """One line of a signal over time.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
    phase_rad : ndarray, shape (n,)
        Unwrapped; 0 (mod 2 pi) where the line is at its maximum.
    amplitude : ndarray, shape (n,), in the unit of the signal
    """

    time_s: Floats
    phase_rad: Floats
    amplitude: Floats


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _block_sums(values, level, cosine, sine, step_rad, real, imaginary):
    """Sum (values - level) times exp(-i k step_rad) over blocks; the phasors of one block are given."""
    block = len(cosine)
    for b in range(len(real)):
        part = values[b * block : (b + 1) * block]
        total_c = total_s = 0.0
        for k in range(block):
            d = part[k] - level
            total_c += d * cosine[k]
            total_s += d * sine[k]
        c, s = cos(b * block * step_rad), sin(b * block * step_rad)
        real[b] = total_c * c - total_s * s
        imaginary[b] = -(total_c * s + total_s * c)


def demodulate(start_s: float, step_s: float, values: Floats, line_hz: float) -> LinePhase:
    """Follow the phase and amplitude of a line through an equally sampled signal.

    Parameters
    ----------
    start_s, step_s : float
        Time of the first sample and sample period, s.
    values : ndarray, shape (n,)
    line_hz : float
        Nominal frequency; the line may wander by about 25 % of it.

    Returns
    -------
    LinePhase
        One value per eighth of a cycle (or per sample where those are fewer).

    Examples
    --------
    >>> t = np.arange(0, 2, 1e-3)
    >>> line = demodulate(0.0, 1e-3, np.cos(2 * np.pi * 10.1 * t - 1.0), 10.0)
    >>> k = np.argmin(abs(line.time_s - 1.0))
    >>> bool(abs(np.angle(np.exp(1j * (line.phase_rad[k] - 2 * np.pi * 10.1 * line.time_s[k] + 1.0)))) < 0.01)
    True
    """
    values = np.ascontiguousarray(values, dtype=np.float64)
    block = max(int(1.0 / (line_hz * step_s * _BLOCKS_A_CYCLE)), 1)
    n_blocks = len(values) // block
    real, imaginary = np.empty(n_blocks), np.empty(n_blocks)
    step_rad = 2 * pi * line_hz * step_s
    in_block = np.arange(block) * step_rad
    level = float(values[:: max(block // 2, 1)].mean())
    _block_sums(values, level, np.cos(in_block), np.sin(in_block), step_rad, real, imaginary)
    taps = min(round(_WINDOW_CYCLES / (line_hz * step_s * block)), max(n_blocks // 2, 3))
    window = np.hanning(taps + 2)[1:-1]
    z = np.convolve(real, window, mode="same") + 1j * np.convolve(imaginary, window, mode="same")
    z /= _covered_weight(window, n_blocks) * block
    time = np.asarray((np.arange(n_blocks) * block + 0.5 * (block - 1)) * step_s, dtype=np.float64)
    wrapped = np.angle(z)
    turns = np.cumsum(np.rint(np.diff(wrapped, prepend=wrapped[:1]) / (2 * np.pi)))
    phase = np.asarray(2 * np.pi * (line_hz * time - turns) + wrapped, dtype=np.float64)
    return LinePhase(time_s=start_s + time, phase_rad=phase, amplitude=2 * np.abs(z))


def _covered_weight(window: Floats, n: int) -> Floats:
    """Sum of the window where it lies inside n values; smaller near both ends."""
    if n < 4 * len(window):
        return np.convolve(np.ones(n), window, mode="same")
    edge = np.convolve(np.ones(2 * len(window)), window, mode="same")[: len(window)]
    return np.concatenate((edge, np.full(n - 2 * len(window), window.sum()), edge[::-1]))


def angle_from_line(
    time_s: Floats,
    values: Floats,
    line_hz: float,
    *,
    order: int,
    peak_at_rad: float,
    noise_power: float,
    source: str,
) -> CrankAngle:
    """Crank angle from the phase of a line at `order` times the stroke rate.

    Parameters
    ----------
    time_s, values : ndarray, shape (n,)
    line_hz : float
    order : int
        Line frequency over stroke rate.
    peak_at_rad : float
        Crank angle at which the line is taken to peak; an assumption, hence `is_absolute` is False.
    noise_power : float
        Squared amplitude of the noise seen through a window of four cycles.
    source : str

    Returns
    -------
    CrankAngle
        Speed 0 where the line is weaker than 30 % of its median amplitude, off its rate by over 40 %, or fits
        for less than the window of four cycles.
    """
    step = float(np.median(np.diff(time_s)))
    grid = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    line = demodulate(float(grid[0]), step, np.interp(grid, time_s, values), line_hz)
    speed = np.gradient(line.phase_rad, line.time_s)
    strong = line.amplitude > _MIN_AMPLITUDE_SHARE * np.median(line.amplitude)
    valid = strong & (np.abs(speed / (2 * np.pi * line_hz) - 1) < _MAX_RATE_CHANGE)
    valid = _long_runs(valid, min(_WINDOW_CYCLES * _BLOCKS_A_CYCLE, len(valid) // 2))
    phase = np.maximum.accumulate(np.where(valid, line.phase_rad, -np.inf))
    phase[np.isneginf(phase)] = line.phase_rad[np.argmax(valid)] if valid.any() else 0.0
    std = np.sqrt(noise_power / 2) / np.maximum(line.amplitude, 1e-30)
    return CrankAngle(
        time_s=line.time_s,
        angle_rad=(phase + peak_at_rad) / order,
        speed_rad_s=np.where(valid, speed, 0.0) / order,
        angle_std_rad=np.minimum(std, np.pi) / order,
        radius_m=0.0,
        source=source,
        is_absolute=False,
    )


def _long_runs(mask: NDArray[np.bool_], shortest: int) -> NDArray[np.bool_]:
    """Keep the runs of True that are at least `shortest` long."""
    kept = np.zeros(len(mask), dtype=bool)
    for first, last in zip(*run_ends(mask), strict=True):
        kept[first:last] = last - first >= shortest
    return kept
