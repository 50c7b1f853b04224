"""Peak of the cutting force, stroke by stroke, without the bias of "largest sample"."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.correlated import std_of_mean
from sawbench.bench.folded import FoldedCycle
from sawbench.bench.recording import Floats
from sawbench.processing.folding import resample_cycles

_WINDOW_SHARE = 0.85
_DEGREE = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class PeakForce:
    """Mean peak over the strokes.

    Attributes
    ----------
    mean_n : float
    mean_std_n : float
        Standard uncertainty of `mean_n`, N.
    angle_rad : float
        Crank angle of the peak, rad.
    """

    mean_n: float
    mean_std_n: float
    angle_rad: float


def estimate_peak_force(
    cutting_force: FoldedCycle,
    angle_time_s: Floats,
    angle_rad: Floats,
    time_s: Floats,
    force_n: Floats,
    turns: NDArray[np.int64],
) -> PeakForce | None:
    """Peak of each stroke by projection on the shape of the mean stroke around its peak.

    Parameters
    ----------
    cutting_force : FoldedCycle
        With the return stroke zeroed.
    angle_time_s, angle_rad : ndarray, shape (n,)
    time_s, force_n : ndarray, shape (m,)
    turns : ndarray of int, shape (k,)

    Returns
    -------
    PeakForce or None
        None where no bin is positive.

    Notes
    -----
    A polynomial of degree 4 through the mean force where it exceeds 85 % of its largest value gives the shape
    g and its top; stroke k has the peak top * <f_k, g> / <g, g>. White noise does not bias this (the largest
    sample of a stroke would be high by 2.5 to 3.5 noise standard deviations). The peak is that of the force
    locked to the crank: tooth impacts that come at another angle in every stroke are averaged away, and a
    peak that wanders by d rad from stroke to stroke comes out low by about 0.5 (curvature) d^2, 0.5 d^2 of it
    for a half sine. The standard uncertainty allows for correlation of neighbouring strokes; of one
    stroke it is the peak itself: nothing is known.
    """
    mean = cutting_force.mean
    n_bins = len(mean)
    top = int(np.argmax(np.convolve(np.r_[mean[-2:], mean, mean[:2]], np.ones(5) / 5, mode="valid")))
    if mean[top] <= 0:
        return None
    window = _window_around(mean, top)
    if len(window) < 5:
        window = np.arange(top - 2, top + 3)
    step = 2 * np.pi / n_bins
    at = np.asarray((window + 0.5) * step, dtype=np.float64)
    inside = (at > 0) & (at < 2 * np.pi)
    window, at = window[inside], at[inside]
    u = (at - at.mean()) / max(float(np.ptp(at)), step)
    degree = min(_DEGREE, max(len(u) - 2, 1))
    curve = np.polynomial.polynomial.polyfit(u, mean[window % n_bins], degree)
    dense = np.linspace(u[0], u[-1], 401)
    shape = np.polynomial.polynomial.polyval(dense, curve)
    template = np.polynomial.polynomial.polyval(u, curve)
    strokes = resample_cycles(angle_time_s, angle_rad, time_s, force_n, turns, at)
    per_cycle = float(shape.max()) * (strokes @ template) / float(template @ template)
    mean_n = float(per_cycle.mean())
    return PeakForce(
        mean_n=mean_n,
        mean_std_n=std_of_mean(per_cycle)[0] if len(per_cycle) > 1 else abs(mean_n),
        angle_rad=float(at.mean() + dense[np.argmax(shape)] * max(float(np.ptp(at)), step)),
    )


def _window_around(mean: Floats, top: int) -> NDArray[np.int64]:
    level = _WINDOW_SHARE * mean[top]
    first = last = top
    while first > 0 and mean[first - 1] > level:
        first -= 1
    while last < len(mean) - 1 and mean[last + 1] > level:
        last += 1
    return np.arange(first, last + 1)
