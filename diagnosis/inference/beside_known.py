"""What effects that stand in the model already cost any further one.

No form is exact, and what the form of a strong effect misses grows with it. Within one weighing a second effect pays
for that (`weighing.odds_of_further`). Beside a known effect the same holds, though its evidence is taken off the data
already.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.forming import shared_energy
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.left_over import left_over
from sawbench.diagnosis.inference.linear_problem import FORM_OF_KNOWN, LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal


class BesideKnown:
    """The price of a further effect, and the gap that the known ones have closed.

    Parameters
    ----------
    problem : LinearProblem
        Whitened with dispersion.
    dispersion : ndarray, shape (n,)
    small : ndarray, shape (n, q)
        Columns of the background effects.
    """

    def __init__(self, problem: LinearProblem, dispersion: Floats, small: Floats) -> None:
        self._problem = problem
        # The nuisances of known effects take up these themselves.
        of_known = (FORM_OF_KNOWN, *(one.name for one in problem.campaign.plant.known))
        bare = problem.only(lambda name: not name.startswith(of_known))
        nominal = Marginal(bare, extra=small)
        self._rest = nominal.rest(problem.data)
        whole = problem.data + problem.known
        gained = float(whole @ nominal.rest(whole) - problem.data @ self._rest)
        self._alone = 0.5 * max(gained, 0.0)
        self.gap = left_over(replace(bare, data=whole), dispersion, nominal)

    def paid(self, hypothesis: Hypothesis) -> Hypothesis:
        """Take off the log evidence that it has in mean strokes the scatter that the known effects' has where it acts.

        "Unknown" acts where the rest is. What single strokes add no form misses.
        """
        if hypothesis.other in ("no_gap", "parameters"):
            return hypothesis
        acts = [member.contribution for member in hypothesis.members] or [self._rest]
        shared = shared_energy(self._problem, self._problem.known, np.sum(acts, axis=0))
        price = min(float(np.sqrt(shared * self._alone)), max(hypothesis.of_means, 0.0))
        return replace(hypothesis, log_evidence=hypothesis.log_evidence - price)
