"""Probabilities over effects, effects together, "parameters", "no_gap" and "unknown"."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.asynchronous import Finding, off_stroke_findings
from sawbench.diagnosis.inference.beside_known import BesideKnown
from sawbench.diagnosis.inference.columns import Column, catalogue_columns, forms_beside, known_parts, little_of_each
from sawbench.diagnosis.inference.dispersion import (
    background_with_noise,
    catalogue_with_noise,
    columns_with_noise,
    noise_factor,
    with_noise,
)
from sawbench.diagnosis.inference.evidence import Catalogue, Explanation
from sawbench.diagnosis.inference.forming import Forming
from sawbench.diagnosis.inference.hypothesis import Hypothesis, Verdict
from sawbench.diagnosis.inference.left_over import left_by, left_over, left_over_by_each
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.one_form import lacking_of_forms_that_show
from sawbench.diagnosis.inference.ordinary_modes import ordinary_modes
from sawbench.diagnosis.inference.refining import WeighedAlone
from sawbench.diagnosis.inference.retuning import Retuning
from sawbench.diagnosis.inference.size import together
from sawbench.diagnosis.inference.stroke_evidence import (
    StrokesSay,
    sized_by_strokes,
    strokes_say,
    with_mean_strokes,
    with_strokes,
    zeros_say,
)
from sawbench.diagnosis.inference.unnamed import beyond_catalogue, unnamed
from sawbench.diagnosis.inference.unsteady_balance import unsteady_balances
from sawbench.diagnosis.inference.weighing import weigh


@dataclass(frozen=True, kw_only=True, slots=True)
class Posterior:
    """What the evidence says.

    Attributes
    ----------
    hypotheses : tuple of Hypothesis
        With their probabilities, most likely first; they sum to 1.
    explanations : tuple of Explanation
        Of every single effect, most evidence first.
    strokes : dict of str to StrokesSay
        What the single strokes say, by effect.
    finding : Finding or None
        The strongest that no effect of the catalogue can bring about: what is asynchronous with the stroke and no
        scatter, or a balance that varies within trials.
    unlisted : dict of str to float
        Log evidence for "unknown", by what it looks like; "" for a gap of no particular form.
    dispersion : ndarray, shape (n,)
        Factor on the noise's variance of every feature: 1 where the best effect explains the gap as an intact machine
        is explained.
    little : dict of str to ndarray, shape (n, q)
        Nuisance columns of the background effects, times their prior standard deviation.
    freed : tuple of str
        Numbers of the plant that a fit may move beyond what is stated of them; see `Retuning`.
    """

    hypotheses: tuple[Hypothesis, ...]
    explanations: tuple[Explanation, ...]
    strokes: dict[str, StrokesSay]
    finding: Finding | None
    unlisted: dict[str, float]
    dispersion: Floats
    little: dict[str, Floats]
    freed: tuple[str, ...]

    @property
    def best(self) -> Hypothesis:
        """The answer: the most likely claim with an effect that is likelier there than not, else the most likely one.

        What is not sure of a claim is often what stands beside its effect: then several claims share what says that
        the effect is there, and each of them may have less than "unknown".
        """
        first = self.hypotheses[0]
        if first.effects:
            return first
        there: dict[str, float] = {}
        for claim in self.claims:
            for name in claim.effects:
                there[name] = there.get(name, 0.0) + claim.probability
        likelier = {name for name, probability in there.items() if probability > 0.5}
        return next((claim for claim in self.claims if likelier & set(claim.effects)), first)

    @property
    def verdict(self) -> Verdict:
        """Of the answer."""
        return self.best.verdict

    @property
    def resembles(self) -> str:
        """Strongest evidence for "unknown"; empty for a gap of no particular form, and where there is no evidence."""
        text = max(self.unlisted, key=lambda text: self.unlisted[text])
        return text if self.unlisted[text] > 0.0 else ""

    @property
    def claims(self) -> tuple[Hypothesis, ...]:
        """Those that name effects."""
        return tuple(h for h in self.hypotheses if h.effects)

    def of(self, name: str) -> Hypothesis:
        """Look one up by its name."""
        return next(h for h in self.hypotheses if h.name == name)

    @property
    def small(self) -> Floats:
        """All of `little` side by side, shape (n, q)."""
        return np.hstack([np.zeros((len(self.dispersion), 0)), *self.little.values()])


def judge(
    problem: LinearProblem, columns: Mapping[str, Sequence[Column]], *, are_known_certain: bool = True
) -> Posterior:  # fmt: skip
    """Weigh all hypotheses against each other.

    Parameters
    ----------
    problem : LinearProblem
    columns : mapping of str to sequence of Column
        Of `catalogue_columns`.
    are_known_certain : bool
        Further effects pay for what the forms of the known ones miss. A search that weighs its causes again, one beside
        the other, has that paid itself.

    Returns
    -------
    Posterior
    """
    return judge_weighed(WeighedAlone(problem, columns), are_known_certain=are_known_certain)


def judge_weighed(weighed: WeighedAlone, *, are_known_certain: bool = True) -> Posterior:
    """`judge` of effects of which it may be known what they explain alone."""
    problem = weighed.problem
    columns = {name: entries for name, entries in weighed.columns.items() if entries}
    campaign, settings = problem.campaign, problem.settings
    plant, effects = campaign.plant, campaign.plant.effects

    def asynchronous() -> Finding | None:
        found = [*off_stroke_findings(campaign.off_stroke, plant.turns_a_cycle), *unsteady_balances(problem)]
        return max(found, key=lambda finding: finding.log_evidence, default=None)

    # This process takes the first one, which it keeps; the other one the last, the longest.
    parts: list[Callable[[], Any]] = [
        lambda: weighed.half,
        asynchronous,
        lambda: little_of_each(problem, columns),
        lambda: strokes_say(effects, campaign.states, campaign.strokes, settings, plant.known),
        lambda: catalogue_columns(problem, plant.beyond_catalogue),
    ]
    known = (*effects, *plant.beyond_catalogue)
    _, beside, little, (said, of_strokes), laws = on_two_cores(operator.call, parts, known=known)
    said = said | zeros_say(effects, problem.wander)
    bench = _bench_of(weighed, little, laws)
    singles, pairs = _singles_and_pairs(bench)
    listed = {h.name: h.log_evidence for h in singles}
    beyond = beyond_catalogue(bench.forming, bench.nominal, bench.beyond, listed)
    of_strokes = with_mean_strokes(of_strokes, said, campaign.strokes, listed)
    nobodys = unnamed(bench.forming, beyond, of_strokes, beside)
    retuning = Retuning(bench.problem, bench.nominal)
    hypotheses = [*_without_effects(bench, retuning), *singles, *pairs]
    hypotheses.append(Hypothesis(other="unknown", log_evidence=max(nobodys.values())))
    by_name = {e.name: e for e in effects}
    for one in said.values():
        hypotheses = with_strokes(hypotheses, one, by_name, settings)
    resting, gap = [_resting(bench, h, said) for h in hypotheses], None
    if plant.known and are_known_certain:
        beside_known = BesideKnown(bench.problem, bench.dispersion, bench.forming.small)
        resting, gap = [beside_known.paid(h) for h in resting], beside_known.gap
    ranked = weigh(
        resting, n_effects=len(effects), gap=gap, quiet=problem.quiet, weights=settings.weights
    )  # fmt: skip
    stated = _Stated(problem, columns, bench.dispersion, said)
    explanations = stated.singles(singles, no_gap=hypotheses[0])
    return Posterior(
        hypotheses=tuple(stated.members(h, explanations) for h in ranked),
        explanations=tuple(explanations.values()),
        strokes=said,
        finding=beside,
        unlisted=nobodys,
        dispersion=bench.dispersion,
        little=bench.little,
        freed=retuning.freed,
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class _Bench:
    """A problem whose noise is scaled to the residual of the best effects, and what is weighed on it.

    `little` is of the background effects, as measured: by name, shape (n, q). `half` is what `nominal` takes up of the
    catalogue.
    """

    problem: LinearProblem
    dispersion: Floats
    catalogue: Catalogue
    beyond: dict[str, list[Column]]
    little: dict[str, Floats]
    nominal: Marginal
    half: Floats
    forming: Forming


def _bench_of(weighed: WeighedAlone, little: dict[str, Floats], beyond: dict[str, list[Column]]) -> _Bench:
    """Scale the noise to what the best effects leave, and add to the background the forms that show."""
    problem, catalogue = weighed.problem, weighed.catalogue
    ordinary = ordinary_modes(weighed, beyond, little)
    dispersion = noise_factor(
        weighed, Catalogue(beyond, problem.data), background_with_noise(ordinary, np.ones(len(problem.data)))
    )
    little = little | ordinary
    if dispersion.max() > 1.0:
        catalogue = catalogue_with_noise(problem, catalogue, dispersion)
        beyond = columns_with_noise(problem, beyond, dispersion)
        problem = with_noise(problem, dispersion)
    small = background_with_noise(little, dispersion)
    nominal = Marginal(problem, extra=small)
    half = np.hstack(on_two_cores(nominal.half, np.array_split(catalogue.stacked, 2, axis=1)))
    rough = sorted(catalogue.explain(nominal, half).values(), key=lambda e: -e.log_evidence)
    likeliest = [nominal.beside(e.column.of_any_size) for e in rough[: problem.settings.forms.n_first]]
    wide = Marginal(problem, scale=problem.wide_scale, extra=small)
    # What shows beside no effect, beside each of the likeliest, and where the plant's numbers are wrong.
    lacking = lacking_of_forms_that_show(little, weighed.columns, dispersion, [[nominal, *likeliest], [wide]])
    if lacking:
        nominal = nominal.beside(background_with_noise(lacking, dispersion))
        half = nominal.half(catalogue.stacked, half)
        little = little | {name: np.hstack([little[name], found]) for name, found in lacking.items()}
    forming = Forming(problem, background_with_noise(little, dispersion), nominal, dispersion)
    return _Bench(
        problem=problem, dispersion=dispersion, catalogue=catalogue, beyond=beyond, little=little, nominal=nominal,
        half=half, forming=forming,
    )  # fmt: skip


def _without_effects(bench: _Bench, retuning: Retuning) -> list[Hypothesis]:
    """Build "no_gap" and "parameters"."""
    return [
        Hypothesis(
            other="no_gap", log_evidence=0.0,
            left_over=left_over(bench.problem, bench.dispersion, bench.nominal),
        ),
        Hypothesis(
            other="parameters", log_evidence=retuning.log_evidence,
            left_over=left_over(bench.problem, bench.dispersion, retuning.wide),
        ),
    ]  # fmt: skip


def _singles_and_pairs(bench: _Bench) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Weigh every effect, the best ones with what their forms may miss, and pairs of these with any other."""
    numbers, catalogue = bench.problem.settings.forms, bench.catalogue
    rough = sorted(catalogue.explain(bench.nominal, bench.half).values(), key=lambda e: -e.log_evidence)
    formed = on_two_cores(
        lambda e: bench.forming.single(e, forms_beside(catalogue.columns[e.effect.name])), rough[: numbers.n_formed],
        known=known_parts(catalogue.columns),
    )  # fmt: skip
    formed.sort(key=lambda one: -one.explanation.log_evidence)
    explanations = [*(one.explanation for one in formed), *rough[numbers.n_formed :]]
    explanations.sort(key=lambda e: -e.log_evidence)
    left = left_over_by_each(bench.problem, bench.dispersion, bench.nominal, explanations)
    singles = [
        Hypothesis(effects=(e.effect.name,), members=(e,), log_evidence=e.log_evidence, left_over=of_each)
        for e, of_each in zip(explanations, left, strict=True)
    ]
    alone = {h.name: h.left_over for h in singles}
    pairs = bench.forming.pairs(formed[: numbers.n_first], catalogue, bench.half)
    return singles, [_leaving_no_more(h, alone) for h in pairs]


