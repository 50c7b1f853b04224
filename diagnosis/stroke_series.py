"""How hard every single stroke cuts, along the feed: the only place where the grain of the wood shows.

Strokes of a trial are folded and averaged for everything else, which takes the grain away. Here each stroke keeps
one number, the logarithm of force over speed by regression, and the wood's own wave is looked for in its
spectrum: a line or a hump at one wavelength of the feed path, the same in millimetres in every trial whatever
feed and stroke rate, above the scatter from stroke to stroke that any wood has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.processed import CrankAngle
from bench.recording import Floats, Recording
from bench.units import FORCE
from diagnosis.log_mean import log_mean_exp
from diagnosis.state import TWO_PI

_MIN_STROKES = 24
# Waves a metre that are tried, and widths of the hump as a share of its place.
_WAVES_PER_M = np.geomspace(60.0, 1200.0, 34)
_WIDTHS = (0.03, 0.1, 0.25)
# Frequencies of a wave that is locked to time, Hz: what a hand or a controller does.
_FREQUENCIES_HZ = np.geomspace(0.2, 8.0, 28)
# Depths of the wave that are tried, relative.
_DEPTHS = np.geomspace(0.02, 0.6, 9)
_LOWEST_WAVES = 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeSeries:
    """Hardness of the strokes of one trial.

    Attributes
    ----------
    label : str
    feed_m_s : float
    rate_hz : float
        Strokes per second.
    log_k : ndarray, shape (n,)
        Logarithm of each stroke's k_Fc, without mean and trend.
    k_n_s_per_m : ndarray, shape (n,)
        Slope of force over cutting speed within each stroke; a zero of the force sensor leaves it alone.
    time_s : ndarray, shape (n,)
        Middle of each stroke.
    """

    label: str
    feed_m_s: float
    rate_hz: float
    log_k: Floats
    k_n_s_per_m: Floats
    time_s: Floats


def stroke_series(
    recording: Recording, angle: CrankAngle, *, cutting_sign: int, radius_m: float, start_s: float, end_s: float
) -> StrokeSeries | None:
    """Regress the force of every stroke on the blade's speed.

    Parameters
    ----------
    recording : Recording
    angle : CrankAngle
    cutting_sign : int
        -1 where the blade cuts on pi..2 pi.
    radius_m : float
    start_s, end_s : float
        Settled part of the trial.

    Returns
    -------
    StrokeSeries or None
        None for idle trials, without force or feed, and where there are too few strokes.
    """
    force = recording.signals.get(FORCE.name)
    feed_mm_s = recording.trial.feed_mm_s
    if recording.trial.is_idle or force is None or not feed_mm_s:
        return None
    inside = (force.time_s >= start_s) & (force.time_s <= end_s) & np.isfinite(force.values)
    time_s, force_n = force.time_s[inside], force.values[inside]
    if len(time_s) < 2:
        return None
    turned = np.interp(time_s, angle.time_s, angle.angle_rad)
    speed = np.interp(time_s, angle.time_s, angle.speed_rad_s)
    cutting = np.maximum(cutting_sign * radius_m * speed * np.sin(turned), 0.0)
    turn = np.floor(turned / TWO_PI).astype(int)
    turn -= turn[0]
    work, square = np.bincount(turn, force_n * cutting)[1:-1], np.bincount(turn, cutting**2)[1:-1]
    if len(work) < _MIN_STROKES or not np.all(square > 0):
        return None
    hardness = work / square
    middle = float(np.median(hardness))
    if middle <= 0:
        return None
    log_k = np.log(np.clip(hardness / middle, 0.05, 20.0))
    count = np.arange(len(log_k))
    log_k = np.asarray(log_k - np.polyval(np.polyfit(count, log_k, 1), count), dtype=np.float64)
    rate_hz = (turned[-1] - turned[0]) / TWO_PI / (time_s[-1] - time_s[0])
    samples = np.bincount(turn)[1:-1]
    mean_force, mean_speed = (np.bincount(turn, values)[1:-1] / samples for values in (force_n, cutting))
    # Regression with intercept, stroke by stroke.
    slope = (work / samples - mean_force * mean_speed) / (square / samples - mean_speed**2)
    return StrokeSeries(
        label=recording.trial.trial_id,
        feed_m_s=1e-3 * feed_mm_s,
        rate_hz=float(rate_hz),
        log_k=log_k,
        k_n_s_per_m=np.asarray(slope, dtype=np.float64),
        time_s=np.asarray(np.bincount(turn, time_s)[1:-1] / samples, dtype=np.float64),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Grain:
    """What the strokes say of a wave in the wood.

    Attributes
    ----------
    log_evidence : float
        Of a wave against scatter alone (white and first-order), by Whittle's likelihood.
    depth : float
        Amplitude of the wave, relative.
    wavelength_m : float
    in_time : float
        Log evidence of a wave at one frequency in Hz instead: not the wood.
    """

    log_evidence: float
    depth: float
    wavelength_m: float
    in_time: float


def grain_evidence(trials: Sequence[StrokeSeries]) -> Grain:
    """Weigh a wave along the feed path against the scatter that any wood has.

    Parameters
    ----------
    trials : sequence of StrokeSeries

    Returns
    -------
    Grain
        With log evidence 0 and depth 0 where no trial has enough strokes.

    Notes
    -----
    The scatter's spectrum is that of white noise plus a first-order process, of the same size in all trials; both
    sizes and the memory are fitted under either hypothesis. Place, width and depth of the hump are averaged over.
    """
    if not trials:
        return Grain(log_evidence=0.0, depth=0.0, wavelength_m=float("nan"), in_time=0.0)
    spectra = [_periodogram(t) for t in trials]
    power = np.concatenate([s[0] for s in spectra])
    cycles = np.concatenate([s[1] for s in spectra])
    waves = np.concatenate([s[2] for s in spectra])
    density = np.concatenate([s[3] for s in spectra])
    rate_hz = np.concatenate([np.full(len(s[0]), t.rate_hz) for s, t in zip(spectra, trials, strict=True)])
    null, scatter = _fit_scatter(power, cycles)
    wood, depth, place = _average_wave(power, cycles, waves, density, _WAVES_PER_M, scatter)
    time, _, _ = _average_wave(power, cycles, cycles * rate_hz, rate_hz, _FREQUENCIES_HZ, scatter)
    return Grain(log_evidence=wood - null, depth=depth, wavelength_m=1.0 / place, in_time=time - null)


def _average_wave(
    power: Floats, cycles: Floats, waves: Floats, density: Floats, places: Floats, scatter: Floats
) -> tuple[float, float, float]:
    """Likelihood of a hump, averaged over place, width and depth, in logarithm; depth and place of the best."""
    white, coloured, fitted = (float(value) for value in scatter)
    # The scatter is tried again on a coarse grid: a wave takes variance from it.
    scatters = [
        _scatter_spectrum(cycles, shrink * white, shrink * coloured, memory)
        for shrink in (1.0, 0.4, 0.1)
        for memory in (fitted, 0.2)
    ]
    found: list[tuple[float, float, float]] = []
    for place in places:
        for width in _WIDTHS:
            spread = width * place
            hump = np.exp(-0.5 * ((waves - place) / spread) ** 2) / (spread * np.sqrt(TWO_PI)) * density
            for depth in _DEPTHS:
                value = max(_whittle(power, spectrum + 0.5 * depth**2 * hump) for spectrum in scatters)
                found.append((value, depth, place))
    logs = [f[0] for f in found]
    best = found[int(np.argmax(logs))]
    return log_mean_exp(logs), float(best[1]), float(best[2])


def _periodogram(trial: StrokeSeries) -> tuple[Floats, Floats, Floats, Floats]:
    """Power per stroke frequency, cycles a stroke, waves a metre, and metres of wave number a cycle."""
    n = len(trial.log_k)
    power = np.abs(np.fft.rfft(trial.log_k)) ** 2 / n
    cycles = np.arange(len(power)) / n
    keep = (cycles * n >= _LOWEST_WAVES) & (cycles < 0.5)
    scale = trial.rate_hz / trial.feed_m_s
    return power[keep], cycles[keep], cycles[keep] * scale, np.full(int(keep.sum()), scale)


def _scatter_spectrum(cycles: Floats, white: float, coloured: float, memory: float) -> Floats:
    return white + coloured * (1.0 - memory**2) / (1.0 - 2.0 * memory * np.cos(TWO_PI * cycles) + memory**2)


def _whittle(power: Floats, spectrum: Floats) -> float:
    spectrum = np.maximum(spectrum, 1e-8)
    return -float(np.sum(np.log(spectrum) + power / spectrum))


def _fit_scatter(power: Floats, cycles: Floats) -> tuple[float, Floats]:
    """Largest likelihood of scatter alone, and its white and coloured variance and memory."""
    from scipy.optimize import minimize

    size = max(float(power.mean()), 1e-8)

    def cost(x: Floats) -> float:
        white, coloured = np.exp(x[:2])
        return -_whittle(power, _scatter_spectrum(cycles, white, coloured, 0.98 * np.tanh(x[2])))

    starts = [np.array([np.log(0.5 * size), np.log(0.5 * size), m]) for m in (0.3, 1.2)]
    best = min((minimize(cost, x, method="Nelder-Mead", options={"maxiter": 400}) for x in starts), key=lambda r: r.fun)
    return -float(best.fun), np.array([np.exp(best.x[0]), np.exp(best.x[1]), 0.98 * np.tanh(best.x[2])])
