"""A course of the hardness that all trials share from their start on: no wood has one.

Pieces of wood differ, and along the cut each varies in its own way. Where the hardness of every trial rises or falls by
the same share over the first seconds, it is the tool or the bench that changes: chips that fill the gullets, a blade
that heats up, a feed that settles. No effect of the catalogue does that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.stroke_series import StrokeSeries
from sawbench.diagnosis.log_mean import log_mean_exp

# Time constants of the course, s: beyond some strokes, and short enough to bend within a trial.
_TIME_CONSTANTS_S = np.geomspace(0.3, 6.0, 8)
# Variance between trials, in units of the one found.
_VARIANCES = np.geomspace(1e-2, 1e3, 101)
_LEAST_TRIALS = 3


def shared_course(trials: Sequence[StrokeSeries]) -> float:
    """Weigh a course of the hardness that levels off at one time constant and is the same in all trials.

    Parameters
    ----------
    trials : sequence of StrokeSeries

    Returns
    -------
    float
        Log evidence against courses that each trial has for itself, of any size; no more than 0 where the shared one
        changes the hardness by no more than pieces of wood differ, and 0 for fewer than three trials.

    Notes
    -----
    Each trial gives one number for a time constant: how far its hardness follows the course, beside a mean and a trend
    of its own. How much these numbers scatter from trial to trial is the noise, whatever spectrum a wood has.
    """
    if len(trials) < _LEAST_TRIALS:
        return 0.0
    longest_s = max(float(trial.time_s[-1]) for trial in trials)
    found = [_weighed(trials, float(time_s), longest_s) for time_s in _TIME_CONSTANTS_S]
    log = log_mean_exp([evidence for evidence, _ in found])
    _, reach = max(found)
    return log if abs(reach) > np.sqrt(2.0) * SETTINGS.workpieces.piece_std else min(log, 0.0)


def _weighed(trials: Sequence[StrokeSeries], time_constant_s: float, longest_s: float) -> tuple[float, float]:
    """Log evidence of a course with this time constant; how far it takes the log hardness in the longest trial."""
    sizes, weights = (np.array(of) for of in zip(*(_follows(t, time_constant_s) for t in trials), strict=True))
    n, total = len(sizes), float(weights.sum())
    mean = float(weights @ sizes) / total
    around = float(weights @ (sizes - mean) ** 2)
    variance = max(around / (n - 1), 1e-12) * _VARIANCES
    reached = 1.0 - float(np.exp(-longest_s / time_constant_s))
    prior = (SETTINGS.strokes.course_std / reached) ** 2
    # The variance is as unknown as its logarithm is, with a course and without.
    scatter = -0.5 * n * np.log(variance) - 0.5 * around / variance
    of_mean, none = variance / total + prior, variance / total
    shared = scatter + 0.5 * np.log(none / of_mean) - 0.5 * mean**2 / of_mean
    own = scatter - 0.5 * mean**2 / none
    return log_mean_exp(shared.tolist()) - log_mean_exp(own.tolist()), mean * reached


def _follows(trial: StrokeSeries, time_constant_s: float) -> tuple[float, float]:
    """Regression of one trial's log hardness on the course, beside mean and trend, and its weight."""
    course = 1.0 - np.exp(-trial.time_s / time_constant_s)
    basis, _ = np.linalg.qr(np.column_stack([np.ones_like(trial.time_s), trial.time_s]))
    course -= basis @ (basis.T @ course)
    weight = float(course @ course)
    return float(course @ trial.log_k) / weight, weight
