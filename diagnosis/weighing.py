"""From log evidences to probabilities that hold: tempering, the price of a second cause, and the open set.

Log evidences of whitened features are far too sure: the noise is not exactly Gaussian and no form is exactly
nature's. They are divided by a temperature. "Unknown" gains where the best hypothesis leaves a large share of the
gap. The constants are few and shared by all effects. They are fitted by maximum likelihood on development campaigns
(`benchmarks/calibrate_diagnosis.py`), but for the temperature, which is put higher to claim less, `quiet`, and the
priors of "no_gap" and "parameters", moved so that one parameter five standard deviations off is called so.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

VERDICTS = ("no_gap", "parameters", "unknown")
AND = " + "
# Divides what the features say of the size of an effect: no form is nature's, and sizes miss more by that than causes.
SIZE_TEMPERATURE = 6.0
# Times `quiet`: what is left below that is no share of the gap.
LEFT_BY_AN_INTACT_MACHINE = 1.7


@dataclass(frozen=True, kw_only=True, slots=True)
class Weights:
    """Constants of the weighing.

    Attributes
    ----------
    temperature : float
        Divides log evidences where the noise is as modelled.
    quiet : float
        Whitened misfit over features that an intact machine leaves on a quiet bench.
    pair_gain : float
        Log odds of two effects against the stronger one alone, per e-fold of the log evidence that the second adds.
    pair_least, pair_share : float
        That log evidence at which they are even: the first plus the second times the root of the log evidence of
        the stronger effect alone, because the form of a strong effect misses more.
    open_gain, open_share : float
        Log odds of "unknown" against the best claim per e-fold of the share of the gap that this leaves, and the
        share at which they are even.
    prior_no_gap, prior_parameters, prior_unknown : float
        The rest belongs to the effects, evenly.
    """

    temperature: float = 3.0
    quiet: float = 0.15
    pair_gain: float = 1.4
    pair_least: float = 11.0
    pair_share: float = 0.7
    open_gain: float = 2.6
    open_share: float = 0.47
    prior_no_gap: float = 0.45
    prior_parameters: float = 0.15
    prior_unknown: float = 0.06


WEIGHTS = Weights()


def weigh(
    log_evidence: Mapping[str, float],
    left_over: Mapping[str, float],
    *,
    n_effects: int,
    quiet: float = WEIGHTS.quiet,
    shared: Mapping[str, float] | None = None,
    weights: Weights = WEIGHTS,
) -> dict[str, float]:
    """Turn log evidences into probabilities.

    Parameters
    ----------
    log_evidence : mapping of str to float
        By "no_gap" (0), "parameters", "unknown", effect, "effect + effect".
    left_over : mapping of str to float
        Whitened misfit over the number of features after each hypothesis; of "unknown" none.
    n_effects : int
        Size of the catalogue, for the priors.
    quiet : float
        Whitened misfit over features that an intact machine leaves on this bench.
    shared : mapping of str to float, optional
        How much of each pair's second effect lies where the first moves the equations; 1 where nothing is said.
    weights : Weights

    Returns
    -------
    dict of str to float
        Most likely first; they sum to 1.
    """
    w = weights
    prior_effects = 1.0 - w.prior_no_gap - w.prior_parameters - w.prior_unknown
    score: dict[str, float] = {}
    for name, value in log_evidence.items():
        if name == "unknown" or AND in name:
            continue
        prior = {"no_gap": w.prior_no_gap, "parameters": w.prior_parameters}.get(
            name, prior_effects / max(n_effects, 1)
        )
        score[name] = float(np.log(prior)) + value / w.temperature
    _share_with_pairs(score, log_evidence, shared or {}, w)
    claims = [n for n in score if np.isfinite(left_over.get(n, np.inf))]
    best = max(claims, key=lambda n: score[n])
    left = max(left_over[best] - LEFT_BY_AN_INTACT_MACHINE * quiet, 0.0)
    gap = max(left_over["no_gap"] - left_over[best], 0.0) + left
    share = (left + 0.02) / (gap + 0.2)
    score["unknown"] = max(
        float(np.log(w.prior_unknown)) + log_evidence["unknown"] / w.temperature,
        score[best] + w.open_gain * float(np.log(share / w.open_share)),
    )
    return _normalised(score)


def _share_with_pairs(
    score: dict[str, float], log_evidence: Mapping[str, float], shared: Mapping[str, float], w: Weights
) -> None:
    """Split what an effect is given between it alone and with a second one.

    A second effect always adds some evidence, because no form is nature's: what speaks for it is counted in e-folds,
    not in nats. Against all other causes the two together stand with all their evidence.
    """
    pairs: dict[str, list[str]] = {}
    for name in log_evidence:
        members = [n for n in name.split(AND) if n in score]
        if AND in name and members:
            pairs.setdefault(max(members, key=lambda n: log_evidence[n]), []).append(name)
    for stronger, names in pairs.items():
        alone = log_evidence[stronger]
        added = np.array([log_evidence[name] - alone for name in names])
        common = np.array([shared.get(name, 1.0) for name in names])
        even = w.pair_least + w.pair_share * np.sqrt(common * max(alone, 0.0))
        odds = w.pair_gain * float(np.log(max(float(np.max(added / even)), 1e-3)))
        # As far as the second is believed: one that is not must not speak for the first.
        believed = -float(np.logaddexp(0.0, -odds))
        total = score[stronger] + np.exp(believed) * max(float(added.max()), 0.0) / w.temperature
        score[stronger] = total - float(np.logaddexp(0.0, odds))
        among = added / w.temperature + w.pair_gain * np.log(np.maximum(added / even, 1e-3))
        among -= np.logaddexp.reduce(among)
        for name, share in zip(names, among, strict=True):
            score[name] = total + believed + float(share)


def _normalised(score: Mapping[str, float]) -> dict[str, float]:
    top = max(score.values())
    weight = {name: float(np.exp(max(value - top, -700.0))) for name, value in score.items()}
    total = sum(weight.values())
    return {name: value / total for name, value in sorted(weight.items(), key=lambda item: -item[1])}


def marginal_of(probabilities: Mapping[str, float], names: Iterable[str]) -> dict[str, float]:
    """Probability that each effect takes part, alone or in a pair."""
    return {name: sum(p for key, p in probabilities.items() if name in key.split(AND)) for name in names}
