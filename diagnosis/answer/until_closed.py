"""Causes one by one: what was found becomes part of the model, and the rest of the gap is weighed again.

One pass names one effect or two. The next pass weighs the same campaign with these in the model, their magnitudes free
to be refined, and so on. All causes together are then one hypothesis about the model as configured: they are sized
beside each other, and each must still predict withheld operating points beside the others. An earlier cause that a
later one has made needless is dropped by that.

A gap of three effects can leave so much beside the best two that "unknown" is the likeliest answer. So the likeliest
cause is followed on trial; it is kept only where the causes together leave what an intact machine leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
from sawbench.diagnosis.answer.claim import carried_by_strokes, held_to_predictions
from sawbench.diagnosis.answer.closed_share import closed_share
from sawbench.diagnosis.answer.improved_model import found_effects, magnitudes
from sawbench.diagnosis.answer.ladder import Ladder
from sawbench.diagnosis.answer.prediction import Predictions, stacked
from sawbench.diagnosis.campaign import with_known
from sawbench.diagnosis.inference.acts_in import equations_of
from sawbench.diagnosis.inference.columns import Column, columns_in, forms_beside
from sawbench.diagnosis.inference.dispersion import (
    columns_with_noise,
    noise_factor_beside,
    stacked_with_noise,
    with_noise,
)
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.evidence import Explanation, explain
from sawbench.diagnosis.inference.forming import shared_energy
from sawbench.diagnosis.inference.hypothesis import AND, Hypothesis
from sawbench.diagnosis.inference.linear_problem import LinearProblem, build_problem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import Posterior, judge
from sawbench.diagnosis.inference.shown_pair import distortion_of
from sawbench.diagnosis.inference.size import together
from sawbench.diagnosis.inference.stroke_evidence import sized_by_strokes
from sawbench.diagnosis.inference.weighing import weigh_further

Stopped = Literal["no_gap", "parameters", "unknown", "nothing_more", "repeatability", "passes"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Pass:
    """One weighing of the campaign with a certain model.

    Attributes
    ----------
    problem : LinearProblem
    columns : dict of str to list of Column
        By effect.
    posterior : Posterior
        Held to its predictions.
    predictions : Predictions
    """

    problem: LinearProblem
    columns: dict[str, list[Column]]
    posterior: Posterior
    predictions: Predictions


@dataclass(frozen=True, kw_only=True, slots=True)
class CauseRung:
    """One cause on the ladder from the model as configured to the floor.

    Attributes
    ----------
    effect : str
    number : int
        Of the pass that named it, from 1.
    probability : float
        That it takes part, as all was weighed after that pass.
    with_effect : float
        Withheld residual over its noise, root mean square, with this cause and those before it.
    closed, added : float
        Share of what re-tuned parameters leave above the noise that this cause and those before it close, and of what
        was left before it that this one closes.
    closed_ci95, added_ci95 : tuple of float
    """

    effect: str
    number: int
    probability: float
    with_effect: float
    closed: float
    closed_ci95: tuple[float, float]
    added: float
    added_ci95: tuple[float, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class Closing:
    """All causes of one campaign.

    Attributes
    ----------
    answer : Pass
        On the model as configured; the likeliest hypothesis of its posterior holds all causes.
    rungs : tuple of CauseRung
        In the order in which they were found.
    dropped : tuple of str
        Effects that later ones made needless.
    stopped : Stopped
        What the last pass answers, or why there is no further one.
    n_passes : int
    """

    answer: Pass
    rungs: tuple[CauseRung, ...]
    dropped: tuple[str, ...]
    stopped: Stopped
    n_passes: int


def held(problem: LinearProblem, columns: dict[str, list[Column]], posterior: Posterior) -> Pass:
    """Hold an answer to its predictions."""
    predictions = Predictions(problem, columns, posterior)
    posterior = held_to_predictions(problem, posterior, predictions)
    return Pass(problem=problem, columns=columns, posterior=posterior, predictions=predictions)


def until_closed(first: Pass, *, on_pass: Callable[[int, str], None] | None = None) -> Closing:
    """Add causes until nothing more closes.

    Parameters
    ----------
    first : Pass
        With the model as configured.
    on_pass : callable, optional
        (number, what is in the model by then), before each further pass.

    Returns
    -------
    Closing
    """
    answer, kept, number, is_on_trial, is_refused = first, first, 1, False, False
    numbers = first.problem.settings.closing
    if first.posterior.verdict == "unknown":
        answer, is_on_trial = _on_trial(first), True
    found = _Found(answer.posterior, is_on_trial=is_on_trial)
    stopped: Stopped = first.posterior.best.other or "nothing_more"
    rest = 1.0
    while answer.posterior.best.effects:
        if _is_within_noise(answer):
            stopped, rest = "repeatability", 0.0
            break
        if number == numbers.most_passes:
            stopped, is_refused = "passes", True
            break
        number += 1
        if on_pass is not None:
            on_pass(number, answer.posterior.best.name)
        step = _beside(answer)
        first = _with_forms(first, answer.posterior.best, step)
        rest = _share_left(first, step)
        after = held(first.problem, first.columns, _joined(first, answer.posterior, step))
        needs_trial = after.posterior.verdict == "unknown"
        if needs_trial:
            after = _on_trial(after)
        if not found.is_new(after.posterior.best):
            is_refused = needs_trial
            stopped = "unknown" if needs_trial else step.best.other or "nothing_more"
            if not needs_trial and after.posterior.best.effects == answer.posterior.best.effects:
                answer = after
                kept = kept if is_on_trial else answer
            break
        found.add(number, after.posterior, is_on_trial=needs_trial)
        answer, is_on_trial = after, is_on_trial or needs_trial
        if not is_on_trial:
            kept = answer
    if is_on_trial and (is_refused or rest > numbers.left_on_trial):
        answer, stopped = kept, "unknown"
    posterior = answer.posterior
    return Closing(
        answer=answer, rungs=_rungs(answer, found.settled(posterior)), dropped=found.dropped(posterior.best),
        stopped=stopped, n_passes=number,
    )  # fmt: skip


def closing_table(closing: Closing) -> dict[str, Any]:
    """Return the ladder of causes as plain values: the table `until_closed` of the report.

    Parameters
    ----------
    closing : Closing

    Returns
    -------
    dict
        "stopped", "n_passes", "dropped", the residual at withheld operating points over its noise ("nominal",
        "retuned", "noise_floor"), and "rungs": one a cause, in the order in which they were found.
    """
    answer = closing.answer
    best = answer.posterior.best
    shown = best if best.effects else answer.posterior.of("no_gap")
    whitened = answer.predictions.of(shown).ladder.whitened
    members = answer.predictions.sized(best)
    stated = {m.effect.name: magnitudes(answer.problem, [m]) for m in members}
    return {
        "stopped": closing.stopped,
        "n_passes": closing.n_passes,
        "dropped": list(closing.dropped),
        "nominal": whitened.nominal,
        "retuned": whitened.retuned,
        "noise_floor": whitened.noise_floor,
        "rungs": [
            {
                "effect": rung.effect, "pass": rung.number, "probability": rung.probability,
                "parameters": stated[rung.effect], "with_effect": rung.with_effect,
                "gap_closed": rung.closed, "gap_closed_ci95": list(rung.closed_ci95),
                "added": rung.added, "added_ci95": list(rung.added_ci95),
                "carried_by_strokes": rung.effect in carried_by_strokes(answer.posterior, best),
            }
            for rung in closing.rungs
        ],
    }  # fmt: skip


class _Found:
    """In which pass each effect was named, with which probability, and what stood together before."""

    def __init__(self, first: Posterior, *, is_on_trial: bool) -> None:
        self._named: dict[str, tuple[int, float]] = {}
        self._on_trial: set[str] = set()
        self._seen: list[tuple[str, ...]] = []
        self.add(1, first, is_on_trial=is_on_trial)

    def is_new(self, best: Hypothesis) -> bool:
        """Whether these effects have not stood together before, nor more than them."""
        return not any(set(best.effects) <= set(effects) for effects in self._seen)

    def add(self, number: int, posterior: Posterior, *, is_on_trial: bool) -> None:
        """Note what a pass has added."""
        effects = posterior.best.effects
        fresh = [name for name in effects if name not in self._named]
        self._named |= {name: (number, _part(posterior, name)) for name in fresh}
        self._on_trial |= set(fresh) if is_on_trial else set()
        self._seen.append(effects)

    def settled(self, answer: Posterior) -> dict[str, tuple[int, float]]:
        """Passes and probabilities; what was named on trial has the one that the answer leaves it."""
        return {
            name: (number, _part(answer, name) if name in self._on_trial else probability)
            for name, (number, probability) in self._named.items()
        }

    def dropped(self, best: Hypothesis) -> tuple[str, ...]:
        """Effects that stood in the answer once and do no more."""
        every = dict.fromkeys(name for effects in self._seen for name in effects)
        return tuple(name for name in every if name not in best.effects)


def _part(posterior: Posterior, name: str) -> float:
    return sum(h.probability for h in posterior.hypotheses if name in h.effects)


def _on_trial(asked: Pass) -> Pass:
    """Follow the likeliest cause although "unknown" is likelier: that stands for what the cause leaves."""
    posterior = asked.posterior
    if not any(h.probability > 0.0 for h in posterior.claims):
        return asked
    unknown, likeliest = posterior.of("unknown"), posterior.claims[0]
    moved = {unknown.name: 0.0, likeliest.name: likeliest.probability + unknown.probability}
    followed = [replace(h, probability=moved.get(h.name, h.probability)) for h in posterior.hypotheses]
    return held(asked.problem, asked.columns, _with_hypotheses(posterior, followed))


def _with_hypotheses(posterior: Posterior, hypotheses: Sequence[Hypothesis]) -> Posterior:
    """Replace the hypotheses; their probabilities are made to sum to 1."""
    total = sum(h.probability for h in hypotheses)
    scaled = [replace(h, probability=h.probability / total) for h in hypotheses]
    return replace(posterior, hypotheses=tuple(sorted(scaled, key=lambda h: -h.probability)))


def _beside(answer: Pass) -> Posterior:
    """Weigh the campaign again with all causes in the model."""
    problem, posterior = answer.problem, answer.posterior
    members = answer.predictions.sized(posterior.best)
    found = [
        replace(known, std=max(known.std, problem.settings.closing.least_rel_std * abs(known.value)))
        for known in found_effects(problem, posterior, members)
    ]
    campaign = with_known(problem.campaign, (*problem.campaign.plant.known, *found))
    again = build_problem(campaign, settings=problem.settings)
    return judge(again, effect_columns(again), are_known_certain=False)


def _with_forms(first: Pass, base: Hypothesis, step: Posterior) -> Pass:
    """Add the forms that a pass has found beside certain causes, as they are on the model as configured."""
    columns = {name: list(found) for name, found in first.columns.items()}
    by_base = [distortion_of(member) for member in base.members if member.effect.distorts is not None]
    for member in (member for h in step.claims for member in h.members):
        known = columns[member.effect.name]
        for distortion in (member.column.distortion, *by_base):
            wanted = replace(member.column, distortion=distortion)
            if not any(wanted.is_form_of(column) for column in known):
                known += columns_in(first.problem, member.effect, [wanted.shape], distortion)
    return replace(first, columns=columns)


def _share_left(first: Pass, step: Posterior) -> float:
    """Share of the gap of the model as configured that a pass begins with."""
    problem = first.problem
    left, gap = (max(p.of("no_gap").left_over - problem.quiet, 0.0) for p in (step, first.posterior))
    return left / gap if gap else 0.0


def _joined(first: Pass, before: Posterior, step: Posterior) -> Posterior:
    """Weigh what a pass says beside the causes before it; probabilities by the chain rule."""
    problem, base, weights = first.problem, before.best, first.problem.settings.weights
    # What re-tuned parameters gain beside the causes, these gain without a further one.
    spare = float(np.log(weights.prior_no_gap / weights.prior_parameters))
    gained = max(step.of("parameters").log_evidence - spare, 0.0)
    held_for_sure = replace(base, log_evidence=base.log_evidence + gained, left_over=step.of("no_gap").left_over)
    further = [_further(problem, base, h) for h in step.claims]
    gap = first.posterior.of("no_gap").left_over
    weighed_again = weigh_further(
        held_for_sure,
        further,
        step.of("unknown"),
        n_effects=len(problem.campaign.plant.effects),
        gap=gap,
        quiet=problem.quiet,
        weights=weights,
    )
    found = {h.name: h for h in before.hypotheses}
    asked, found[base.name] = base.probability, replace(base, probability=0.0)
    doubt = found["unknown"]
    if doubt.log_evidence < base.log_evidence:
        # It stands for what these causes leave, and that is weighed again.
        asked, found["unknown"] = asked + doubt.probability, replace(doubt, probability=0.0)
    likeliest = next((h for h in weighed_again if len(h.effects) > len(base.effects)), base)
    joint = _Joint(first, before, step, (*base.members, *likeliest.members))
    for h in weighed_again:
        share = asked * h.probability
        if len(h.effects) > len(base.effects):
            if h.probability > problem.settings.closing.least_probability or h is likeliest:
                joint.add_parts(found, h)
                new = joint.hypothesis(h.members, log_evidence=h.log_evidence)
                earlier = found[new.name].probability if new.name in found else 0.0
                found[new.name] = replace(new, probability=earlier + share)
        else:
            found[h.name] = replace(found[h.name], probability=found[h.name].probability + share)
    return _with_hypotheses(joint.posterior, list(found.values()))


def _further(problem: LinearProblem, base: Hypothesis, added: Hypothesis) -> Hypothesis:
    """Hypothesis of all effects, with the evidence of all; its members are not yet sized together."""
    members = sorted((*base.members, *added.members), key=lambda m: m.effect.name)
    weak = min(added.members, key=lambda m: m.gain)
    before = sum(m.contribution for m in members if m is not weak)
    shared = shared_energy(problem, np.asarray(before), weak.contribution)
    return replace(
        added, effects=tuple(m.effect.name for m in members), members=tuple(members), shared=shared,
        log_evidence=base.log_evidence + added.log_evidence, of_strokes=base.of_strokes + added.of_strokes,
    )  # fmt: skip


class _Joint:
    """States causes of several passes beside each other, on the model as configured.

    The form in which an effect was found alone has taken up what it can of the others: each is chosen again.
    """

    def __init__(self, first: Pass, before: Posterior, step: Posterior, members: Sequence[Explanation]) -> None:
        self._first = first
        carried = {m.effect.name for m in before.best.members}
        self._said = {**before.strokes, **{n: said for n, said in step.strokes.items() if n not in carried}}
        by_name = {m.effect.name: m for m in members}
        as_found = [_column(first, m) for m in by_name.values()]
        self._noise = noise_factor_beside(first.problem, stacked(as_found))
        self._noise = noise_factor_beside(first.problem, stacked(self._shaped(as_found)))
        self.posterior = replace(before, strokes=self._said, dispersion=self._noise)

    def hypothesis(self, members: Sequence[Explanation], *, log_evidence: float) -> Hypothesis:
        """Size members together, each in the form that is best beside the others."""
        columns = self._shaped([_column(self._first, m) for m in members])
        shaped = [replace(m, column=column, mixture=None) for m, column in zip(members, columns, strict=True)]
        problem = self._first.problem
        sized = together(problem, Marginal(with_noise(problem, self._noise)), shaped, dispersion=self._noise)
        return Hypothesis(
            effects=tuple(m.effect.name for m in members), log_evidence=log_evidence, is_fitted_together=True,
            members=tuple(sized_by_strokes(m, self._said) for m in sized),
        )  # fmt: skip

    def add_parts(self, found: dict[str, Hypothesis], whole: Hypothesis) -> None:
        """Add what is left of a hypothesis without some of its effects, which nobody believes yet."""
        members = {m.effect.name: m for m in whole.members}
        for count in range(1, len(members)):
            for names in combinations(whole.effects, count):
                if _name_of(names) not in found:
                    part = self.hypothesis([members[name] for name in names], log_evidence=0.0)
                    found[part.name] = replace(part, probability=0.0)

    def _shaped(self, columns: Sequence[Column]) -> list[Column]:
        """Choose the form of one effect after the other beside the rest, but for those that single strokes carry."""
        problem, noise, chosen = self._first.problem, self._noise, list(columns)
        alone = Marginal(with_noise(problem, noise))
        free = [k for k, c in enumerate(columns) if len(columns) > 1 and not self._is_by_strokes(c.effect.name)]
        for _ in range(problem.settings.closing.rounds):
            before = list(chosen)
            for k in free:
                name = chosen[k].effect.name
                others = stacked([*chosen[:k], *chosen[k + 1 :]])
                marginal = alone.beside(stacked_with_noise(problem, [others], noise))
                named = [c.effect.name for c in columns]
                entries = forms_beside(self._first.columns[name], named)
                entries = columns_with_noise(problem, {name: entries}, noise)[name]
                found = explain(marginal, entries)
                chosen[k] = chosen[k] if found is None else _column(self._first, found)
            if all(one is other for one, other in zip(chosen, before, strict=True)):
                break
        return chosen

    def _is_by_strokes(self, name: str) -> bool:
        return name in self._said and self._said[name].beside_cutting > 0.0


def _name_of(effects: Iterable[str]) -> str:
    return AND.join(sorted(effects))


def _column(first: Pass, member: Explanation) -> Column:
    """Return the signature of a member's form on the model as configured."""
    return next(c for c in first.columns[member.effect.name] if c.is_form_of(member.column))


