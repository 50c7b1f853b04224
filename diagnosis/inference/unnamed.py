"""Evidence for a cause outside the catalogue: forms beyond it, a gap of no form, what is off the stroke."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.acts_in import acts_in
from sawbench.diagnosis.inference.discrepancy import discrepancy
from sawbench.diagnosis.inference.evidence import Column, Explanation, explain, known_parts
from sawbench.diagnosis.inference.forming import Forming
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.linear_problem import Marginal
from sawbench.diagnosis.inference.off_stroke import Finding
from sawbench.diagnosis.inference.weighing import worth_of_a_choice
from sawbench.modeling.residuals import Equation


def beyond_catalogue(
    forming: Forming, nominal: Marginal, columns: Mapping[str, Sequence[Column]], listed: Mapping[str, float]
) -> dict[str, Explanation]:
    """What each cause explains that has a form but no place in the catalogue, all equally likely beforehand.

    Of a form that a listed effect is the limit of, what it adds to that is a further thing about it. Where it adds less
    than a further effect must, nobody can tell, and the listed effect is the answer.

    Parameters
    ----------
    forming : Forming
    nominal : Marginal
    columns : mapping of str to sequence of Column
    listed : mapping of str to float
        Log evidence of the effects of the catalogue, each alone.
    """
    worth = worth_of_a_choice(len(forming.problem.campaign.plant.effects))

    def weighed(entries: Sequence[Column]) -> Explanation | None:
        rough = explain(nominal, entries)
        if rough is None:
            return None
        is_worth_it = rough.log_evidence >= forming.problem.settings.forms.worth_forming
        found = forming.single(rough, entries)[0] if is_worth_it else rough
        limits = [listed[other] for other in rough.effect.confused_with if other in listed]
        if limits and found.log_evidence <= max(limits) + worth:
            return None
        return replace(found, log_evidence=found.log_evidence - float(np.log(len(columns))))

    weighed_all = on_two_cores(weighed, list(columns.values()), known=known_parts(columns))
    return {name: found for name, found in zip(columns, weighed_all, strict=True) if found is not None}


@dataclass(frozen=True, kw_only=True, slots=True)
class Unnamed:
    """Whatever is not in the catalogue.

    Attributes
    ----------
    hypothesis : Hypothesis
        With the evidence of its best look; what mean strokes do not know of it is `of_strokes`.
    resembles : str
        What it looks like; empty for a gap of no particular form, and where there is no evidence.
    equations : tuple of Equation
        Where it acts, of a look that has a form; empty for any other.
    """

    hypothesis: Hypothesis
    resembles: str
    equations: tuple[Equation, ...]


def unnamed(
    forming: Forming, beyond: Mapping[str, Explanation], strokes: Mapping[str, float], beside: Finding | None
) -> Unnamed:
    """Weigh whatever is not in the catalogue by the look of it that has most evidence.

    Parameters
    ----------
    forming : Forming
    beyond : mapping of str to Explanation
        Of `beyond_catalogue`.
    strokes : mapping of str to float
        What single strokes show that is not the wood's; see `strokes_say`.
    beside : Finding or None
        What does not follow the stroke.
    """
    in_means = {"": discrepancy(forming.problem, forming.small) - forming.reference}
    in_means |= {name: explanation.log_evidence for name, explanation in beyond.items()}
    in_strokes = dict(strokes) if beside is None else {**strokes, beside.text: beside.log_evidence}
    looks = in_means | in_strokes
    resembles = max(looks, key=lambda text: looks[text])
    most, of_strokes = looks[resembles], max(in_strokes.values(), default=0.0)
    unknown = Hypothesis(other="unknown", log_evidence=most, of_strokes=float(np.clip(of_strokes, 0.0, max(most, 0.0))))
    return Unnamed(
        hypothesis=unknown,
        resembles=resembles if most > 0.0 else "",
        equations=tuple(acts_in(forming.problem, beyond[resembles])) if resembles in beyond else (),
    )
