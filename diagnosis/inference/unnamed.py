"""Evidence for a cause outside the catalogue: forms beyond it, a gap of no form, what is off the stroke."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.asynchronous import Finding
from sawbench.diagnosis.inference.columns import Column
from sawbench.diagnosis.inference.discrepancy import discrepancy
from sawbench.diagnosis.inference.evidence import explain
from sawbench.diagnosis.inference.forming import Forming
from sawbench.diagnosis.inference.left_over import left_over, log_density_of_left
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.weighing import gained_by_none, worth_of_a_choice


def beyond_catalogue(
    forming: Forming, nominal: Marginal, columns: Mapping[str, Sequence[Column]], listed: Mapping[str, float]
) -> dict[str, float]:
    """Log evidence of each cause that has a form but no place in the catalogue, all equally likely beforehand.

    Of a form that a listed effect is the limit of, what it adds to that is a further thing about it. Where it adds less
    than a further effect must, nobody can tell, and the listed effect is the answer: a form misses a share of what it
    is to explain, and that share of the amplitude, squared, is the share of the evidence that another one may add.

    What a law leaves of the gap by itself says as much against it as it would against a listed effect: what its form
    may miss takes up the most of a gap, where that is strong.

    Parameters
    ----------
    forming : Forming
    nominal : Marginal
    columns : mapping of str to sequence of Column
    listed : mapping of str to float
        Log evidence of the effects of the catalogue, each alone.
    """
    problem = forming.problem
    worth = worth_of_a_choice(len(problem.campaign.plant.effects))
    missed = problem.settings.forms.screen_share**2
    gap = left_over(problem, forming.dispersion, nominal) - problem.quiet

    def weighed(entries: Sequence[Column]) -> float | None:
        rough = explain(nominal, entries)
        if rough is None:
            return None
        is_worth_it = rough.log_evidence >= problem.settings.forms.worth_forming
        found = (forming.single(rough, entries).explanation if is_worth_it else rough).log_evidence
        limits = [listed[other] for other in rough.effect.confused_with if other in listed]
        if limits and found <= max(limits) + worth + missed * max(*limits, 0.0):
            return None
        left = left_over(problem, forming.dispersion, nominal, rough) - problem.quiet
        of_right = log_density_of_left(max(left, 0.0) / gap) - log_density_of_left(0.0) if gap > 0.0 else 0.0
        return found - float(np.log(len(columns))) + of_right

    found = zip(columns, on_two_cores(weighed, list(columns.values())), strict=True)
    return {name: log_evidence for name, log_evidence in found if log_evidence is not None}


def unnamed(
    forming: Forming, beyond: Mapping[str, float], strokes: Mapping[str, float], beside: Finding | None
) -> dict[str, float]:
    """Log evidence of whatever is not in the catalogue, by what it looks like; "" for a gap of no particular form.

    Parameters
    ----------
    forming : Forming
    beyond : mapping of str to float
        Of `beyond_catalogue`.
    strokes : mapping of str to float
        What single strokes show that is not the wood's; see `strokes_say`.
    beside : Finding or None
        What does not follow the stroke.
    """
    problem = forming.problem
    of_means = {"": discrepancy(problem, forming.nominal) - forming.nominal.log_evidence, **beyond}
    weights = problem.settings.weights
    found = {text: value - gained_by_none(value, weights) for text, value in of_means.items()} | dict(strokes)
    if beside is not None:
        found[beside.text] = beside.log_evidence
    return found
