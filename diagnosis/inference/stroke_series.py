"""How hard every single stroke cuts, along the feed: the only place where the grain of the wood shows.

Strokes of a trial are folded and averaged for everything else, which takes the grain away. Here each stroke keeps
one number, the logarithm of force over speed by regression, and the wood's own wave is looked for in its
spectrum: a line or a hump at one wavelength of the feed path, the same in millimetres in every trial whatever
feed and stroke rate, above the scatter from stroke to stroke that any wood has. Along the cut any wood also varies as
much as from one piece to the next: a wave of that size is no effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sawbench.bench.processed import TrackedTrial
from sawbench.bench.recording import Floats
from sawbench.bench.units import FORCE
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.log_mean import log_mean_exp
from sawbench.modeling.effects.strokes import StrokeWave
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.modeling.state import TWO_PI
from sawbench.processing.binning import AngleGrid

# Widths of the hump as a share of its place, how many of them it reaches, and how many hold what varies.
_WIDTHS, _REACH, _WITHIN = (0.03, 0.1, 0.25), 8.0, 2.0
# Lowest and highest frequency of a wave that is locked to time, Hz, and its depths: what a hand or a controller does.
_FREQUENCIES_HZ, _DEPTHS = (0.2, 8.0), np.geomspace(0.02, 0.6, 9)
_LOWEST_WAVES = 2.0
# Amplitude of a wave that varies as much as pieces of one stock differ.
_ORDINARY_DEPTH = float(np.sqrt(2.0)) * SETTINGS.workpieces.piece_std


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeSeries:
    """Hardness of the strokes of one trial.

    Attributes
    ----------
    label : str
    material : str
        Of the workpiece; that of a trial which states none is its own.
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
    material: str
    feed_m_s: float
    rate_hz: float
    log_k: Floats
    k_n_s_per_m: Floats
    time_s: Floats


