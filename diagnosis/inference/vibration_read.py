"""How much of the machine's vibration the load cell reads, as the campaign itself says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.vibration import PHASES, POWERS, inertia_n, name_of, usual_rad_s


@dataclass(frozen=True, kw_only=True, slots=True)
class Vibration:
    """Amplitude of the wave that the load cell reads at the usual speed, with its standard uncertainty, N."""

    amplitude_n: float
    std_n: float


def vibration_of(problem: LinearProblem, marginal: Marginal) -> Vibration | None:
    """Estimate what the load cell reads of the machine's vibration, together with all other nuisances.

    Parameters
    ----------
    problem : LinearProblem
    marginal : Marginal
        Of all nuisances, beside effects that may explain the same.

    Returns
    -------
    Vibration or None
        None where no force was measured.
    """
    place = {name: k for k, name in enumerate(problem.names)}
    parts = [[place.get(name_of(phase, of_bench)) for of_bench in POWERS] for phase in PHASES]
    if all(k is None for part in parts for k in part):
        return None
    baseline = problem.campaign.plant.model
    unit_n = float(inertia_n(baseline, np.array(usual_rad_s(baseline))))
    found = []
    for part in parts:
        weights = np.zeros(len(problem.names))
        for k in part:
            if k is not None:
                weights[k] = unit_n * problem.prior_std[k]
        found.append(marginal.weighted_sum(weights))
    (along, along_std), (late, late_std) = found
    return Vibration(amplitude_n=float(np.hypot(along, late)), std_n=max(along_std, late_std))
