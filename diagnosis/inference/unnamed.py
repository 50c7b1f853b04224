"""Evidence for a cause outside the catalogue: forms beyond it, a gap of no form, what is off the stroke."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from sawbench.diagnosis.inference.discrepancy import discrepancy
from sawbench.diagnosis.inference.evidence import Column, explain
from sawbench.diagnosis.inference.forming import Forming
from sawbench.diagnosis.inference.linear_problem import Marginal
from sawbench.diagnosis.inference.off_stroke import Finding


def beyond_catalogue(forming: Forming, nominal: Marginal, columns: Mapping[str, Sequence[Column]]) -> dict[str, float]:
    """Log evidence of each cause that has a form but no place in the catalogue, all equally likely beforehand.

    Parameters
    ----------
    forming : Forming
    nominal : Marginal
    columns : mapping of str to sequence of Column
    """
    found = {}
    for name, entries in columns.items():
        rough = explain(nominal, entries)
        if rough is not None:
            formed, _ = forming.single(rough, entries)
            found[name] = formed.log_evidence - float(np.log(len(columns)))
    return found


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
    found = {"": discrepancy(problem, forming.small) - forming.reference, **beyond, **strokes}
    if beside is not None:
        found[beside.text] = beside.log_evidence
    return found
