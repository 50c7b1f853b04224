"""How far the gains of amplifiers drift over a session, as the campaign itself says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.nuisances import DRIFTING, still_to_warm_up, warm_up_of


@dataclass(frozen=True, kw_only=True, slots=True)
class GainDrift:
    """Relative change of a gain from the beginning of a session to its end, with its standard uncertainty."""

    change: float
    std: float


def gain_drifts(problem: LinearProblem, marginal: Marginal) -> Mapping[str, GainDrift]:
    """Estimate the drift of every gain that may have one, together with all other nuisances.

    Parameters
    ----------
    problem : LinearProblem
    marginal : Marginal
        Of all nuisances, beside effects that may explain the same.

    Returns
    -------
    dict of str to GainDrift
        By the name of the gain; empty where the plant has none.
    """
    place = {name: k for k, name in enumerate(problem.names)}
    times_s = [s.setting.session_s + s.time_s.ravel()[[0, -1]] for s in problem.campaign.states]
    begins_s, ends_s = np.min(times_s), np.max(times_s)
    model, found = problem.campaign.plant.model, {}
    for gain in DRIFTING:
        change = np.zeros(len(problem.names))
        for time_s in problem.settings.sensors.drift_times_s:
            k = place.get(warm_up_of(gain, time_s))
            if k is not None:
                begin, end = still_to_warm_up(model, np.array([begins_s, ends_s]), time_s)
                change[k] = problem.prior_std[k] * (end - begin)
        if change.any():
            total, std = marginal.weighted_sum(change)
            found[gain] = GainDrift(change=total, std=std)
    return found
