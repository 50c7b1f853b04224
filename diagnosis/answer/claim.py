"""What may be declared: causes whose magnitude is there and which predict what was withheld.

Evidence alone finds the best name for whatever is in the data, a sensor's wandering zero too. What predicts no withheld
data has no evidence. So the magnitude of every effect of a declared cause differs from zero in its own 95 % interval,
the cause closes a tenth at least of the withheld gap where it acts, and so does each of several effects of what the
others leave where it acts: where a hundredth is added and the rest stays unexplained, what explains the rest may well
explain the hundredth. Where a little of the effects that are not named explains the rest, it adds most of what that
leaves. Where half of what is left without an effect would be no gap, it closes more than half of what a little of the
other effects does not explain: if the rest is no gap, all of it may be none. Nor may the simulated model with the cause
miss the withheld channels by more than the re-tuned one does: two effects of one sensor that cancel in the harmonics
compared need not cancel in the signal that they predict. What a claim leaves where it acts, beyond a little of the
other effects, goes to "unknown" (`unlisted.py`). Where the answer is "unknown" for a law that is not in the catalogue,
that law must close a tenth too, and in a size that every machine may have only of a gap beyond what an intact machine
leaves.
Where the single strokes carry an effect, mean strokes hold little of what it closes: the report says so instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.answer.ladder import Ladder, Rung
from sawbench.diagnosis.answer.prediction import Predictions
from sawbench.diagnosis.answer.unlisted import leaves_a_gap, odds_of_unlisted, times_an_intact
from sawbench.diagnosis.inference.acts_in import acts_in, equations_of
from sawbench.diagnosis.inference.dispersion import background_with_noise, stacked_with_noise, with_noise
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import Posterior
from sawbench.diagnosis.inference.retuning import Retuning
from sawbench.diagnosis.inference.settings import SETTINGS, Z95, Forms, Settings
from sawbench.diagnosis.inference.stroke_evidence import StrokesSay
from sawbench.diagnosis.inference.weighing import among, prior_odds_of_one, weigh
from sawbench.diagnosis.standard_error import exceeds_its_error
from sawbench.modeling.residuals import Equation

# Of a magnitude that is there against none, at which none is outside of a 95 % interval.
_LOG_ODDS95: Final = float(np.log(0.975 / 0.025))
# A size that is read off a free wave is right to this factor.
_RIGHT_TO: Final = 2.0


def held_to_predictions(problem: LinearProblem, posterior: Posterior, predictions: Predictions) -> Posterior:
    """Move the probability of claims that predict nothing to what is left without them, until the likeliest holds.

    Parameters
    ----------
    problem : LinearProblem
    posterior : Posterior
    predictions : Predictions

    Returns
    -------
    Posterior
        Of an effect that fails, the probability goes to the cause without it, alone or with another effect instead; of
        a single one, to it beside another effect as far as that is believed, and to the answers that name no effect; as
        they stand among themselves.
    """
    kept = _those_that_hold(problem, posterior, predictions)
    shared = _shared_with_unlisted(problem, kept, predictions)
    return _those_that_hold(problem, shared, predictions)


def _those_that_hold(problem: LinearProblem, posterior: Posterior, predictions: Predictions) -> Posterior:
    while True:
        failing = _failing(problem, posterior, predictions) if posterior.best.effects else None
        if failing is not None:
            posterior = _without(problem, posterior, failing)
        elif _rests_on_a_law_that_fails(problem, posterior, predictions):
            posterior = _without_law(problem, posterior)
        else:
            tried = _with_background(problem, posterior, predictions)
            if tried is None:
                return posterior
            posterior = _without(problem, *tried)


def _shared_with_unlisted(problem: LinearProblem, posterior: Posterior, predictions: Predictions) -> Posterior:
    """Share what claims have among them and "unknown", by what each leaves where it acts.

    Only what the correct claim leaves is small: of the others, and where none is correct, it may be anything. A claim
    that rests on single strokes alone is not judged by mean strokes.
    """
    odds: dict[Hypothesis, float] = {}
    for claim in posterior.claims:
        carried = carried_by_strokes(posterior, claim)
        in_means = [m for m in claim.members if m.effect.name not in carried]
        if claim.probability > problem.settings.report.shown_probability and in_means:
            ladder, equations = predictions.beyond_a_little(claim), equations_of(problem, in_means)
            odds[claim] = odds_of_unlisted(ladder, equations, quiet=problem.quiet, weights=problem.settings.weights)
    shared = sum(claim.probability for claim in odds)
    likely = {claim.name: claim.probability / of_unlisted for claim, of_unlisted in odds.items()}
    total = sum(likely.values()) + shared
    probabilities = {h.name: float(h.probability) for h in posterior.hypotheses}
    probabilities |= {name: shared * value / total for name, value in likely.items()}
    if odds:
        probabilities["unknown"] += shared * shared / total
    return _with_probabilities(posterior, probabilities)


def carried_by_strokes(posterior: Posterior, hypothesis: Hypothesis) -> list[str]:
    """Effects of a hypothesis that the single strokes show."""
    said = posterior.strokes
    return [name for name in hypothesis.effects if name in said and said[name].beside_cutting > 0.0]


def is_there(member: Explanation, said: StrokesSay | None = None) -> bool:
    """Whether the magnitude differs, in its 95 % interval, from the number that stands where there is no effect.

    Of a trend that single strokes carry all magnitudes weighed are above 0, and its forms state them differently: the
    interval is without 0 also where 0 has less than 2.5 % against all of them. A number of the form, a stiffness, says
    nothing where hardly any of the form is there.

    Parameters
    ----------
    member : Explanation
    said : StrokesSay, optional
        What the single strokes say of the effect, where they carry it.
    """
    if said is not None and said.is_trend and said.beside_cutting > _LOG_ODDS95:
        return True
    is_form_there = not member.effect.carries or member.amplitude > Z95 * member.amplitude_std
    return is_form_there and abs(member.strength - member.absent) > Z95 * member.strength_std


def is_background(member: Explanation, *, least: bool = False, forms: Forms = SETTINGS.forms) -> bool:
    """Whether the magnitude is one that machines may have: far below the typical one, or what every machine has."""
    size, _ = member.in_typical_sizes
    return abs(size) < (forms.least_amplitude if least else forms.background_amplitude)


def _failing(problem: LinearProblem, posterior: Posterior, predictions: Predictions) -> Explanation | None:
    """Effect of the likeliest hypothesis that must not be declared, with its magnitude; None where all may.

    Of several, one that is too small for a cause goes first, then the one that adds least: what is there a little on
    every machine must not take the place of a cause.
    """
    best = posterior.best
    carried = carried_by_strokes(posterior, best)
    in_means = tuple(name for name in best.effects if name not in carried)
    # Those that mean strokes show close the gap alone, or beside the others: strokes may carry what means show too.
    closes = bool(in_means) and any(
        _predicts(problem, predictions, cause) for cause in (_found(posterior, in_means), best)
    )
    is_alone = len(best.effects) == 1
    failing: list[tuple[bool, float, Explanation]] = []
    for member in predictions.sized(best):
        name = member.effect.name
        added, left = _added(problem, posterior, predictions, member)
        is_worth = added.sum() > problem.settings.ladder.least_added * left
        is_worth = is_worth or (not is_alone and _is_most_beside_a_little(problem, posterior, predictions, member))
        is_worth = is_worth and _is_more_than_usual(problem, posterior, predictions, member)
        is_worth = is_worth and (is_alone or _is_sure(added))
        predicts = name in carried or (closes and is_worth)
        is_enough = is_cause(problem, posterior, predictions, member, by_strokes=name in carried)
        said = posterior.strokes.get(name) if name in carried else None
        if not (predicts and is_enough and is_there(member, said)):
            failing.append((is_enough, float(added.sum()), member))
    return min(failing, key=lambda each: each[:2])[2] if failing else None


def _with_background(
    problem: LinearProblem, posterior: Posterior, predictions: Predictions
) -> tuple[Posterior, Explanation] | None:
    """A claim of the likeliest cause and of another effect that is only background, as if likeliest; that effect."""
    best, least = posterior.best, problem.settings.report.shown_probability
    for claim in posterior.claims if best.effects else ():
        further = next((name for name in claim.effects if claim.without(name) == best.effects), None)
        if further is None or claim.probability <= least:
            continue
        tried = replace(posterior, hypotheses=(claim, *(h for h in posterior.hypotheses if h is not claim)))
        member = next(m for m in predictions.sized(claim) if m.effect.name == further)
        by_strokes = further in carried_by_strokes(tried, claim)
        if not is_cause(problem, tried, predictions, member, by_strokes=by_strokes):
            return tried, member
    return None


def is_cause(
    problem: LinearProblem, posterior: Posterior, predictions: Predictions, member: Explanation, *, by_strokes: bool
) -> bool:
    """Whether an effect is more than what every machine has, or alone most of a gap.

    A machine has a little of many effects: what is no more than every one has is no cause, and beside a cause, what is
    small is one of those. A wave of any form explains all that is fixed in angle, and a trend of single strokes alone
    all that drifts: where that is larger than the effect ever is, it is something else. Of an effect whose number
    belongs to its form and may be any (a frequency), how much of the form is there says no more.
    """
    forms, is_alone = problem.settings.forms, len(posterior.best.effects) == 1
    is_wave = member.effect.size_of is not None
    if is_background(member, least=True, forms=forms):
        return False
    if is_wave and member.in_typical_sizes[0] > _RIGHT_TO * member.effect.strength.high:
        return False
    has_size = by_strokes or not member.effect.carries or member.effect.strength.usual is not None
    if is_wave or (by_strokes and is_alone) or not has_size or not is_background(member, forms=forms):
        return True
    return is_alone and is_most_of_a_gap(problem, posterior, predictions, member)


def is_most_of_a_gap(
    problem: LinearProblem, posterior: Posterior, predictions: Predictions, member: Explanation
) -> bool:
    """Whether the model without the only effect of the likeliest hypothesis leaves a gap where that acts, most by it.

    What background effects explain is no gap.
    """
    if _is_quiet(problem, posterior):
        return False
    ladder, weights = predictions.of(posterior.best).ladder, problem.settings.weights
    if not leaves_a_gap(ladder, acts_in(problem, member), rung="retuned", quiet=problem.quiet, weights=weights):
        return False
    added, left = _added(problem, posterior, predictions, member)
    return float(added.sum()) > problem.settings.ladder.most_of_a_gap * left


def _is_more_than_usual(
    problem: LinearProblem, posterior: Posterior, predictions: Predictions, member: Explanation
) -> bool:  # fmt: skip
    """Whether the likeliest hypothesis leaves a clear gap without an effect, or the effect removes most of what it is.

    What is hardly a gap may be a little of many effects, which no hypothesis names: that is taken off first. Of a
    larger gap, what remains counts against the claim by itself; see `odds_of_unlisted`.
    """
    most = problem.settings.ladder.most_of_a_gap
    _, fewer, rung = _with_and_without(posterior, predictions, member)
    left = times_an_intact(
        fewer, acts_in(problem, member), rung=rung, quiet=problem.quiet, weights=problem.settings.weights
    )  # fmt: skip
    return (1.0 - most) * left > 1.0 or _is_most_beside_a_little(problem, posterior, predictions, member)


def _is_most_beside_a_little(
    problem: LinearProblem, posterior: Posterior, predictions: Predictions, member: Explanation
) -> bool:
    """Whether an effect adds most of what the others leave where it acts, once a little of other effects is off."""
    added, rest = _added(problem, posterior, predictions, member, beside_a_little=True)
    return bool(added.sum() > problem.settings.ladder.most_of_a_gap * rest)


def _is_quiet(problem: LinearProblem, posterior: Posterior) -> bool:
    """Whether the model without any effect leaves no more than an intact machine."""
    return posterior.of("no_gap").left_over <= problem.quiet


def _predicts(problem: LinearProblem, predictions: Predictions, cause: Hypothesis) -> bool:
    """Whether a cause closes the withheld gap, and its model does not surely miss the channels by more than without."""
    ladder = predictions.of(cause).ladder
    if not _closes(ladder, equations_of(problem, cause.members), problem.settings):
        return False
    channels, forms = predictions.channels_of(cause), problem.campaign.plant.equations
    unseen = {form.channel for form in forms.values()} - {forms[equation].channel for equation in ladder.n_features}
    if channels is None:
        return True
    harm = channels.harm(unseen)
    return not (harm.sum() >= problem.settings.ladder.most_harm and _is_sure(harm))


def _closes(ladder: Ladder, equations: Sequence[Equation], settings: Settings = SETTINGS) -> bool:
    """Whether a cause closes the withheld gap in the equations where it acts, beyond doubt.

    It does where the 95 % interval lies above 0, and where no withheld operating point is predicted worse than the
    gap can be stated, or than by chance, or all of them together by less than a tenth of what the others gain: of a
    few points, or of unequal ones, the interval says little. What leaves nearly all of the gap unexplained there is no
    cause of it: what explains the rest may well explain that little.
    """
    if ladder.held_out == "nothing":
        return True  # the report says that nothing could be withheld
    energy = {name: ladder.by_group(values) for name, values in ladder.energy_in(equations).items()}
    numbers = settings.ladder
    worse = energy["with_effect"] - energy["retuned"]
    allowed = np.maximum(numbers.least_rest * energy["noise_floor"], numbers.by_chance)
    lost, gained = float(worse[worse > allowed].sum()), -float(worse[worse < 0.0].sum())
    hardly_loses = len(worse) > 1 and lost <= numbers.least_added * gained
    closed, (low, _) = ladder.closed_in(equations)
    return closed > numbers.least_added and (low > 0.0 or hardly_loses)


def _added(
    problem: LinearProblem,
    posterior: Posterior,
    predictions: Predictions,
    member: Explanation,
    *,
    beside_a_little: bool = False,
) -> tuple[Floats, float]:
    """What an effect of the likeliest hypothesis adds to what the others predict, and what these leave to be added.

    Log probability of each withheld group, and of what the others leave above the noise, both in the equations where
    the effect acts: what it gains elsewhere is not its, nor is what stays unexplained there. Of several effects numbers
    of the plant take the place of one only where the data are likelier with these numbers wrong than with the effect.
    `beside_a_little`: for data off which a little of the effects that the hypothesis does not name is taken.
    """
    equations = acts_in(problem, member)
    whole, fewer, rung = _with_and_without(posterior, predictions, member, beside_a_little=beside_a_little)
    without = fewer.by_group(fewer.energy_in(equations)[rung])
    with_it = whole.by_group(whole.energy_in(equations)["with_effect"])
    return 0.5 * (without - with_it), 0.5 * fewer.left_in(equations, rung=rung)


def _with_and_without(
    posterior: Posterior, predictions: Predictions, member: Explanation, *, beside_a_little: bool = False
) -> tuple[Ladder, Ladder, Rung]:
    """Ladder of the likeliest hypothesis, that without one of its effects, and the rung there that has not got it."""
    best = posterior.best
    rest = best.without(member.effect.name)

    def ladder(hypothesis: Hypothesis, **withheld: Any) -> Ladder:
        if beside_a_little:
            return predictions.beside_a_little(hypothesis, best, **withheld)
        return predictions.of(hypothesis, **withheld).ladder

    if not rest:
        alone = ladder(best)
        return alone, alone, "retuned"
    others = _found(posterior, rest)
    freed = predictions.freed_instead(others, best.log_evidence - others.log_evidence)
    whole = ladder(best, freed=freed)
    return whole, ladder(others, by_trial=whole.held_out == "trials", freed=freed), "with_effect"


def _is_sure(gains: Floats) -> bool:
    """Whether the sum of gains exceeds its own standard error, or one group says all.

    Groups differ by orders of magnitude in what they say of an effect, too much for an interval.
    """
    return len(gains) < 2 or exceeds_its_error(gains)


def _rests_on_a_law_that_fails(problem: LinearProblem, posterior: Posterior, predictions: Predictions) -> bool:
    """Whether the answer is "unknown" for a law beyond the catalogue that closes no gap.

    It does not close the withheld one, or there is none beyond what an intact machine leaves and the law has a size
    that every machine may have.
    """
    laws = {law.name: law for law in problem.campaign.plant.beyond_catalogue}
    if posterior.best.other != "unknown" or posterior.resembles not in laws:
        return False
    found = predictions.of_law(laws[posterior.resembles])
    if found is None or not _closes(found.ladder, acts_in(problem, found.member), problem.settings):
        return True
    return is_background(found.member, forms=problem.settings.forms) and _is_quiet(problem, posterior)


def _without_law(problem: LinearProblem, posterior: Posterior) -> Posterior:
    """Take the law that "unknown" rests on out: it has the evidence of what else it looks like."""
    unlisted = {text: value for text, value in posterior.unlisted.items() if text != posterior.resembles}
    unknown = replace(posterior.of("unknown"), log_evidence=max(unlisted.values()))
    others = [posterior.of("no_gap"), posterior.of("parameters"), unknown]
    weighed = weigh(others, n_effects=1, quiet=problem.quiet, weights=problem.settings.weights)
    to = {h.name: h.probability for h in weighed}
    rest = posterior.of("no_gap").probability * to["unknown"] / to["no_gap"]
    found = {h.name: rest if h.name == "unknown" else h.probability for h in posterior.hypotheses}
    total = sum(found.values())
    hypotheses = tuple(unknown if h.name == "unknown" else h for h in posterior.hypotheses)
    return _with_probabilities(
        replace(posterior, unlisted=unlisted, hypotheses=hypotheses), {name: p / total for name, p in found.items()}
    )


def _found(posterior: Posterior, effects: tuple[str, ...]) -> Hypothesis:
    return next(h for h in posterior.claims if h.effects == effects)


def _without(problem: LinearProblem, posterior: Posterior, member: Explanation) -> Posterior:
    """Take one effect out of the likeliest hypothesis, and hand its probability to the rest, alone or with another.

    Of an effect of background size all goes to the rest alone: beside a little of it there is no evidence for another.
    A single effect that fails may still be there beside another one, as far as that is believed; what remains goes to
    the answers that name no effect. What predicts nothing has no evidence: beside "no gap" it keeps its prior odds. Of
    a single one of which every machine has as much, all goes to "no gap" and "parameters": that is a machine which has
    a little of it, and whose parameters are right or wrong.
    """
    best, weights = posterior.best, problem.settings.weights
    n_effects = len(problem.campaign.plant.effects)
    rest = best.without(member.effect.name)
    if rest and is_background(member, forms=problem.settings.forms):
        to = {_found(posterior, rest).name: 1.0}
    elif rest:
        instead = [h for h in posterior.claims if h is not best and h.probability > 0.0 and _extends(h, rest, best)]
        weighed = among(_found(posterior, rest), instead, n_effects=n_effects, weights=weights)
        to = {h.name: h.probability for h in weighed}
    elif is_background(member, least=True, forms=problem.settings.forms):
        to = _without_naming(problem, posterior, member)
    else:
        others = [h for h in posterior.hypotheses if h.other is not None]
        weighed = weigh(others, n_effects=1, quiet=problem.quiet, weights=weights)
        pairs = {h.name: h.probability for h in posterior.claims if set(best.effects) < set(h.effects)}
        all_of_it = best.probability + sum(pairs.values())
        alone = {h.name: float(h.probability) for h in weighed}
        alone[best.name] = prior_odds_of_one(n_effects, weights) * alone["no_gap"]
        whole = sum(alone.values()) * all_of_it / best.probability
        to = {name: probability / whole for name, probability in alone.items()}
        to |= {pair: probability / all_of_it for pair, probability in pairs.items()}
    return _with_probabilities(
        posterior,
        {
            h.name: (0.0 if h is best else h.probability) + best.probability * to.get(h.name, 0.0)
            for h in posterior.hypotheses
        },
    )


def _without_naming(problem: LinearProblem, posterior: Posterior, member: Explanation) -> dict[str, float]:
    """Probabilities of "no gap" and "parameters" beside an effect of which every machine has as much."""
    variance, weights = posterior.dispersion, problem.settings.weights
    of_it = stacked_with_noise(problem, [member.column.of_any_size], variance)
    noisy = with_noise(problem, variance)
    nominal = Marginal(noisy, extra=background_with_noise(posterior.little, variance)).beside(of_it)
    log_odds = Retuning(noisy, nominal).log_evidence + np.log(weights.prior_parameters / weights.prior_no_gap)
    wrong = float(np.exp(-np.logaddexp(0.0, -log_odds)))
    return {"parameters": wrong, "no_gap": 1.0 - wrong}


def _with_probabilities(posterior: Posterior, probabilities: Mapping[str, float]) -> Posterior:
    moved = [replace(h, probability=probabilities[h.name]) for h in posterior.hypotheses]
    return replace(posterior, hypotheses=tuple(sorted(moved, key=lambda h: -h.probability)))


def _extends(hypothesis: Hypothesis, rest: tuple[str, ...], best: Hypothesis) -> bool:
    """Whether a hypothesis holds the rest and one other effect instead of that which is taken out of the best."""
    return len(hypothesis.effects) == len(best.effects) and set(rest) < set(hypothesis.effects)
