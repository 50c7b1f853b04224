"""How far the gains of amplifiers drift over a session, as the campaign itself says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.nuisances import WARM_UP


@dataclass(frozen=True, kw_only=True, slots=True)
class GainDrift:
    """Relative change of a gain from the beginning of a session to its end, with its standard uncertainty."""

    change: float
    std: float


def gain_drifts(problem: LinearProblem, beside: Floats) -> Mapping[str, GainDrift]:
    """Estimate the drift of every gain that may have one, together with all other nuisances.

    Parameters
    ----------
    problem : LinearProblem
    beside : ndarray, shape (n, q)
        Whitened columns of effects that may explain the same, times their prior standard deviation.

    Returns
    -------
    dict of str to GainDrift
        By the name of the gain; empty where the plant has none.
    """
    gains = {k: name.split(WARM_UP)[0] for k, name in enumerate(problem.names) if WARM_UP in name}
    if not gains:
        return {}
    design = np.hstack([problem.nuisance, beside])
    covariance = np.linalg.inv(np.eye(design.shape[1]) + design.T @ design)
    mean = covariance @ (design.T @ problem.data)
    times_s = [s.setting.session_s + s.time_s.ravel()[[0, -1]] for s in problem.campaign.states]
    begins_s, ends_s = np.min(times_s), np.max(times_s)
    found = {}
    for gain in dict.fromkeys(gains.values()):
        change = np.zeros(len(mean))
        for k, name in gains.items():
            if name == gain:
                time_s = float(problem.names[k].split(WARM_UP)[1].removesuffix(" s"))
                change[k] = problem.prior_std[k] * (np.exp(-ends_s / time_s) - np.exp(-begins_s / time_s))
        found[gain] = GainDrift(change=float(change @ mean), std=float(np.sqrt(change @ covariance @ change)))
    return found