def stroke_series(trial: TrackedTrial, *, mechanism: Mechanism, cutting_sign: int) -> StrokeSeries | None:
    """Regress the force of every settled stroke on the blade's speed.

    Parameters
    ----------
    trial : TrackedTrial
    mechanism : Mechanism
    cutting_sign : int
        -1 where the blade cuts on pi..2 pi.

    Returns
    -------
    StrokeSeries or None
        None for idle trials, without force or feed, and where there are too few strokes.
    """
    force, angle, steady = trial.channels.get(FORCE.name), trial.angle, trial.steady
    feed_mm_s = trial.trial.feed_mm_s
    if trial.trial.is_idle or force is None or not feed_mm_s or angle is None or steady is None:
        return None
    inside = (force.time_s >= steady.settled_s) & (force.time_s <= steady.end_s)
    time_s, force_n = force.time_s[inside], force.values[inside]
    if len(time_s) < 2:
        return None
    turned = np.interp(time_s, angle.time_s, angle.angle_rad)
    speed = np.interp(time_s, angle.time_s, angle.speed_rad_s)
    cutting = np.maximum(cutting_sign * mechanism.lever(turned) * speed, 0.0)
    # The first and the last turn of the settled part are not whole.
    first, last = int(np.floor(turned[0] / TWO_PI)) + 1, int(np.floor(turned[-1] / TWO_PI))
    if last - first < SETTINGS.strokes.least_strokes:
        return None
    strokes = AngleGrid(first_turn=first, n_rows=last - first, n_bins=1)
    placed = strokes.place(turned)

    def mean(values: Floats) -> Floats:
        return strokes.means(placed, values)[:, 0]

    work, square, mean_force, mean_speed, middle_s = (
        mean(v) for v in (force_n * cutting, cutting**2, force_n, cutting, time_s)
    )
    # Of a stroke in which a hole begins too little is left to be regressed.
    read = strokes.sums(placed, cutting**2)[0][:, 0]
    is_read = read > 0.5 * np.median(read)
    if is_read.mean() < SETTINGS.strokes.least_read:
        return None

    work, square, mean_force, mean_speed, middle_s = (
        of[is_read] for of in (work, square, mean_force, mean_speed, middle_s)
    )

    def filled(values: Floats) -> Floats:
        """Where a stroke has too few samples, what lies between those beside it."""
        return np.interp(np.arange(len(is_read)), np.flatnonzero(is_read), values)

    hardness = filled(work / square)
    middle = float(np.median(hardness))
    if middle <= 0:
        return None
    log_k = np.log(np.clip(hardness / middle, 0.05, 20.0))
    count = np.arange(len(log_k))
    log_k = np.asarray(log_k - np.polyval(np.polyfit(count, log_k, 1), count), dtype=np.float64)
    rate_hz = (turned[-1] - turned[0]) / TWO_PI / (time_s[-1] - time_s[0])
    # Regression with intercept, stroke by stroke.
    slope = (work - mean_force * mean_speed) / (square - mean_speed**2)
    return StrokeSeries(
        label=trial.trial.trial_id,
        material=trial.trial.material or trial.trial.trial_id,
        feed_m_s=1e-3 * feed_mm_s,
        rate_hz=float(rate_hz),
        log_k=log_k,
        k_n_s_per_m=filled(slope),
        time_s=filled(middle_s),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Wave:
    """What the strokes say of a wave in the wood.

    Attributes
    ----------
    log_evidence : float
        Of a wave against scatter alone (white and first-order), by Whittle's likelihood; no more than 0 for a wave that
        is no deeper than pieces of wood differ.
    depth : float
        Amplitude of the wave, relative.
    wavelength_m : float
    """

    log_evidence: float
    depth: float
    wavelength_m: float


class StrokeSpectra:
    """Spectra of the hardness of all trials, in which waves are weighed against the scatter that any wood has.

    Parameters
    ----------
    trials : sequence of StrokeSeries
        At least one.

    Notes
    -----
    The scatter's spectrum is that of white noise plus a first-order process, of the same size in all trials; both
    sizes and the memory are fitted under either hypothesis. Place, width and depth of the hump are averaged over.
    """

    def __init__(self, trials: Sequence[StrokeSeries]) -> None:
        spectra = [_periodogram(t) for t in trials]
        self._power, self._cycles, self._waves, self._density = (
            np.concatenate(of) for of in zip(*spectra, strict=True)
        )
        rates = [np.full(len(s[0]), trial.rate_hz) for s, trial in zip(spectra, trials, strict=True)]
        self._rate_hz = np.concatenate(rates)
        self._trial = np.repeat(np.arange(len(trials)), [len(of[0]) for of in spectra])
        self._material = np.array([trial.material for trial in trials])[self._trial]
        self._n_strokes = np.array([len(trial.log_k) for trial in trials])[self._trial]
        self._null, (white, coloured, memory) = _fit_scatter(self._power, self._cycles)
        # The scatter is tried again on a coarse grid: a wave takes variance from it.
        self._scatters = np.array(
            [
                _scatter_spectrum(self._cycles, shrink * white, shrink * coloured, tried)
                for shrink in (1.0, 0.4, 0.1)
                for tried in (memory, 0.2)
            ]
        )
        self._costs = _costs(self._power, self._scatters)

    def wave(self, wave: StrokeWave) -> Wave:
        """Weigh a wave along the feed path."""
        log, depth, place = self._average(self._waves, self._density, wave.waves_per_m, wave.depths)
        return Wave(log_evidence=log, depth=depth, wavelength_m=1.0 / place)

    def wave_in_time(self) -> float:
        """Log evidence of a wave at one frequency in Hz instead: not the wood's."""
        return self._average(self._cycles * self._rate_hz, self._rate_hz, _FREQUENCIES_HZ, _DEPTHS)[0]

    def _average(
        self, waves: Floats, density: Floats, ends: tuple[float, float], depths: Floats
    ) -> tuple[float, float, float]:
        """Log evidence of a hump, averaged over place, width and depth; depth and place of the best.

        No more than 0 where the strokes vary there by no more than ordinary wood does. Places are half a width apart:
        with coarser ones it would be chance how well one of them meets a narrow hump, in time or along the feed.
        """
        of_widths: list[float] = []
        best = (-np.inf, 0.0, 0.0, 0)
        for width in _WIDTHS:
            logs: list[float] = []
            for place in np.geomspace(*ends, int(np.ceil(2.0 * np.log(ends[1] / ends[0]) / width)) + 1):
                spread = width * place
                hump = np.exp(-0.5 * ((waves - place) / spread) ** 2) / (spread * np.sqrt(TWO_PI)) * density
                near = np.abs(waves - place) < _REACH * spread
                far = np.sum(self._costs[:, ~near], axis=1)
                for depth in depths:
                    spectra = self._scatters[:, near] + 0.5 * depth**2 * hump[near]
                    cost = far + np.sum(_costs(self._power[near], spectra), axis=1)
                    logs.append(-float(cost.min()))
                    best = max(best, (logs[-1], float(place), float(spread), int(np.argmin(cost))))
            of_widths.append(log_mean_exp(logs))
        _, place, spread, scatter = best
        log = log_mean_exp(of_widths) - self._null
        # A sine is spread over two lines of the spectrum, however narrow it is.
        reach = np.maximum(_WITHIN * spread, 1.5 * density / self._n_strokes)
        depth = self._depth(np.abs(waves - place) < reach, scatter)
        return (log if depth > _ORDINARY_DEPTH else min(log, 0.0)), depth, place

    def _depth(self, inside: np.ndarray, scatter: int) -> float:
        """Amplitude of a sine that varies as much as the strokes do beyond their scatter, at some frequencies.

        In the material where it is deepest: wood has grain where plastic has none.
        """
        beyond = (self._power[inside] - self._scatters[scatter, inside]) / self._n_strokes[inside]
        trials, materials = self._trial[inside], self._material[inside]
        depths = [
            2.0 * np.sqrt(max(np.sum(beyond[materials == name]), 0.0) / len(np.unique(trials[materials == name])))
            for name in np.unique(materials)
        ]
        return float(max(depths, default=0.0))


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


def _costs(power: Floats, spectrum: Floats) -> Floats:
    """Whittle's negative log likelihood, frequency by frequency."""
    spectrum = np.maximum(spectrum, 1e-8)
    return np.log(spectrum) + power / spectrum


def _fit_scatter(power: Floats, cycles: Floats) -> tuple[float, Floats]:
    """Largest likelihood of scatter alone, and its white and coloured variance and memory."""
    from scipy.optimize import minimize

    size = max(float(power.mean()), 1e-8)

    def cost(x: Floats) -> float:
        white, coloured = np.exp(x[:2])
        return float(np.sum(_costs(power, _scatter_spectrum(cycles, white, coloured, 0.98 * np.tanh(x[2])))))

    starts = [np.array([np.log(0.5 * size), np.log(0.5 * size), m]) for m in (0.3, 1.2)]
    best = min((minimize(cost, x, method="Nelder-Mead", options={"maxiter": 400}) for x in starts), key=lambda r: r.fun)
    return -float(best.fun), np.array([np.exp(best.x[0]), np.exp(best.x[1]), 0.98 * np.tanh(best.x[2])])
