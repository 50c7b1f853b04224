"""Effects weighed again with what their forms may miss: one alone, and further ones beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.columns import Column, distorting, forms_beside, known_parts
from sawbench.diagnosis.inference.evidence import Catalogue, Explanation, explain, explain_formed
from sawbench.diagnosis.inference.form_error import form_modes
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.left_over import left_by
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal, Widened
from sawbench.diagnosis.log_mean import log_mean_exp


@dataclass(frozen=True, kw_only=True, slots=True)
class Formed:
    """One effect, weighed with what its form may miss.

    Attributes
    ----------
    explanation : Explanation
        Of the form that is best as it is; its log evidence with what that misses.
    column : Column
        The form that is best with what it misses.
    with_modes : float
        Log evidence with whatever the form may miss, be it more than the form itself explains.
    """

    explanation: Explanation
    column: Column
    with_modes: float

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.explanation.effect.name

    @property
    def shapes(self) -> list[Floats]:
        """Columns of any size, shape (n, q) each: the form that is best as it is, and the one best with what it misses.

        Which of them is nature's shows only once another effect is there too.
        """
        forms = [self.column] if self.explanation.column is self.column else [self.explanation.column, self.column]
        return [form.of_any_size for form in forms]


class Forming:
    """Weighs effects of one campaign again with what their forms may miss.

    Parameters
    ----------
    problem : LinearProblem
    small : ndarray, shape (n, p)
        Nuisance columns of the background effects.
    nominal : Marginal
        Of "no_gap", with `small`.
    dispersion : ndarray, shape (n,)
        Factor on the noise's variance that the problem is whitened with.
    """

    def __init__(self, problem: LinearProblem, small: Floats, nominal: Marginal, dispersion: Floats) -> None:
        self.problem, self.small, self.dispersion = problem, small, dispersion
        self.nominal = nominal
        self._settings = problem.settings.forms
        self._modes: dict[str, Floats] = {}
        self._given: dict[str, float] = {}

    def modes(self, explanation: Explanation) -> Floats:
        """What the form of an effect that comes first may leave, shape (n, q); of its size alone."""
        name = explanation.effect.name
        if name not in self._modes:
            self._modes[name] = form_modes(self.problem, explanation.contribution)
        return self._modes[name]

    def single(self, rough: Explanation, entries: Sequence[Column]) -> Formed:
        """Weigh one effect again, with the discrepancy of its form; its best shape then is another one than without."""
        log_z, formed = explain_formed(self.nominal, self.modes(rough), entries, self._settings.shares)
        with_modes = log_z - self.nominal.log_evidence
        explanation = replace(
            rough,
            log_evidence=_carried(rough.log_evidence, with_modes),
            shape_spread=formed.shape_spread,
            form_share=formed.form_share,
        )
        return Formed(explanation=explanation, column=formed.column, with_modes=with_modes)

    def pairs(self, firsts: Sequence[Formed], catalogue: Catalogue, half: Floats) -> list[Hypothesis]:
        """Weigh every second effect beside each of some firsts, the best of them with what both forms may miss.

        Parameters
        ----------
        firsts : sequence of Formed
        catalogue : Catalogue
        half : ndarray, shape (p, columns)
            `Marginal.half` of its columns for "no_gap".

        Returns
        -------
        list of Hypothesis
            Most evidence first; `left_over` only of those that were weighed with their forms.
        """
        rough: dict[frozenset[str], list[tuple[float, Formed, Explanation]]] = {}
        known = known_parts(catalogue.columns)
        seconds = on_two_cores(lambda first: self._seconds(first, catalogue, half), firsts, known=known)
        for first, found in zip(firsts, seconds, strict=True):
            for total, second in found:
                rough.setdefault(frozenset((first.name, second.effect.name)), []).append((total, first, second))
        best = sorted(rough.values(), key=lambda orders: -max(total for total, *_ in orders))[: self._settings.n_pairs]

        def weighed(orders: Sequence[tuple[float, Formed, Explanation]]) -> Hypothesis:
            # In either order, where both may come first: only the second one's size and form are integrated out.
            pairs = [self._pair(one, two, catalogue.columns) for _, one, two in orders]
            pair = max((pair for pair, _ in pairs), key=lambda pair: pair.log_evidence)
            # An effect that explains as much alone needs no second one, however little of it its form carries.
            most = max((one for _, one, _ in orders), key=lambda one: one.with_modes)
            gained = max(with_modes for _, with_modes in pairs) - most.with_modes
            return replace(pair, log_evidence=min(pair.log_evidence, most.explanation.log_evidence + gained))

        found = on_two_cores(weighed, best, known=known)
        return sorted(found, key=lambda pair: -pair.log_evidence)

    def _seconds(self, first: Formed, catalogue: Catalogue, half: Floats) -> list[tuple[float, Explanation]]:
        """Every effect beside the first in its shapes, with what that misses, after the log evidence of both."""
        missed = self._settings.screen_share * self.modes(first.explanation)
        marginal = self.nominal.beside(np.hstack([*first.shapes, missed]))
        half = marginal.half(catalogue.stacked, half)
        found = catalogue.explain(marginal, half, beside=(first.name,))
        return [(first.explanation.log_evidence + e.log_evidence, e) for name, e in found.items() if name != first.name]

    def _pair(
        self, formed: Formed, second: Explanation, columns: Mapping[str, Sequence[Column]]
    ) -> tuple[Hypothesis, float]:
        """Weigh a pair again with what both forms may miss; a second that hardly shows keeps what screening gave.

        After it, its log evidence with whatever the forms may miss.
        """
        first = formed.explanation
        if second.log_evidence < self._settings.worth_forming:
            pair = _together(first, second, first.log_evidence + second.log_evidence)
            return pair, formed.with_modes + second.log_evidence
        # Of the second's own size beside the first: alone it may stand for all that the first explains.
        modes = form_modes(self.problem, second.contribution)
        forms = forms_beside(columns[second.effect.name], (first.effect.name,))
        own = columns[first.effect.name]
        shown = [c for c in forms_beside(own, (second.effect.name,)) if c.distortion is not None]
        shapes = [(first.column, shape) for shape in formed.shapes]
        shapes += [(c, c.of_any_size) for c in (*distorting(own, forms), *shown)]
        found_in_each = [
            (
                column,
                *explain_formed(
                    self.nominal.beside(shape), modes, forms, self._settings.shares, beside=self.modes(first)
                ),
            )
            for column, shape in shapes
        ]
        column, log_z, found = max(found_in_each, key=lambda each: each[1])
        by_form = second.log_evidence
        if column.distortion is not None:
            by_form = max(by_form, self._added_by_form(first.column, column, found.column))
        if column is not first.column:
            first = explain(self.nominal.beside(found.column.of_any_size), [column]) or first
        gained = log_z - self._alone(formed)
        pair = _together(first, found, formed.explanation.log_evidence + _carried(by_form, gained))
        shared = shared_energy(self.problem, self._acting(first), self._acting(found))
        left = left_by(self.problem, self.dispersion, self.nominal, (first, found))
        return replace(pair, shared=shared, left_over=left), formed.with_modes + gained

    def _added_by_form(self, alone: Column, shown: Column, second: Column) -> float:
        """Log evidence that a second effect adds to a first one, which beside it has the form that it shows."""
        beside = self.nominal.beside(second.of_any_size)
        added, first = explain(beside, [shown]), explain(self.nominal, [alone])
        if added is None or first is None:
            return -np.inf
        return beside.log_evidence - self.nominal.log_evidence + added.log_evidence - first.log_evidence

    def _acting(self, explanation: Explanation) -> Floats:
        """What an effect changes of the features: where it moves the blade, also the force of that motion.

        The cutting law is compared with the blade's measured velocity, so that the motion is in no signature; what is
        misread of it, a derivative of a displacement, is there all the same.
        """
        moved = explanation.effect.moves_blade
        return explanation.contribution + self._beyond_crank if moved else explanation.contribution

    @cached_property
    def _beyond_crank(self) -> Floats:
        return self.problem.project(self.problem.campaign.plant.force_beyond_crank)

    def _alone(self, first: Formed) -> float:
        """Log evidence of a first effect as `_pair` has it: of any size, which costs a wave of many columns much."""
        if first.name not in self._given:
            found = []
            for shape in first.shapes:
                widened = Widened(self.nominal.beside(shape), self.modes(first.explanation))
                found.append(log_mean_exp([widened.at(share)[0] for share in self._settings.shares]))
            self._given[first.name] = max(found)
        return self._given[first.name]


def _together(first: Explanation, second: Explanation, log_evidence: float) -> Hypothesis:
    members = tuple(sorted((first, second), key=lambda e: e.effect.name))
    return Hypothesis(
        effects=tuple(e.effect.name for e in members), members=members, log_evidence=log_evidence,
        is_fitted_together=True,
    )  # fmt: skip


def _carried(by_form: float, with_modes: float) -> float:
    """Log evidence with model discrepancy, which cannot weigh more than what the form itself explains."""
    return min(with_modes, by_form + max(by_form, 0.0))


def shared_energy(problem: LinearProblem, first: Floats, second: Floats) -> float:
    """Sum over the equations of the shares of energy that two signatures have there, multiplied."""
    one, other = (np.array(list(problem.sums_by_equation(signature**2).values())) for signature in (first, second))
    return float(one @ other / max(one.sum() * other.sum(), 1e-300))
