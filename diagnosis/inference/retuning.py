"""Evidence for "parameters": some of the plant's numbers are off by more than they are stated to be.

How many, and which, is not known: each further number is half as likely, and all sets of as many are alike. Widening
every number at once would pay for each of a dozen what one that is wrong gains: 13 nats on a well measured bench, so
that a resistance four standard deviations off was no finding.
"""

from __future__ import annotations

from itertools import combinations
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Marginal

# Sets of up to so many are weighed one by one; what more would say, that of all at once does.
_MOST_SINGLED_OUT: Final = 3


def evidence_of_retuning(problem: LinearProblem, nominal: Marginal, all_at_once: float) -> float:
    """Log Bayes factor of wrong numbers of the plant against the stated ones.

    Parameters
    ----------
    problem : LinearProblem
    nominal : Marginal
        With the numbers within their stated uncertainty, and all that else may be there.
    all_at_once : float
        The same factor where every number is widened.

    Returns
    -------
    float
    """
    is_wide = problem.wide_scale > 1.0
    # What widening adds to a prior variance of one.
    added = problem.wide_scale[is_wide] ** 2 - 1.0
    own, moment = nominal.gram(problem.nuisance[:, is_wide] * np.sqrt(added))
    most = min(_MOST_SINGLED_OUT, len(added))
    by_number = [_mean_evidence(own, moment, size) - size * np.log(2.0) for size in range(1, most + 1)]
    return float(np.logaddexp.reduce([*by_number, all_at_once - most * np.log(2.0)]))


def _mean_evidence(own: Floats, moment: Floats, size: int) -> float:
    """Log of the mean Bayes factor over all sets of `size` columns of unit prior."""
    sets = np.array(list(combinations(range(len(moment)), size)))
    inner = np.eye(size) + own[sets[:, :, None], sets[:, None, :]]
    seen = moment[sets]
    gain = np.einsum("ij,ij->i", seen, np.linalg.solve(inner, seen[:, :, None])[:, :, 0])
    found = 0.5 * (gain - np.linalg.slogdet(inner)[1])
    return float(np.logaddexp.reduce(found) - np.log(len(sets)))
