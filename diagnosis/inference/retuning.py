"""Evidence for "parameters": some of the plant's numbers are off by more than they are stated to be.

How many, and which, is not known: each further number is half as likely, and all sets of as many are alike. Widening
every number at once would pay for each of a dozen what one that is wrong gains: 13 nats on a well measured bench, so
that a resistance four standard deviations off was no finding.

A number that is an effect of the catalogue where it has grown is a wrong number where it is less than stated.
"""

from __future__ import annotations

from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Sets of up to so many are weighed one by one; what more would say, that of all at once does.
_MOST_SINGLED_OUT: Final = 3


class Retuning:
    """Which of the plant's numbers are off by more than they are stated to be.

    Parameters
    ----------
    problem : LinearProblem
    nominal : Marginal
        With the numbers within their stated uncertainty, and all that else may be there.
    """

    def __init__(self, problem: LinearProblem, nominal: Marginal) -> None:
        self._nominal = nominal
        scale = np.maximum(problem.wide_scale, problem.wide_if_less)
        wide = np.flatnonzero(scale > 1.0)
        # Of what widening adds to each number, of unit prior: inner products, and with the data.
        added = problem.nuisance[:, wide] * np.sqrt(scale[wide] ** 2 - 1.0)
        own, moment = nominal.gram(added)
        kept = (problem.wide_scale[wide] > 1.0) | (moment < 0.0)
        self._own, self._moment, self._added = own[np.ix_(kept, kept)], moment[kept], added[:, kept]
        self._names = [problem.names[k] for k in wide[kept]]

    @cached_property
    def wide(self) -> Marginal:
        """`nominal` with every number widened."""
        return self._nominal.beside(self._added)

    @property
    def log_evidence(self) -> float:
        """Log Bayes factor of wrong numbers against the stated ones."""
        most = min(_MOST_SINGLED_OUT, len(self._names))
        by_number = [self._mean_evidence(size) - size * np.log(2.0) for size in range(1, most + 1)]
        all_at_once = self.wide.log_evidence - self._nominal.log_evidence
        return float(np.logaddexp.reduce([*by_number, all_at_once - most * np.log(2.0)]))

    @property
    def freed(self) -> tuple[str, ...]:
        """Names of the numbers whose widening pays: a fit may move them beyond what is stated of them.

        One number after the other, each the one that makes the data likeliest, until none gains what a further one
        costs. A number that the campaign does not tell, as the capacity of a battery that is hardly used, keeps its
        stated uncertainty: free, it would follow whatever the model misses, and mislead all that is predicted beyond.
        """
        chosen: list[int] = []
        reached = 0.0
        while len(chosen) < len(self._names):
            rest = [k for k in range(len(self._names)) if k not in chosen]
            sets = np.array([[*chosen, k] for k in rest])
            found = self._evidence(sets) - sets.shape[1] * np.log(2.0)
            if found.max() <= reached:
                break
            reached = float(found.max())
            chosen.append(rest[int(np.argmax(found))])
        return tuple(self._names[k] for k in chosen)

    def _mean_evidence(self, size: int) -> float:
        """Log of the mean Bayes factor over all sets of so many numbers."""
        sets = np.array(list(combinations(range(len(self._names)), size)))
        return float(np.logaddexp.reduce(self._evidence(sets)) - np.log(len(sets)))

    def _evidence(self, sets: NDArray[np.int_]) -> Floats:
        """Log Bayes factor of each set of numbers, shape (n_sets,); `sets`: (n_sets, size)."""
        size = sets.shape[1]
        inner = np.eye(size) + self._own[sets[:, :, None], sets[:, None, :]]
        seen = self._moment[sets]
        gain = np.einsum("ij,ij->i", seen, np.linalg.solve(inner, seen[:, :, None])[:, :, 0])
        return 0.5 * (gain - np.linalg.slogdet(inner)[1])
