"""What the peers choose from: the hypotheses of the score, and the classes that a classifier can be trained on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.blindcheck.effects.table import CATALOGUE
from sawbench.diagnosis.inference.hypothesis import AND, OTHERS

EFFECTS = tuple(CATALOGUE)
PAIR = "pair"
CLASSES = (*EFFECTS, *OTHERS, PAIR)
# Shares of the kinds in a set, as docs/blind_check.md states them; every peer may know them.
PRIOR = {"no_gap": 0.125, "parameters": 0.125, "effect": 0.5, "pair": 0.1, "unknown": 0.15}
# Effects that are at most this factor less probable than the declared one are named as "could be that as well".
GROUP_FACTOR = 5.0
_KEPT = 60


@dataclass(frozen=True, kw_only=True, slots=True)
class Answer:
    """What a peer says of one case.

    Attributes
    ----------
    probabilities : dict of str to float
        By hypothesis; pairs as "first + second" in alphabetical order.
    time_s : float
        Of the peer, reading and reducing the campaign included.
    """

    probabilities: dict[str, float]
    time_s: float
    indistinguishable_from: tuple[str, ...] = field(default=())


def pair_name(first: str, second: str) -> str:
    """Name of two effects together."""
    return " + ".join(sorted((first, second)))


def label_of(kind: str, effects: Mapping[str, float]) -> str:
    """Class of a case.

    Examples
    --------
    >>> label_of("outside", {"hand_sway": 1.0}), label_of("effect", {"edge_force": 1.0})
    ('unknown', 'edge_force')
    """
    return {"none": "no_gap", "parameters": "parameters", "outside": "unknown", "pair": PAIR}.get(
        kind, next(iter(effects), "")
    )


def log_prior() -> dict[str, float]:
    """Logarithm of the share of every hypothesis in a set, pairs included."""
    n = len(EFFECTS)
    shares = {name: PRIOR[name] for name in OTHERS}
    shares |= dict.fromkeys(EFFECTS, PRIOR["effect"] / n)
    shares |= {pair_name(a, b): PRIOR["pair"] / (n * (n - 1) / 2) for a, b in combinations(EFFECTS, 2)}
    return {name: float(np.log(share)) for name, share in shares.items()}


def normalised(scores: Mapping[str, float]) -> dict[str, float]:
    """Probabilities from log scores, most probable first; what is beyond the first 60 is left to "the rest"."""
    names = list(scores)
    values = np.array([scores[name] for name in names])
    weight = np.exp(values - values.max())
    weight /= weight.sum()
    order = np.argsort(-weight, kind="stable")[:_KEPT]
    return {names[k]: float(weight[k]) for k in order}


def spread_pairs(by_class: Sequence[float] | Floats) -> dict[str, float]:
    """Probabilities of hypotheses from those of `CLASSES`: the share of "pair" goes to pairs of likely effects."""
    given = dict(zip(CLASSES, map(float, by_class), strict=True))
    share = given.pop(PAIR)
    pairs = {pair_name(a, b): given[a] * given[b] for a, b in combinations(EFFECTS, 2)}
    total = sum(pairs.values())
    for name, weight in pairs.items():
        given[name] = share * (weight / total if total > 0 else 1.0 / len(pairs))
    tiny = 1e-12
    return normalised({name: float(np.log(max(value, tiny))) for name, value in given.items()})


def indistinguishable(probabilities: Mapping[str, float]) -> tuple[str, ...]:
    """Effects that are nearly as probable as the most probable hypothesis, if that is an effect."""
    top = max(probabilities, key=lambda name: probabilities[name])
    if top in OTHERS:
        return ()
    near = [name for name in EFFECTS if probabilities.get(name, 0.0) * GROUP_FACTOR >= probabilities[top]]
    return tuple(name for name in near if name not in top.split(AND))


def answer_of(probabilities: dict[str, float], time_s: float) -> Answer:
    """Complete an answer with its group."""
    return Answer(probabilities=probabilities, time_s=time_s, indistinguishable_from=indistinguishable(probabilities))


def case_arguments(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of `blindcheck.scored_case.Case` for a stored answer."""
    return {
        "probabilities": answer["probabilities"],
        "indistinguishable_from": answer["indistinguishable_from"],
        "time_s": answer["time_s"],
    }
