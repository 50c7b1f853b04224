"""Forms between those of the catalogue, for the effects that explain most.

The catalogue holds time constants a fourth apart. Where an effect stands hundreds of times above the noise, what the
nearest form leaves is larger than another effect, which would then be claimed beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.evidence import (
    Catalogue,
    Column,
    Explanation,
    catalogue_columns,
    columns_in,
    explain,
)
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Marginal

_N_STEPS: Final = 4
_DIFFERENCE: Final = 1e-3


def effect_columns(problem: LinearProblem) -> dict[str, list[Column]]:
    """Signatures of every effect of the plant, in the forms of the catalogue and between them: what `judge` weighs.

    Parameters
    ----------
    problem : LinearProblem

    Returns
    -------
    dict of str to list of Column
        By effect; an empty list where the campaign shows nothing of it.
    """
    return refined(problem, catalogue_columns(problem, problem.campaign.plant.effects))


def refined(problem: LinearProblem, columns: Mapping[str, Sequence[Column]]) -> dict[str, list[Column]]:
    """Add to the effects that explain most the form between those of the catalogue that explains more.

    Parameters
    ----------
    problem : LinearProblem
    columns : mapping of str to sequence of Column
        Of `catalogue_columns`.

    Returns
    -------
    dict of str to list of Column
        As given; one column more where a better form was found.
    """
    forms, marginal = problem.settings.forms, Marginal(problem)
    out = {name: list(entries) for name, entries in columns.items()}
    found = Catalogue(out, problem.data).explain(marginal).values()
    shown = [e for e in found if e.effect.continuous and e.log_evidence > forms.worth_forming]
    best = sorted(shown, key=lambda e: -e.log_evidence)[: forms.n_first]
    for explanation, shape in zip(best, on_two_cores(lambda e: _between(problem, marginal, e), best), strict=True):
        if shape != explanation.column.shape:
            out[explanation.effect.name] += columns_in(problem, explanation.effect, [shape])
    return out


def _between(problem: LinearProblem, marginal: Marginal, explanation: Explanation) -> dict[str, float]:
    """Go by Gauss-Newton steps from the best form of the catalogue to the best one between its neighbours."""
    best = explanation
    around = _around(explanation.column)
    names = list(around)
    low, high = np.log(np.reshape([around[name] for name in names], (-1, 2))).T

    def at(place: ArrayLike) -> Explanation | None:
        shape = {**explanation.column.shape, **dict(zip(names, np.exp(place).tolist(), strict=True))}
        return explain(marginal, columns_in(problem, best.effect, [shape]))

    for _ in range(_N_STEPS if names else 0):
        here = np.log([best.column.shape[name] for name in names])
        beside = [at(here + step) for step in _DIFFERENCE * np.eye(len(names))]
        slopes = [_slope(best, found) for found in beside if found is not None]
        if len(slopes) < len(names):
            break
        gram, moments = marginal.gram(np.column_stack([best.contribution, *slopes]))
        prior = np.diag([0.0, *(12.0 / (high - low) ** 2)])
        step = np.linalg.solve(gram + prior, moments - gram[:, 0])[1:]
        found = at(np.clip(here + step, low, high))
        if found is None or found.log_evidence <= best.log_evidence:
            break
        best = found
    return best.column.shape


def _slope(here: Explanation, beside: Explanation) -> Floats:
    """Change of the fitted signature with the logarithm of one number of the form, its coefficients kept."""
    change = beside.column.columns - here.column.columns
    coefficients = np.linalg.lstsq(here.column.columns, here.contribution, rcond=None)[0]
    return change @ coefficients / _DIFFERENCE


def _around(column: Column) -> dict[str, tuple[float, float]]:
    """Numbers of a form that are continuous, with the next smaller and the next larger one of the catalogue.

    Where all other numbers are the same; 0 is another kind of form.
    """
    effect, shape = column.effect, column.shape
    found = {}
    for name in effect.continuous:
        here = shape.get(name, 0.0)
        rest = {key: value for key, value in shape.items() if key != name}
        alike = [other[name] for other in effect.shapes if other == {**rest, name: other.get(name)}]
        smaller = max((value for value in alike if 0.0 < value < here), default=here)
        larger = min((value for value in alike if value > here), default=here)
        if 0.0 < smaller < larger:
            found[name] = (smaller, larger)
    return found
