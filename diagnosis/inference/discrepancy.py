"""A smooth gap that no effect of the catalogue has to explain: the free rival of all of them."""

from __future__ import annotations

import numpy as np
from sawbench.diagnosis.inference.form_error import block_weights
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal, Widened
from sawbench.diagnosis.log_mean import log_mean_exp

# Of the whitened features, in standard deviations of the noise.
_SIZES = (3.0, 10.0, 30.0, 100.0, 300.0)
_N_HARMONICS = 6


def discrepancy(problem: LinearProblem, nominal: Marginal) -> float:
    """Log evidence of a gap of no particular form: harmonics times {1, speed, load, session, feed, time}.

    Parameters
    ----------
    problem : LinearProblem
    nominal : Marginal
        Nuisances and background effects.

    Returns
    -------
    float
        Absolute: of the data, averaged over the size of the gap.
    """
    columns = []
    varied = block_weights(problem)
    loaded = [1.0 - idle for idle in varied["idle"]]
    factors = [varied["one"], varied["speed"], loaded, varied["session"], varied["feed"], varied["within"]]
    for equation, form in problem.campaign.plant.equations.items():
        n_harmonics = form.n_harmonics
        for k in range(2 * min(_N_HARMONICS, n_harmonics) + 1):
            index = 0 if k == 0 else (k + 1) // 2 if k % 2 else n_harmonics + k // 2
            for factor in factors:
                column = np.zeros(len(problem.data))
                for part, weight in zip(problem.parts, factor, strict=True):
                    if part.state.kind != "running" or equation not in part.layout.equations or not weight.any():
                        continue
                    # One harmonic of one block is one column of the whitener, the same for all blocks.
                    whitened = part.whitener[:, part.layout.slices[equation].start + index]
                    column[part.place] = np.outer(weight, whitened).ravel()
                norm = float(np.linalg.norm(column))
                if norm > 0:
                    columns.append(column / norm)
    widened = Widened(nominal, np.array(columns).T)
    return log_mean_exp([widened.at(size)[0] for size in _SIZES])
