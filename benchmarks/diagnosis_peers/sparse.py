"""Discrepancy terms by sparse regression (pysindy): residuals of the equations on a dictionary, bootstrapped.

Sequentially thresholded least squares (Brunton, Proctor and Kutz, PNAS 113, 3932 (2016)) chooses few terms among
parameters, effects and nameless harmonics; every bootstrap sample of the rows gives one model (Fasel and others,
Proc. R. Soc. A 478, 20210904 (2022)), and every model is one vote for a hypothesis.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from sawbench.bench.recording import Floats

from benchmarks.diagnosis_peers.bic import effect_columns
from benchmarks.diagnosis_peers.hypotheses import log_prior, normalised, pair_name
from benchmarks.diagnosis_peers.terms import NAMELESS, SPREAD, STOCK, Terms


@dataclass(frozen=True, kw_only=True, slots=True)
class SparseSettings:
    """What is chosen on the development cases.

    Attributes
    ----------
    threshold : float
        Coefficients below are dropped: in typical sizes of an effect, standard deviations of a parameter.
    alpha : float
        Ridge of the least squares, as a share of the number of rows.
    share : float
        An effect counts whose mean square contribution, in units of the scatter that re-tuned parameters leave, is
        at least this; the strongest two at most.
    sigmas : float
        A parameter counts as mistuned beyond so many stated standard deviations.
    prior_votes : float
        Votes that the shares of a set count for.
    n_models : int
        Bootstrap samples.
    """

    threshold: float = 0.2
    alpha: float = 1e-3
    share: float = 0.01
    sigmas: float = 3.0
    prior_votes: float = 4.0
    n_models: int = 20


SETTINGS = tuple(
    SparseSettings(threshold=threshold, alpha=alpha)
    for threshold, alpha in ((0.15, 1e-2), (0.3, 1e-2), (0.5, 1e-2), (0.3, 3e-2))
)
SHARES = (0.0, 1e-3, 1e-2, 0.03, 0.1, 0.3)
SIGMAS = (2.0, 3.0, 4.0)
PRIOR_VOTES = (0.3, 1.0, 3.0, 10.0, 30.0)


def coefficients(terms: Terms, settings: SparseSettings, *, seed: int = 0) -> Floats:
    """Coefficients of every bootstrap model, shape (n_models, m)."""
    import pysindy

    columns = terms.rows[:, 1:]
    # pysindy draws its samples from the global generator.
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        optimizer = pysindy.EnsembleOptimizer(
            pysindy.STLSQ(threshold=settings.threshold, alpha=settings.alpha * len(columns), unbias=False),
            bagging=True, n_models=settings.n_models,
        )  # fmt: skip
        optimizer.fit(columns, terms.rows[:, :1])
    finally:
        np.random.set_state(state)  # noqa: NPY002
    return np.array(optimizer.coef_list)[:, 0, :]


def contributions(terms: Terms, found: Floats) -> tuple[dict[str, Floats], Floats, Floats]:
    """What effects and nameless terms make up in every model, and how far parameters are off.

    Returns
    -------
    effects : dict of str to ndarray, shape (n_models,)
        Mean square, in units of the scatter that re-tuned parameters leave.
    nameless : ndarray, shape (n_models,)
        The same of all nameless terms.
    sigmas : ndarray, shape (n_models,)
        Of the most mistuned parameter, in stated standard deviations.
    """
    columns = terms.rows[:, 1:]

    def size(place: list[int]) -> Floats:
        return np.mean((found[:, place] @ columns[:, place].T) ** 2, axis=1) if place else np.zeros(len(found))

    by_effect = {name: [k - 1 for k in place] for name, place in effect_columns(terms).items()}
    effects = {name: size(place) * ((found[:, place[0]] > 0) | (len(place) > 1)) for name, place in by_effect.items()}
    taken = {k for place in by_effect.values() for k in place}
    nameless = [k for k, name in enumerate(terms.names) if name.startswith(NAMELESS)]
    rest = [
        k for k, name in enumerate(terms.names) if k not in taken and not name.startswith((NAMELESS, STOCK, SPREAD))
    ]
    return effects, size(nameless), np.abs(found[:, rest]).max(axis=1)


def votes(made: tuple[dict[str, Floats], Floats, Floats], least_share: float, least_sigmas: float) -> Counter[str]:
    """One vote of every model: its strongest effects, else what it uses instead."""
    effects, nameless, sigmas = made
    names = list(effects)
    table = np.array([effects[name] for name in names])
    least = max(least_share, 1e-12)
    counted: Counter[str] = Counter()
    for k in range(len(nameless)):
        strong = [int(i) for i in np.argsort(-table[:, k]) if table[i, k] > least][:2]
        if strong and table[strong[0], k] >= nameless[k]:
            second = len(strong) > 1 and table[strong[1], k] > 0.3 * table[:, k].sum()
            counted[pair_name(names[strong[0]], names[strong[1]]) if second else names[strong[0]]] += 1
        elif nameless[k] > least:
            counted["unknown"] += 1
        else:
            counted["parameters" if sigmas[k] > least_sigmas else "no_gap"] += 1
    return counted


def vote_probabilities(counted: Counter[str], prior_votes: float) -> dict[str, float]:
    """Probabilities from votes, with the shares of a set as so many votes more."""
    n = sum(counted.values())
    scores = {
        name: float(np.log((counted.get(name, 0) + prior_votes * np.exp(prior)) / (n + prior_votes)))
        for name, prior in log_prior().items()
    }
    return normalised(scores)


def sparse_probabilities(terms: Terms, settings: SparseSettings) -> dict[str, float]:
    """Probability of every hypothesis from bootstrap inclusion.

    Parameters
    ----------
    terms : Terms
    settings : SparseSettings

    Returns
    -------
    dict of str to float
    """
    made = contributions(terms, coefficients(terms, settings))
    return vote_probabilities(votes(made, settings.share, settings.sigmas), settings.prior_votes)
