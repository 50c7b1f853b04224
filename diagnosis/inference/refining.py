"""Forms between those of the catalogue, for the effects that explain most.

The catalogue holds time constants a fourth apart. Where an effect stands hundreds of times above the noise, what the
nearest form leaves is larger than another effect, which would then be claimed beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Final, Protocol, TypeVar

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.columns import Column, columns_in, known_parts
from sawbench.diagnosis.inference.evidence import Catalogue, Explanation, explain
from sawbench.diagnosis.inference.form_numbers import kind, neighbours
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal


class _Weighed(Protocol):
    @property
    def log_evidence(self) -> float: ...


Found = TypeVar("Found", bound=_Weighed)

_N_STEPS: Final = 8
# A step that goes too far is halved; what gains less than a tenth of a nat is the same form.
_SHARES_OF_STEP: Final = (1.0, 0.5, 0.25, 0.125)
_SAME: Final = 0.1
_DIFFERENCE: Final = 1e-3


class WeighedAlone:
    """Columns of effects, and what each effect explains with the nuisances alone: worked out once, when asked for.

    Parameters
    ----------
    problem : LinearProblem
    columns : mapping of str to sequence of Column
        Of `catalogue_columns`.
    marginal : Marginal, optional
        Of the problem, where it is there already.

    Attributes
    ----------
    problem : LinearProblem
    marginal : Marginal
    columns : dict of str to list of Column
    """

    def __init__(
        self, problem: LinearProblem, columns: Mapping[str, Sequence[Column]], marginal: Marginal | None = None
    ) -> None:  # fmt: skip
        self.problem, self.marginal = problem, Marginal(problem) if marginal is None else marginal
        self.columns = {name: list(entries) for name, entries in columns.items()}

    @cached_property
    def catalogue(self) -> Catalogue:
        """The columns side by side."""
        return Catalogue(self.columns, self.problem.data)

    @cached_property
    def half(self) -> Floats:
        """`Marginal.half` of the columns."""
        return self.marginal.half(self.catalogue.stacked)

    @cached_property
    def explanations(self) -> dict[str, Explanation]:
        """Of every effect that shows anything."""
        return self.catalogue.explain(self.marginal, self.half)

    @cached_property
    def best(self) -> list[Explanation]:
        """Effects whose form matters, most evidence first."""
        return worth_it(self.explanations, self.problem.settings.forms.worth_forming)

    @cached_property
    def likeliest_pairs(self) -> list[tuple[Explanation, Explanation]]:
        """Each of the best effects with what explains more beside it, by their log evidence, most of it first."""
        forms = self.problem.settings.forms
        firsts = self.best[: forms.n_first]
        pairs: dict[frozenset[str], tuple[float, Explanation, Explanation]] = {}

        def seconds_of(first: Explanation) -> list[Explanation]:
            given = self.marginal.beside(first.column.of_any_size)
            found = self.catalogue.explain(given, given.half(self.catalogue.stacked, self.half))
            return worth_it(found, forms.worth_forming)

        beside = on_two_cores(seconds_of, firsts, known=known_parts(self.columns))
        for first, seconds in zip(firsts, beside, strict=True):
            for second in seconds:
                names = frozenset((first.effect.name, second.effect.name))
                total = first.log_evidence + second.log_evidence
                if len(names) == 2 and total > pairs.get(names, (-np.inf,))[0]:
                    pairs[names] = (total, first, second)
        best = sorted(pairs.values(), key=lambda pair: -pair[0])[: forms.n_pairs]
        return [(first, second) for _, first, second in best]

    def with_forms(self, further: Sequence[Column]) -> WeighedAlone:
        """The same with further forms of its effects; itself, where it has them all."""
        columns = {name: list(entries) for name, entries in self.columns.items()}
        for column in further:
            if not any(column.is_form_of(known) for known in columns[column.effect.name]):
                columns[column.effect.name].append(column)
        has_all = all(len(entries) == len(columns[name]) for name, entries in self.columns.items())
        return self if has_all else WeighedAlone(self.problem, columns, self.marginal)


def refined(weighed: WeighedAlone) -> WeighedAlone:
    """Add to the effects that explain most the forms between those of the catalogue that explain more.

    Alone, and beside each other: the best form of an effect alone also stands for what another one explains.

    Parameters
    ----------
    weighed : WeighedAlone
        With the forms of the catalogue.

    Returns
    -------
    WeighedAlone
        One column more for each better form that was found.
    """
    problem, columns = weighed.problem, weighed.columns
    best = [e for e in weighed.best if e.effect.continuous][: problem.settings.forms.n_first]
    found = on_two_cores(
        lambda e: _between(problem, weighed.marginal, e, columns[e.effect.name]), best, known=known_parts(columns)
    )
    weighed = weighed.with_forms(found)
    return weighed.with_forms(_refined_beside(weighed))


def _refined_beside(weighed: WeighedAlone) -> list[Column]:
    """Better forms of the likeliest pairs."""
    problem, marginal, catalogue = weighed.problem, weighed.marginal, weighed.catalogue
    both = on_two_cores(
        lambda pair: _between_both(problem, marginal, catalogue, *pair), weighed.likeliest_pairs,
        known=known_parts(catalogue.columns),
    )  # fmt: skip
    return [column for pair in both for column in pair]


def _between_both(
    problem: LinearProblem, alone: Marginal, catalogue: Catalogue, first: Explanation, second: Explanation
) -> tuple[Column, Column]:
    """Refine the second effect beside the first, and then the first beside the second."""
    beside_first = alone.beside(first.column.of_any_size)
    other = _between(problem, beside_first, second, catalogue.columns[second.effect.name])
    marginal = alone.beside(other.of_any_size)
    again = explain(marginal, [first.column])
    return (first if again is None else climbed(problem, marginal, again)).column, other


def worth_it(found: Mapping[str, Explanation], least: float) -> list[Explanation]:
    """Effects whose form matters, for their log evidence, most of it first."""
    return [e for e in sorted(found.values(), key=lambda e: -e.log_evidence) if e.log_evidence > least]


def _between(problem: LinearProblem, marginal: Marginal, best: Explanation, columns: Sequence[Column]) -> Column:
    """Best form between those of an effect: from its best one, and from the best one of every other kind."""
    others: dict[tuple[str, ...], list[Column]] = {}
    for column in columns:
        if kind(column) != kind(best.column):
            others.setdefault(kind(column), []).append(column)
    starts = [best, *(found for alike in others.values() if (found := explain(marginal, alike)) is not None)]
    return max((climbed(problem, marginal, start) for start in starts), key=lambda e: e.log_evidence).column


def climbed(problem: LinearProblem, marginal: Marginal, explanation: Explanation) -> Explanation:
    """Go by Gauss-Newton steps from a form of the catalogue to the best one between its neighbours."""
    effect, shape, distortion = explanation.effect, explanation.column.shape, explanation.column.distortion
    bounds = neighbours(explanation.column)

    def at(place: Floats) -> Explanation | None:
        numbers = dict(zip(bounds, np.exp(place).tolist(), strict=True))
        return explain(marginal, columns_in(problem, effect, [{**shape, **numbers}], distortion))

    def signatures(fitted: Explanation) -> Callable[[Explanation], Floats]:
        sizes = coefficients(fitted)[:, None]
        return lambda found: found.column.columns @ sizes

    return gauss_newton(
        marginal, explanation, at, signatures,
        here=np.log([shape[name] for name in bounds]), bounds=np.log(np.reshape(list(bounds.values()), (-1, 2))),
    )  # fmt: skip


def gauss_newton(
    marginal: Marginal,
    begun: Found,
    at: Callable[[Floats], Found | None],
    signatures: Callable[[Found], Callable[[Found], Floats]],
    *,
    here: Floats,
    bounds: Floats,
) -> Found:
    """Climb the log evidence over numbers of forms, with the sizes of the signatures free.

    Parameters
    ----------
    marginal : Marginal
    begun : Found
        What is found at `here`.
    at : callable
        Numbers, shape (k,) -> what is found there, None where nothing shows.
    signatures : callable
        What is fitted -> what is found -> the signatures of the second with the coefficients of the first, shape
        (n, m), whose sum is all.
    here : ndarray, shape (k,)
        Where to begin.
    bounds : ndarray, shape (k, 2)
    """
    best, (low, high) = begun, bounds.T
    for _ in range(_N_STEPS if len(here) else 0):
        of_size = signatures(best)
        own = of_size(best)
        beside = [at(here + step) for step in _DIFFERENCE * np.eye(len(here))]
        slopes = [(of_size(f) - own).sum(axis=1) / _DIFFERENCE for f in beside if f is not None]
        if len(slopes) < len(here):
            break
        m = own.shape[1]
        gram, moments = marginal.gram(np.column_stack([own, *slopes]))
        prior = np.diag([*np.zeros(m), *(12.0 / (high - low) ** 2)])
        # Of two signatures that are one, or of one that is nothing, the least change.
        wanted = here + np.linalg.lstsq(gram + prior, moments - gram[:, :m].sum(axis=1), rcond=None)[0][m:]
        step = np.clip(wanted, low, high) - here
        tried = ((share, at(here + share * step)) for share in _SHARES_OF_STEP)
        better = ((s, f) for s, f in tried if f is not None and f.log_evidence > best.log_evidence + _SAME)
        share, found = next(better, (0.0, None))
        if found is None:
            break
        here, best = here + share * step, found
    return best


def coefficients(explanation: Explanation) -> Floats:
    """Coefficients of the columns of an explanation, in multiples of the typical size."""
    return np.linalg.lstsq(explanation.column.columns, explanation.contribution, rcond=None)[0]
