"""In which equations an effect acts."""

from __future__ import annotations

from collections.abc import Sequence

from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.modeling.residuals import Equation


def acts_in(problem: LinearProblem, explanation: Explanation) -> list[Equation]:
    """Equations that hold more of an effect's contribution than filters and tracking mix into others."""
    energy = problem.sums_by_equation(explanation.contribution**2)
    least = problem.settings.weights.acts_share * sum(energy.values())
    return [equation for equation, share in energy.items() if share > least]


def equations_of(problem: LinearProblem, members: Sequence[Explanation]) -> list[Equation]:
    """Equations in which at least one of some effects acts."""
    return list(dict.fromkeys(equation for member in members for equation in acts_in(problem, member)))
