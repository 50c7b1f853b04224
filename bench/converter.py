"""What the sensor, its amplifier and its converter do to a signal: the levels that cut it off, and its step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.recording import Floats
from sawbench.bench.runs import run_ends

# With fewer, a level at the end says nothing.
_LEAST_LEVELS = 16
_ROUNDED = 1e-9
# A signal that is cut off comes to lie on the limit several times, each time for some samples.
_FLAT = 4
_VISITS = 3
# The level of a smooth turning point has about as many samples as the next three steps below it: the time within a
# distance d of the top of a parabola grows as the square root of d. Half of that is no turning point.
_STEPS_BESIDE = 3.0
_BESIDE_A_TURNING_POINT = 0.5
_ERROR_HARMONICS = 20
# Of levels that are held by chance three steps are whole multiples of the smallest one in one of 1e5 cases.
_LEAST_STEPS, _MULTIPLE, _NEARLY_ALL = 4, 0.01, 0.95


def clipped_levels(values: Floats) -> dict[float, int]:
    """Levels at which a signal is cut off, with the number of samples at each.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Without spikes.

    Returns
    -------
    dict of float to int
        Empty where nothing is cut off. The ends of the signal are looked at: one is a limit where the signal comes to
        it at least three times and lies fewer samples on the steps of the converter beside it than a turning point
        does. A level at which the signal rests once, or for most of the time, is no limit, nor is exactly 0.

    Examples
    --------
    >>> wave = np.sin(np.arange(0, 60, 0.05))
    >>> clipped_levels(np.clip(wave, -2.0, 0.7)).keys(), clipped_levels(np.round(wave, 1))
    (dict_keys([0.7]), {})
    """
    if len(values) < _LEAST_LEVELS:
        return {}
    ends = {float(values.min()), float(values.max())} - {0.0}
    at_ends = {end: values == end for end in ends}
    at_ends = {end: at for end, at in at_ends.items() if _VISITS * _FLAT <= np.count_nonzero(at) <= len(values) // 2}
    if not at_ends or len(levels := np.unique(values)) < _LEAST_LEVELS:
        return {}
    # A table that interpolates between the codes of a slow converter holds them at its turning points only.
    between = step_of(values[(values > levels[0]) & (values < levels[-1])])
    near = _STEPS_BESIDE * max(between, float(np.diff(levels).min())) * (1.0 + 1e-6)
    found: dict[float, int] = {}
    for end, is_at_end in at_ends.items():
        at, around = _visits(np.abs(values - end) <= near, is_at_end)
        if len(at) >= _VISITS and np.median(around - at) < _BESIDE_A_TURNING_POINT * np.median(at):
            found[end] = int(at.sum())
    return found


def _visits(is_near: NDArray[np.bool_], is_at_end: NDArray[np.bool_]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Samples at the end, and samples near it, of every stretch near it that holds a flat part of the end."""
    first, end = run_ends(is_near)
    counts = np.r_[0, np.cumsum(is_at_end)]
    at = counts[end] - counts[first]
    return at[at >= _FLAT], (end - first)[at >= _FLAT]


def step_of(values: Floats) -> float:
    """Step of the converter: the smallest one between levels that are held for more than one sample.

    Two equal samples in a row also come by chance where the steps are fine: what is found must make up all the levels
    that are held, or all values.

    Parameters
    ----------
    values : ndarray, shape (n,)

    Returns
    -------
    float
        In the unit of the values; 0 where fewer than two levels are held.

    Examples
    --------
    >>> step_of(np.round(np.sin(np.arange(0, 60, 0.01)) / 0.25) * 0.25), step_of(np.sin(np.arange(0, 60, 0.01)))
    (0.25, 0.0)
    """
    held = np.unique(values[1:][np.diff(values) == 0.0])
    steps = np.diff(held)
    # Levels that a calibration rounds differently are one level.
    steps = steps[steps > _ROUNDED * float(np.ptp(held))] if len(steps) else steps
    step = float(steps.min()) if len(steps) else 0.0
    return step if step and (_are_multiples(steps, step) or _is_all(values, step)) else 0.0


def _are_multiples(steps: Floats, step: float) -> bool:
    whole = np.abs(steps / step - np.round(steps / step)) < _MULTIPLE
    return len(steps) >= _LEAST_STEPS and bool(np.mean(whole) > _NEARLY_ALL)


def _is_all(values: Floats, step: float) -> bool:
    """Whether there are no more values than steps of that size allow; a calibration may round each in two ways."""
    return len(np.unique(values)) <= 2 * (float(np.ptp(values)) / step + 1.0)


def rounding_variance(step: float, std: Floats | float) -> Floats:
    """Mean square error of a mean of values that are rounded to steps and scatter.

    Parameters
    ----------
    step : float
        q, above 0.
    std : float or ndarray
        Standard deviation s of the scatter, in the same unit.

    Returns
    -------
    ndarray, shape of `std`
        q^2 / 12 without scatter. The k-th harmonic of the error, q / (sqrt(2) pi k), falls with exp(-2 (pi k s / q)^2)
        (Widrow and Kollar, Quantization Noise, 2008, ch. 4).

    Examples
    --------
    >>> rounding_variance(1.0, np.array([0.0, 0.3, 1.0])).round(4).tolist()
    [0.0809, 0.0015, 0.0]
    """
    k = np.arange(1.0, _ERROR_HARMONICS + 1)
    left = np.exp(-((2.0 * np.pi * k * np.asarray(std)[..., None] / step) ** 2)) / k**2
    return step**2 / (2.0 * np.pi**2) * left.sum(axis=-1)
