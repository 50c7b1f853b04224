"""From log evidences to probabilities that hold: tempering, the price of a further cause, and the open set.

Log evidences of whitened features are far too sure: the noise is not exactly Gaussian and no form is exactly
nature's. They are divided by a temperature. "Unknown" gains where the best hypothesis leaves a large share of the
gap. The constants are few and shared by all effects: `settings.Weights`.
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
    each = (1.0 - w.prior_no_gap - w.prior_parameters - w.prior_unknown) / max(n_effects, 1)
    priors = {"no_gap": w.prior_no_gap, "parameters": w.prior_parameters}
    score = {
        h: float(np.log(priors.get(h.name, each))) + h.log_evidence / w.temperature
        for h in hypotheses
        if h is not unknown and len(h.effects) < 2
    }
    _share_with_further(score, hypotheses, w)
    score[unknown] = _open_score(score, unknown, gap=no_gap.left_over, quiet=quiet, w=w)
    return _normalised(score)


def weigh_further(
    base: Hypothesis,
    further: Sequence[Hypothesis],
    unknown: Hypothesis,
    *,
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
    _share_with_further(score, further, weights)
    score[unknown] = _open_score(score, unknown, gap=gap, quiet=quiet, w=weights)
    return _normalised(score)


def among(
    base: Hypothesis, further: Sequence[Hypothesis], *, weights: Weights = SETTINGS.weights
) -> tuple[Hypothesis, ...]:
    """Turn log evidences into probabilities of effects alone and with one further effect each, and nothing else.

    Parameters
    ----------
    base : Hypothesis
    further : sequence of Hypothesis
        The same effects and another one.
    weights : Weights

    Returns
    -------
    tuple of Hypothesis
        With `probability`, most likely first; they sum to 1.
    """
    score = {base: 0.0}
    _share_with_further(score, further, weights)
    return _normalised(score)


def _open_score(score: dict[Hypothesis, float], unknown: Hypothesis, *, gap: float, quiet: float, w: Weights) -> float:
    """Score of "unknown": by its evidence, and by the share of the gap that the best of the others leaves."""
    best = max((h for h in score if np.isfinite(h.left_over)), key=lambda h: score[h])
    left = max(best.left_over - w.left_by_an_intact_machine * quiet, 0.0)
    share = (left + w.floor_left) / (max(gap - best.left_over, 0.0) + left + w.floor_gap)
    by_share = score[best] + w.open_gain * float(np.log(share / w.open_share))
    return max(float(np.log(w.prior_unknown)) + unknown.log_evidence / w.temperature, by_share)


def _share_with_further(score: dict[Hypothesis, float], hypotheses: Sequence[Hypothesis], w: Weights) -> None:
    """Split what effects are given between them alone and with one further effect, from one to two and so on.

    A further effect always adds some evidence, because no form is exact: its log Bayes factor is counted in e-folds,
    not in nats. Against all other causes all together stand with all their evidence.
    """
    for size in range(2, 1 + max((len(h.effects) for h in hypotheses), default=0)):
        families: dict[Hypothesis, list[Hypothesis]] = {}
        for h in hypotheses:
            if len(h.effects) == size:
                fewer = [p for p in score if len(p.effects) == size - 1 and set(p.effects) < set(h.effects)]
                if fewer:
                    families.setdefault(max(fewer, key=lambda p: p.log_evidence), []).append(h)
        for stronger, family in families.items():
            _share_within(score, stronger, family, w)


def _share_within(
    score: dict[Hypothesis, float], stronger: Hypothesis, family: Sequence[Hypothesis], w: Weights
) -> None:
    alone = stronger.log_evidence
    added = np.array([h.log_evidence - alone for h in family])
    common = np.array([h.shared for h in family])
    even = w.pair_least + w.pair_share * np.sqrt(common * max(alone, 0.0))
    odds = w.pair_gain * float(np.log(max(float(np.max(added / even)), w.least_added)))
    # As far as the further one is believed: one that is not must not raise the first.
    believed = -float(np.logaddexp(0.0, -odds))
    total = score[stronger] + np.exp(believed) * max(float(added.max()), 0.0) / w.temperature
    score[stronger] = total - float(np.logaddexp(0.0, odds))
    among = added / w.temperature + w.pair_gain * np.log(np.maximum(added / even, w.least_added))
    among -= np.logaddexp.reduce(among)
    for h, share in zip(family, among, strict=True):
        score[h] = total + believed + float(share)


def _normalised(score: dict[Hypothesis, float]) -> tuple[Hypothesis, ...]:
    top = max(score.values())
    weight = {h: float(np.exp(max(value - top, -700.0))) for h, value in score.items()}
    total = sum(weight.values())
    found = (replace(h, probability=value / total) for h, value in weight.items())
    return tuple(sorted(found, key=lambda h: -h.probability))
