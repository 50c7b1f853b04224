"""From log evidences to probabilities that hold: the price of a further cause, and the open set.

What makes evidence too sure, noise that is not as modelled and forms that are not nature's, is in the evidence already:
the noise is scaled to what the best cause leaves, and every form may miss a share. "Unknown" gains where the best
hypothesis leaves a large share of the gap. The numbers are few and shared by all effects: `settings.Weights`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.settings import SETTINGS, Weights


def weigh(
    hypotheses: Sequence[Hypothesis],
    *,
    n_effects: int,
    gap: float | None = None,
    quiet: float = SETTINGS.weights.quiet,
    weights: Weights = SETTINGS.weights,
) -> tuple[Hypothesis, ...]:
    """Turn log evidences into probabilities.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        "no_gap", "parameters" and "unknown" among them.
    n_effects : int
        Size of the catalogue, for the priors.
    gap : float, optional
        `left_over` of the model without any effect: what remains is a share of that. That of "no_gap", unless the model
        has effects.
    quiet : float
        Whitened misfit over features that an intact machine leaves on this bench.
    weights : Weights

    Returns
    -------
    tuple of Hypothesis
        With `probability`, most likely first; they sum to 1.
    """
    w = weights
    of = {(h.effects, h.other): h for h in hypotheses}
    no_gap, unknown = of[(), "no_gap"], of[(), "unknown"]
    each = prior_odds_of_one(n_effects, w) * w.prior_no_gap
    priors = {"no_gap": w.prior_no_gap, "parameters": w.prior_parameters}
    score = {
        h: float(np.log(priors.get(h.name, each)))
        + h.log_evidence
        - (gained_by_none(h.of_means, w) if h.effects else 0.0)
        for h in hypotheses
        if h is not unknown and len(h.effects) < 2
    }
    _share_with_further(score, hypotheses, n_effects, w)
    score[unknown] = _open_score(score, unknown, gap=no_gap.left_over if gap is None else gap, quiet=quiet, w=w)
    return _normalised(score)


def weigh_further(
    base: Hypothesis,
    further: Sequence[Hypothesis],
    unknown: Hypothesis,
    *,
    n_effects: int,
    gap: float,
    quiet: float = SETTINGS.weights.quiet,
    weights: Weights = SETTINGS.weights,
) -> tuple[Hypothesis, ...]:
    """Turn log evidences of further effects beside certain ones into probabilities, by the same rules as `weigh`.

    Parameters
    ----------
    base : Hypothesis
        The effects that are held for certain, which stand for "no gap" and "parameters" beside them too. Its log
        evidence is all that they have: what their forms may miss grows with it.
    further : sequence of Hypothesis
        The same effects and one or more others, with the log evidence of all.
    unknown : Hypothesis
        Its log evidence is against that of `base`.
    n_effects : int
        Size of the catalogue: among so many a further effect is chosen.
    gap : float
        `left_over` of the model without any effect: what remains is a share of that.
    quiet : float
    weights : Weights

    Returns
    -------
    tuple of Hypothesis
        With `probability`, most likely first; they sum to 1.
    """
    score = {base: float(np.log(weights.prior_no_gap))}
    _share_with_further(score, further, n_effects, weights)
    score[unknown] = _open_score(score, unknown, gap=gap, quiet=quiet, w=weights)
    return _normalised(score)


def among(
    base: Hypothesis, further: Sequence[Hypothesis], *, n_effects: int, weights: Weights = SETTINGS.weights
) -> tuple[Hypothesis, ...]:
    """Turn log evidences into probabilities of effects alone and with one further effect each, and nothing else.

    Parameters
    ----------
    base : Hypothesis
    further : sequence of Hypothesis
        The same effects and another one.
    n_effects : int
        Size of the catalogue: among so many a further effect is chosen.
    weights : Weights

    Returns
    -------
    tuple of Hypothesis
        With `probability`, most likely first; they sum to 1.
    """
    score = {base: 0.0}
    _share_with_further(score, further, n_effects, weights)
    return _normalised(score)


def _open_score(score: dict[Hypothesis, float], unknown: Hypothesis, *, gap: float, quiet: float, w: Weights) -> float:
    """Score of "unknown": by its evidence, or as the best of the others leaves of the gap to what it explains."""
    best = max((h for h in score if np.isfinite(h.left_over)), key=lambda h: score[h])
    left = max(best.left_over - quiet, 0.0)
    odds = (left + w.floor_left) / (max(gap - best.left_over, 0.0) + w.floor_gap)
    return max(float(np.log(w.prior_unknown)) + unknown.log_evidence, score[best] + float(np.log(odds)))


def prior_odds_of_one(n_effects: int, weights: Weights = SETTINGS.weights) -> float:
    """Odds that a certain one of so many effects is there against "no gap", before any evidence."""
    of_effects = 1.0 - weights.prior_no_gap - weights.prior_parameters - weights.prior_unknown
    return of_effects / max(n_effects, 1) / weights.prior_no_gap


def worth_of_a_choice(n_effects: int) -> float:
    """Log evidence that the best of so many effects has to add, for having been chosen among them."""
    return float(np.log(max(n_effects, 2)))


def gained_by_none(of_means: float, weights: Weights = SETTINGS.weights) -> float:
    """Of the log evidence in mean strokes, what the likeliest effect or law has there on a machine without any."""
    return min(max(of_means, 0.0), weights.gained_by_none)


def odds_of_further(
    together: Hypothesis, stronger: Hypothesis, n_effects: int, weights: Weights = SETTINGS.weights
) -> float:
    """Odds that a further effect is there, before its evidence against all other causes counts.

    They are the log evidence that it adds over that at which it is even. It pays for the choice, and in mean strokes
    also for what the likeliest of all effects gains there on a machine that has none, and for the scatter of the log
    evidence that the stronger effects have there, where both act: the form of a strong effect misses more. What single
    strokes add no form misses.

    Parameters
    ----------
    together : Hypothesis
        The stronger effects and the further one.
    stronger : Hypothesis
    n_effects : int
        Size of the catalogue.
    weights : Weights
    """
    choice, missed = worth_of_a_choice(n_effects), missed_by(stronger, together)
    in_means = together.of_means - stronger.of_means
    in_strokes = together.of_strokes - stronger.of_strokes
    even = choice + weights.gained_by_none + missed
    return (min(in_means, 0.0) + in_strokes) / choice + max(in_means, 0.0) / even


def missed_by(stronger: Hypothesis, together: Hypothesis) -> float:
    """Standard deviation of the log evidence that a further effect has for what the stronger ones' form misses.

    Parameters
    ----------
    stronger : Hypothesis
    together : Hypothesis
        The stronger effects and the further one.
    """
    return float(np.sqrt(together.shared * max(stronger.of_means, 0.0)))


def _share_with_further(
    score: dict[Hypothesis, float], hypotheses: Sequence[Hypothesis], n_effects: int, w: Weights
) -> None:
    """Split what effects are given between them alone and with one further effect, from one to two and so on.

    A further effect always adds some evidence, because no form is exact: its odds are those of `odds_of_further`.
    Against all other causes all together stand with all their evidence.
    """
    for size in range(2, 1 + max((len(h.effects) for h in hypotheses), default=0)):
        families: dict[Hypothesis, list[Hypothesis]] = {}
        for h in hypotheses:
            if len(h.effects) == size:
                fewer = [p for p in score if len(p.effects) == size - 1 and set(p.effects) < set(h.effects)]
                if fewer:
                    families.setdefault(max(fewer, key=lambda p: p.log_evidence), []).append(h)
        for stronger, family in families.items():
            _share_within(score, stronger, family, n_effects, w)


def _share_within(
    score: dict[Hypothesis, float], stronger: Hypothesis, family: Sequence[Hypothesis], n_effects: int, w: Weights
) -> None:
    added = np.array([h.log_evidence - stronger.log_evidence for h in family])
    log_odds = np.log(np.maximum([odds_of_further(h, stronger, n_effects, w) for h in family], w.least_added))
    odds = float(log_odds.max())
    # As far as the further one is believed: one that is not must not raise the first.
    believed = -float(np.logaddexp(0.0, -odds))
    total = score[stronger] + np.exp(believed) * max(float(added.max()), 0.0)
    score[stronger] = total - float(np.logaddexp(0.0, odds))
    # What mends the form of a strong one may explain more than a true one that acts where the strong one does not: only
    # evidence beyond that is compared, and where there is none the odds of each alone.
    among = np.maximum(added - np.array([missed_by(stronger, h) for h in family]), 0.0) + log_odds
    among -= np.logaddexp.reduce(among)
    for h, share in zip(family, among, strict=True):
        score[h] = total + believed + float(share)


def _normalised(score: dict[Hypothesis, float]) -> tuple[Hypothesis, ...]:
    top = max(score.values())
    weight = {h: float(np.exp(max(value - top, -700.0))) for h, value in score.items()}
    total = sum(weight.values())
    found = (replace(h, probability=value / total) for h, value in weight.items())
    return tuple(sorted(found, key=lambda h: -h.probability))
