"""The share of a withheld gap that a cause closes, with its interval."""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.spread import jackknife_std
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.standard_error import std_of_sum

_NUMBERS = SETTINGS.ladder


def closed_share(energy: dict[str, Floats]) -> tuple[float, tuple[float, float]]:
    """Share of the gap that is closed, and its 95 % interval, from sums of squares by withheld trial.

    The interval is Student's t on the square root of what is left, its standard error from leaving out one trial at a
    time: what repetitions of these trials would say. A root mean square scatters alike however little is left, where
    the logarithm of nearly nothing scatters without bound; what noise takes below nothing keeps its sign
    (docs/decisions/0006-channel-prediction.md). Where the trials' gains are surely positive together, so is the share:
    it is no less than the least gain of the largest room. That holds where the noise is stated so large that there
    seems to be no room, too: what is surely gained was there to be closed.

    Parameters
    ----------
    energy : dict of str to ndarray, shape (n_trials,)
        "retuned", "with_effect" and "noise_floor".

    Returns
    -------
    closed : float
    interval : tuple of float

    Examples
    --------
    >>> rest = np.array([10.0, 12.0, 9.0, 11.0])
    >>> energy = {"retuned": rest, "with_effect": np.array([2.0, 2.2, 1.7, 2.1]), "noise_floor": np.ones(4)}
    >>> closed, (low, high) = closed_share(energy)
    >>> bool(0.8 < low < closed < high < 1.0)
    True
    """
    from scipy.special import stdtrit

    def root_of_left(chosen: np.ndarray) -> float:
        retuned, effect, floor = (float(energy[k][chosen].sum()) for k in ("retuned", "with_effect", "noise_floor"))
        room = retuned - floor
        if room <= _NUMBERS.least_rest * floor:
            return 1.0
        left = (effect - floor) / room
        return float(np.sign(left) * np.sqrt(abs(left)))

    n = len(energy["retuned"])
    everything = np.arange(n)
    gained, room = (energy["retuned"] - energy[k] for k in ("with_effect", "noise_floor"))
    has_room = room.sum() > _NUMBERS.least_rest * energy["noise_floor"].sum()
    if n < _NUMBERS.least_groups:
        return (_closed(root_of_left(everything)) if has_room else 0.0), (-1.0, 1.0)
    times = float(stdtrit(n - 1, 0.975))
    error = times * std_of_sum(gained)
    least = gained.sum() - error
    if not has_room:
        # No less than all that may have been gained was there.
        share = float(least / (least + 2.0 * error)) if least > _NUMBERS.by_chance else 0.0
        return (1.0, (share, 1.0)) if share > 0.0 else (0.0, (-1.0, 1.0))
    whole = root_of_left(everything)
    without_one = np.array([root_of_left(np.delete(everything, k)) for k in everything])
    reach = float(stdtrit(n - 2, 0.975)) * float(jackknife_std(without_one))
    low, high = _closed(whole + reach), _closed(whole - reach)
    most = room.sum() + times * std_of_sum(room)
    closed = _closed(whole)
    return closed, (max(low, min(float(least / most), closed)) if least > 0.0 else low, high)


def _closed(root_of_left: float) -> float:
    """Share that is closed, -1 to 1, by the root of what is left, which has its sign."""
    return float(np.clip(1.0 - root_of_left * abs(root_of_left), -1.0, 1.0))