def _leaving_no_more(pair: Hypothesis, alone: Mapping[str, float]) -> Hypothesis:
    """What a pair leaves is no more than what one of its effects leaves: noise that is scaled fits them otherwise."""
    if not np.isfinite(pair.left_over):
        return pair
    return replace(pair, left_over=min(pair.left_over, *(alone[name] for name in pair.effects)))


def _resting(bench: _Bench, hypothesis: Hypothesis, said: Mapping[str, StrokesSay]) -> Hypothesis:
    """With what it leaves, where it rests on single strokes and nobody fitted it: mean strokes know trends alone."""
    if hypothesis.of_strokes <= 0.0 or len(hypothesis.effects) < 2 or np.isfinite(hypothesis.left_over):
        return hypothesis
    shown = [m for m in hypothesis.members if m.effect.name not in said or said[m.effect.name].is_trend]
    return replace(hypothesis, left_over=left_by(bench.problem, bench.dispersion, bench.nominal, shown))


class _Stated:
    """States explanations by the noise as it was measured, with the sizes that the report gives."""

    def __init__(
        self, problem: LinearProblem, columns: Mapping[str, Sequence[Column]], dispersion: Floats,
        said: Mapping[str, StrokesSay],
    ) -> None:  # fmt: skip
        self._problem, self._columns, self._dispersion, self._said = problem, columns, dispersion, said
        self._scaled = Marginal(with_noise(problem, dispersion))

    def singles(self, singles: Sequence[Hypothesis], *, no_gap: Hypothesis) -> dict[str, Explanation]:
        """Every effect alone, in the order given."""
        quiet, found = self._problem.quiet, {}
        for h in singles:
            sized = uncertain_by_left_over(h.members[0], h.left_over, no_gap=no_gap.left_over, quiet=quiet)
            found[h.name] = sized_by_strokes(self._undispersed(sized), self._said)
        return found

    def members(self, hypothesis: Hypothesis, alone: Mapping[str, Explanation]) -> Hypothesis:
        """Members as they are alone, or found beside each other."""
        if not hypothesis.is_fitted_together:
            return replace(hypothesis, members=tuple(alone[name] for name in hypothesis.effects))
        members = [self._undispersed(m) for m in hypothesis.members]
        beside = together(self._problem, self._scaled, members, dispersion=self._dispersion)
        return replace(hypothesis, members=tuple(sized_by_strokes(m, self._said) for m in beside))

    def _undispersed(self, explanation: Explanation) -> Explanation:
        shapes = self._columns[explanation.effect.name]
        column = next(c for c in shapes if c.is_form_of(explanation.column))
        return replace(explanation, column=column, contribution=np.sqrt(self._dispersion) * explanation.contribution)


def uncertain_by_left_over(explanation: Explanation, left: float, *, no_gap: float, quiet: float) -> Explanation:
    """A form that leaves much of the gap is not nature's: half of that share, in amplitude, is uncertain.

    Parameters
    ----------
    explanation : Explanation
    left, no_gap : float
        Whitened misfit over the number of features, of the effect and of the nominal model.
    quiet : float
        That of an intact machine.
    """
    rest = max(left - quiet, 0.0)
    share = 0.5 * float(np.sqrt(rest / max(no_gap - quiet, rest, 1e-12)))
    return replace(explanation, form_share=max(explanation.form_share, share))