def _is_within_noise(answer: Pass) -> bool:
    rungs, share = answer.predictions.of(answer.posterior.best).ladder.whitened, answer.problem.settings.closing
    return rungs.with_effect**2 <= (1.0 + share.within_noise) * rungs.noise_floor**2


def _rungs(answer: Pass, named: Mapping[str, tuple[int, float]]) -> tuple[CauseRung, ...]:
    """Climb from re-tuned parameters to all causes, in the order in which they were named; the larger of two first."""
    posterior, best = answer.posterior, answer.posterior.best
    if not best.effects:
        return ()
    by_trial = answer.predictions.of(best).ladder.held_out == "trials"
    where = equations_of(answer.problem, best.members)

    def ladder(effects: Sequence[str]) -> Ladder:
        chosen = next(h for h in posterior.claims if h.name == _name_of(effects))
        return answer.predictions.of(chosen, by_trial=by_trial).ladder

    order: list[str] = []
    rungs = []
    while len(order) < len(best.effects):
        rest = [name for name in best.effects if name not in order]
        first = min(named[name][0] for name in rest)
        after = {name: ladder([*order, name]) for name in rest if named[name][0] == first}
        name = min(after, key=lambda name: float(after[name].energy["with_effect"].sum()))
        energy = after[name].energy_in(where)
        before = ladder(order).energy_in(where)["with_effect"] if order else energy["retuned"]
        closed, interval = closed_share(energy)
        added, of_added = closed_share({**energy, "retuned": before})
        order.append(name)
        rungs.append(
            CauseRung(
                effect=name,
                number=first,
                probability=named[name][1],
                with_effect=after[name].whitened.with_effect,
                closed=closed,
                closed_ci95=interval,
                added=added,
                added_ci95=of_added,
            )
        )
    return tuple(rungs)
