"""How much of its evidence an effect owes to the equations in which it acts.

Nuisances are free, background effects among them. Set against each other they may cancel a signature in
its own equations and leave something in another one: an eccentric gear, less a bend of the displacement sensor and a
wave of the yoke, is nearly a change of the cutting force alone. Where only that is found, no gear is.
"""

from __future__ import annotations

from dataclasses import replace

from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Marginal
from sawbench.modeling.residuals import Equation


def with_credit(problem: LinearProblem, marginal: Marginal, explanation: Explanation) -> Explanation:
    """Limit the log evidence of an effect to twice what it gains where it acts, and at the nuisances.

    Parameters
    ----------
    problem : LinearProblem
    marginal : Marginal
        All rows; the explanation was found beside its nuisances.
    explanation : Explanation

    Returns
    -------
    Explanation
        What the effect explains elsewhere, by setting nuisances free, cannot weigh more than what it explains itself.
    """
    if explanation.log_evidence <= 0.0:
        return explanation
    before, rest = marginal.data_split
    taken, moved = marginal.split(explanation.contribution)
    after, left = before - taken, rest - moved
    gained = problem.sums_by_equation(rest**2 - left**2)
    own = sum(gained[equation] for equation in acts_in(problem, explanation))
    limit = max(own + float(before @ before - after @ after), 0.0)
    return replace(explanation, log_evidence=min(explanation.log_evidence, limit))


def acts_in(problem: LinearProblem, explanation: Explanation) -> list[Equation]:
    """Equations that hold more of an effect's contribution than filters and tracking mix into others."""
    energy = problem.sums_by_equation(explanation.contribution**2)
    least = problem.settings.weights.acts_share * sum(energy.values())
    return [equation for equation, share in energy.items() if share > least]
