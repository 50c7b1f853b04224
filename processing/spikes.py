"""Single samples far from their neighbours: of a cable at any time, of the machine at one crank angle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.processed import CrankAngle
from sawbench.bench.recording import Floats
from sawbench.bench.units import CHANNEL_BY_NAME
from sawbench.processing.noise import robust_range, white_noise_std

_NOISE_STDS = 12.0
_OVERLOAD_RANGES = 10.0
_RANGE_SHARE = 0.25
# A part strikes once a stroke, or at both dead centres, or at all four places where its load changes sides.
_TIMES_A_STROKE = (1, 2, 4)
_BY_CHANCE = 1e-6
# Median deviations of the angles of impacts; what is farther off is of a cable.
_SPREADS = 4.5
_MOVING_SHARE = 0.1  # of the highest speed; at rest every sample has the same angle


def find_spikes(values: Floats, noise_std: float | None = None) -> NDArray[np.bool_]:
    """Mark isolated samples far from their neighbours.

    Parameters
    ----------
    values : ndarray, shape (n,)
    noise_std : float, optional
        Of their white noise, where it is known.

    Returns
    -------
    ndarray of bool, shape (n,)

    Notes
    -----
    A spike is one or two samples off the median of the five around it by over 12 noise standard deviations
    and over a quarter of the channel's range (0.5 to 99.5 %): real edges are left alone, small spikes are
    missed.
    """
    if len(values) < 16:
        return np.zeros(len(values), dtype=bool)
    is_spike = np.zeros(len(values), dtype=bool)
    low, high = robust_range(values)
    limit, step = _RANGE_SHARE * float(high - low), np.abs(np.diff(values))
    if step.max() <= 0.5 * limit:
        return is_spike
    limit = max(_NOISE_STDS * (white_noise_std(values) if noise_std is None else noise_std), limit)
    if limit <= 0:
        return is_spike
    # Only samples that jump against a neighbour can be spikes: the median is taken at those alone.
    jump = step > 0.5 * limit
    suspects = np.flatnonzero(np.r_[jump, False] | np.r_[False, jump])
    if len(suspects):
        around = np.clip(suspects[:, None] + np.arange(-2, 3), 0, len(values) - 1)
        is_spike[suspects] = np.abs(values[suspects] - np.median(values[around], axis=1)) > limit
    return is_spike


def find_overloads(values: Floats, channel: str) -> NDArray[np.bool_]:
    """Mark samples, any number on end, that the channel cannot have: what an instrument writes beyond its range.

    Parameters
    ----------
    values : ndarray, shape (n,)
    channel : str

    Returns
    -------
    ndarray of bool, shape (n,)
        Of a channel of `bench.units`, where it is outside its plausible values and off by ten times its range (0.5 to
        99.5 %): a channel in another unit is outside throughout, and has its range there.
    """
    known = CHANNEL_BY_NAME.get(channel)
    if known is None or len(values) < 16:
        return np.zeros(len(values), dtype=bool)
    is_outside = (values < known.plausible[0]) | (values > known.plausible[1])
    if not is_outside.any():
        return is_outside
    low, high = robust_range(values)
    return is_outside & (np.abs(values - 0.5 * (low + high)) > _OVERLOAD_RANGES * (high - low))


def at_one_crank_angle(time_s: Floats, is_spike: NDArray[np.bool_], angle: CrankAngle | None) -> NDArray[np.bool_]:
    """Mark the spikes that come at the same crank angle in many strokes: impacts in the machine, not of a cable.

    Parameters
    ----------
    time_s : ndarray, shape (n,), s
    is_spike : ndarray of bool, shape (n,)
    angle : CrankAngle or None

    Returns
    -------
    ndarray of bool, shape (n,)
        Nowhere without an angle, or where chance puts spikes as close together more than once in a million times.

    Notes
    -----
    Rayleigh's test [1]_ of one mean a stroke, as the spikes of one burst of interference share their angle.

    References
    ----------
    .. [1] Mardia and Jupp, Directional Statistics, Wiley, 2000, section 6.3.1.
    """
    is_impact = np.zeros(len(is_spike), dtype=bool)
    if angle is None or not is_spike.any():
        return is_impact
    speed = np.interp(time_s[is_spike], angle.time_s, angle.speed_rad_s)
    moving = np.flatnonzero(is_spike)[speed > _MOVING_SHARE * float(angle.speed_rad_s.max())]
    angles = np.interp(time_s[moving], angle.time_s, angle.angle_rad)
    _, stroke = np.unique(np.floor(angles / (2.0 * np.pi)), return_inverse=True)
    for times in _TIMES_A_STROKE:
        turned = np.exp(1j * times * angles)
        of_strokes = (np.bincount(stroke, turned.real) + 1j * np.bincount(stroke, turned.imag)) / np.bincount(stroke)
        together = abs(np.mean(of_strokes)) if len(of_strokes) else 0.0
        if np.exp(-len(of_strokes) * together**2) < _BY_CHANCE:
            off_rad = np.abs(np.angle(turned / np.mean(turned)))
            is_impact[moving[off_rad <= _SPREADS * np.median(off_rad)]] = True
            break
    return is_impact
