"""Plain BIC: least squares with sensor noise and raw sample counts, ranked by chi^2 + k ln n.

Every sample counts as independent and the sensors' white noise as all there is: no wood that scatters, no model
error, no background of other effects. That is what the criterion gives who applies it as the textbook says
(Schwarz, Ann. Statist. 6, 461 (1978)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from sawbench.bench.recording import Floats

from benchmarks.diagnosis_peers.hypotheses import EFFECTS, PRIOR, log_prior, normalised, pair_name
from benchmarks.diagnosis_peers.terms import ABSORBED, NAMELESS, SPREAD, STOCK, Terms


@dataclass(frozen=True, kw_only=True, slots=True)
class BicSettings:
    """What is chosen on the development cases.

    Attributes
    ----------
    fits_each_trial : bool
        k_Fc is fitted to every trial, not only to every stock.
    has_no_gap_prior : bool
        "No gap" may move the parameters at the cost of their stated uncertainty; else they are nominal.
    has_unknown : bool
        Low harmonics of every equation compete as "unknown"; else that keeps its share of a set.
    has_pairs : bool
        Two effects compete; else pairs keep their share of a set, evenly.
    """

    fits_each_trial: bool = True
    has_no_gap_prior: bool = True
    has_unknown: bool = False
    has_pairs: bool = True


SETTINGS = tuple(
    BicSettings(fits_each_trial=a, has_no_gap_prior=b, has_unknown=c, has_pairs=d)
    for a, b, c, d in product((True, False), repeat=4)
)


def bic_probabilities(terms: Terms, settings: BicSettings) -> dict[str, float]:
    """Probability of every hypothesis, proportional to its prior times exp(-BIC / 2).

    Parameters
    ----------
    terms : Terms
    settings : BicSettings

    Returns
    -------
    dict of str to float
    """
    log_n = float(np.log(terms.n_samples))
    columns = {name: 1 + k for k, name in enumerate(terms.names)}
    effects = effect_columns(terms)
    nameless = [k for name, k in columns.items() if name.startswith(NAMELESS)]
    taken = {k for part in effects.values() for k in part} | set(nameless)
    per_trial = [k for name, k in columns.items() if name.startswith(SPREAD)]
    stocks = [k for name, k in columns.items() if name.startswith(STOCK)]
    shared = [k for k in columns.values() if k not in taken and k not in per_trial and k not in stocks]
    always = stocks + (per_trial if settings.fits_each_trial else [])
    prior = log_prior()
    bic: dict[str, float] = {}
    if settings.has_no_gap_prior:
        bic["no_gap"] = _misfit(terms.gram, always + shared, [0.0] * len(always) + [1.0] * len(shared))
    else:
        bic["no_gap"] = _misfit(terms.gram, always)
    bic["no_gap"] += len(always) * log_n
    free = always + shared
    bic["parameters"] = _misfit(terms.gram, free) + len(free) * log_n
    if settings.has_unknown:
        bic["unknown"] = _misfit(terms.gram, free + nameless) + (len(free) + len(nameless)) * log_n
    gram, order = _after(terms.gram, free, effects)
    alone = bic["parameters"]
    for name, place in order.items():
        bic[name] = alone - _gain(gram, place) + len(place) * log_n
    for first, second in combinations(order, 2) if settings.has_pairs else ():
        place = order[first] + order[second]
        bic[pair_name(first, second)] = alone - _gain(gram, place) + len(place) * log_n
    found = normalised({name: prior[name] - 0.5 * value for name, value in bic.items()})
    unknown = 0.0 if settings.has_unknown else PRIOR["unknown"]
    rest = 1.0 - unknown - (0.0 if settings.has_pairs else PRIOR["pair"])
    found = {name: value * rest for name, value in found.items()}
    return found | ({"unknown": unknown} if unknown else {})


def effect_columns(terms: Terms) -> dict[str, list[int]]:
    """Columns of every effect in a `Terms.gram` or `Terms.rows`."""
    found: dict[str, list[int]] = {}
    for k, name in enumerate(terms.names, start=1):
        effect, slash, _ = name.partition("/")
        if slash and effect in EFFECTS:
            found.setdefault(effect, []).append(k)
    return found


def _misfit(gram: Floats, columns: Sequence[int], penalty: Sequence[float] | None = None) -> float:
    """Least squared misfit with some columns, each with a Gaussian prior of weight `penalty`."""
    if not columns:
        return float(gram[0, 0])
    inner = gram[np.ix_(columns, columns)] + np.diag(np.zeros(len(columns)) if penalty is None else penalty)
    moment = gram[list(columns), 0]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(inner), 1e-30))
    solution = np.linalg.lstsq(inner * np.outer(scale, scale), moment * scale, rcond=1e-12)[0]
    return float(gram[0, 0] - moment @ (solution * scale))


def _after(gram: Floats, free: Sequence[int], effects: dict[str, list[int]]) -> tuple[Floats, dict[str, list[int]]]:
    """Inner products of residual and effects with the free columns projected out (Schur complement)."""
    kept = [0, *(k for place in effects.values() for k in place)]
    inner = gram[np.ix_(free, free)]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(inner), 1e-30))
    cross = gram[np.ix_(free, kept)] * scale[:, None]
    solution = np.linalg.lstsq(inner * np.outer(scale, scale), cross, rcond=1e-12)[0]
    order, start = {}, 1
    for name, place in effects.items():
        order[name] = list(range(start, start + len(place)))
        start += len(place)
    left = gram[np.ix_(kept, kept)] - cross.T @ solution
    absorbed = np.diag(left) < ABSORBED * np.diag(gram)[kept]
    left[absorbed] = 0.0
    left[:, absorbed] = 0.0
    return left, order


def _gain(gram: Floats, place: Sequence[int]) -> float:
    """Fall of the misfit by some columns; one column alone may only be added."""
    moment = gram[list(place), 0]
    inner = gram[np.ix_(place, place)]
    if len(place) == 1:
        return float(max(moment[0], 0.0) ** 2 / max(inner[0, 0], 1e-30))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(inner), 1e-30))
    solution = np.linalg.lstsq(inner * np.outer(scale, scale), moment * scale, rcond=1e-10)[0]
    return float(moment @ (solution * scale))
