"""Probabilities over effects, pairs, "parameters", "no_gap" and "unknown"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bench.recording import Floats
from diagnosis.evidence import Catalogue, Column, Explanation, background, explain_formed
from diagnosis.form_error import FORM_SHARES, covariates, form_modes
from diagnosis.linear_problem import WIDE, LinearProblem, Marginal
from diagnosis.log_mean import log_mean_exp
from diagnosis.stroke_series import Grain, grain_evidence
from diagnosis.weighing import AND, VERDICTS, WEIGHTS, weigh

GRAIN = "grain_variation"
Verdict = Literal["effect", "effects", "parameters", "no_gap", "unknown"]

_N_FORMED, _N_FIRST, _N_PAIRS = 12, 5, 8
_SCREEN_SHARE = 0.05
# Strokes are independent and their spectrum is fitted: what they say is tempered less than whitened features are.
STROKE_WEIGHT = 4.0
# Depths of a wave in the wood are tried in steps of this share.
GRAIN_STEP = 0.5
_WORTH_FORMING = 6.0
_DISCREPANCY_SIZES = (3.0, 10.0, 30.0, 100.0, 300.0)
_DISCREPANCY_HARMONICS = 6


@dataclass(frozen=True, kw_only=True, slots=True)
class Pair:
    """Two effects that act together."""

    first: Explanation
    second: Explanation
    log_evidence: float
    left_over: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Posterior:
    """What the evidence says.

    Attributes
    ----------
    verdict : Verdict
    probabilities : dict of str to float
        By "no_gap", "parameters", "unknown", effect name, or "first + second"; they sum to 1.
    explanations : tuple of Explanation
        Most likely first.
    pairs : tuple of Pair
    log_evidence : dict of str to float
        Untempered, relative to "no_gap".
    left_over : dict of str to float
        Whitened misfit over the number of features, of the nominal model and after each cause.
    grain : Grain
        What the single strokes say of a wave in the wood.
    dispersion : float
        Factor on the noise's variance: 1 where the best effect explains the gap as an intact machine is explained.
    """

    verdict: Verdict
    probabilities: dict[str, float]
    explanations: tuple[Explanation, ...]
    pairs: tuple[Pair, ...]
    log_evidence: dict[str, float]
    left_over: dict[str, float]
    grain: Grain
    dispersion: float


def judge(problem: LinearProblem, columns: dict[str, list[Column]]) -> Posterior:
    """Weigh all hypotheses against each other.

    Parameters
    ----------
    problem : LinearProblem
    columns : dict of str to list of Column
        Of `catalogue_columns`.

    Returns
    -------
    Posterior
    """
    columns = {name: entries for name, entries in columns.items() if entries}
    measured, original = problem, columns
    catalogue = Catalogue(columns, problem.data)
    dispersion = _dispersion(problem, catalogue)
    if dispersion > 1.0:
        problem, columns = _dispersed(problem, columns, dispersion)
        catalogue = Catalogue(columns, problem.data)
    # Once for the whitening, once because noise that large already holds the small effects.
    small = background(measured, [entries[0].effect for entries in columns.values()]) / dispersion
    nominal = Marginal(problem, extra=small)
    retuned = Marginal(problem, scale=wide_scale(problem), extra=small)
    reference = _log_z(nominal)
    log_evidence = {"no_gap": 0.0, "parameters": _log_z(retuned) - reference}
    rough = sorted(catalogue.explain(nominal).values(), key=lambda e: -e.log_evidence)
    modes = {e.effect.name: form_modes(problem, e.contribution) for e in rough[:_N_FORMED]}
    formed = [_with_form(problem, small, e, columns, modes, reference) for e in rough[:_N_FORMED]]
    explanations = sorted([*formed, *rough[_N_FORMED:]], key=lambda e: -e.log_evidence)
    for explanation in explanations:
        log_evidence[explanation.effect.name] = explanation.log_evidence
    grain = grain_evidence(problem.campaign.strokes)
    pairs = _pairs(problem, small, explanations[:_N_FIRST], catalogue, modes, reference)
    left_over = {"no_gap": nominal.misfit, "parameters": retuned.misfit}
    left_over |= {e.effect.name: nominal.misfit - e.gain for e in explanations}
    for pair in pairs:
        log_evidence[_pair_name(pair)] = pair.log_evidence
        left_over[_pair_name(pair)] = pair.left_over
    left_over = {name: dispersion * value / len(problem.data) for name, value in left_over.items()}
    log_evidence["unknown"] = _discrepancy(problem, small) - reference
    _add_grain(log_evidence, left_over, grain)
    probabilities = weigh(log_evidence, left_over, n_effects=len(problem.campaign.plant.effects))
    return Posterior(
        verdict=_verdict(probabilities),
        probabilities=probabilities,
        explanations=tuple(_with_grain(_undispersed(e, original, dispersion), grain) for e in explanations),
        pairs=tuple(_undispersed_pair(pair, original, dispersion) for pair in pairs),
        log_evidence=log_evidence,
        left_over=left_over,
        grain=grain,
        dispersion=dispersion,
    )


def _verdict(probabilities: dict[str, float]) -> Verdict:
    top = max(probabilities, key=lambda name: probabilities[name])
    if top in ("no_gap", "parameters", "unknown"):
        return top
    return "effects" if AND in top else "effect"


def _dispersion(problem: LinearProblem, catalogue: Catalogue) -> float:
    """How much more the best single effect leaves than an intact machine would: the noise is taken as that larger.

    A likelihood whose noise is fixed beforehand is so sure of a strong gap that every prior gives way: parameters
    move by twenty standard deviations, small background effects become large ones, and a second effect mops up
    what the first one's form leaves.
    """
    plain = Marginal(problem)
    gain = max((e.gain for e in catalogue.explain(plain).values()), default=0.0)
    return max(1.0, (plain.misfit - max(gain, 0.0)) / len(problem.data) / WEIGHTS.quiet)


def _dispersed(
    problem: LinearProblem, columns: dict[str, list[Column]], dispersion: float
) -> tuple[LinearProblem, dict[str, list[Column]]]:
    share = 1.0 / np.sqrt(dispersion)
    scaled = {
        name: [replace(column, columns=share * column.columns) for column in entries]
        for name, entries in columns.items()
    }
    return replace(problem, data=share * problem.data, nuisance=share * problem.nuisance), scaled


def _undispersed(explanation: Explanation, original: dict[str, list[Column]], dispersion: float) -> Explanation:
    column = next(c for c in original[explanation.effect.name] if c.shape == explanation.column.shape)
    return replace(explanation, column=column, contribution=np.sqrt(dispersion) * explanation.contribution)


def _undispersed_pair(pair: Pair, original: dict[str, list[Column]], dispersion: float) -> Pair:
    first, second = (_undispersed(e, original, dispersion) for e in (pair.first, pair.second))
    return replace(pair, first=first, second=second)


def _with_grain(explanation: Explanation, grain: Grain) -> Explanation:
    """Depth of the wood's wave from the single strokes, where it shows; mean strokes hardly know it."""
    if explanation.effect.name != GRAIN or grain.log_evidence <= 0.0:
        return explanation
    size = grain.depth / explanation.effect.strength.typical
    return replace(explanation, amplitude=size, amplitude_std=GRAIN_STEP * size)


def _add_grain(log_evidence: dict[str, float], left_over: dict[str, float], grain: Grain) -> None:
    """The strokes speak for or against a grained wood alone, whatever else is the matter.

    A wave that keeps its frequency in time rather than its length on the path is not the wood's: unknown.
    """
    if GRAIN not in log_evidence:
        return
    alone = {n: v for n, v in log_evidence.items() if n not in VERDICTS and AND not in n and n != GRAIN}
    for name in log_evidence:
        if GRAIN in name.split(AND):
            log_evidence[name] += STROKE_WEIGHT * grain.log_evidence
    for name in sorted(alone, key=lambda n: -alone[n])[:_N_FIRST]:
        both = AND.join(sorted((name, GRAIN)))
        log_evidence[both] = max(log_evidence.get(both, -np.inf), alone[name] + STROKE_WEIGHT * grain.log_evidence)
        left_over.setdefault(both, left_over[name])
    log_evidence["unknown"] = max(log_evidence["unknown"], STROKE_WEIGHT * grain.in_time)


def wide_scale(problem: LinearProblem) -> Floats:
    """Factor on the prior of each nuisance where the plant is retuned: 5 for its numbers, 1 for the rest."""
    plant = {n.name for n in problem.campaign.plant.nuisances() if n.is_plant}
    return np.array([WIDE if name in plant else 1.0 for name in problem.names])


def _log_z(marginal: Marginal) -> float:
    return -0.5 * (marginal.misfit + marginal.log_determinant)


def _pair_name(pair: Pair) -> str:
    return AND.join(sorted((pair.first.effect.name, pair.second.effect.name)))


def _with_form(
    problem: LinearProblem,
    small: Floats,
    rough: Explanation,
    columns: dict[str, list[Column]],
    modes: dict[str, Floats],
    reference: float,
) -> Explanation:
    """Weigh one effect again, with what its form may miss."""
    name = rough.effect.name
    log_z, _, _ = explain_formed(problem, small, modes[name], columns[name], FORM_SHARES)
    return replace(rough, log_evidence=log_z - reference)


def _pairs(
    problem: LinearProblem,
    small: Floats,
    firsts: Sequence[Explanation],
    catalogue: Catalogue,
    modes: dict[str, Floats],
    reference: float,
) -> list[Pair]:
    """Evidence of pairs: the first in its best shape and with what its form may miss, then every second."""
    rough: dict[frozenset[str], tuple[Explanation, Explanation, float]] = {}
    for first in firsts:
        given = first.column.columns * first.effect.strength.high
        marginal = Marginal(problem, extra=np.hstack([small, given, _SCREEN_SHARE * modes[first.effect.name]]))
        for name, found in catalogue.explain(marginal).items():
            if name == first.effect.name:
                continue
            key, total = frozenset((first.effect.name, name)), found.log_evidence + _log_z(marginal)
            if key not in rough or total > rough[key][2]:
                rough[key] = (first, found, total)
    best = sorted(rough.values(), key=lambda entry: -entry[2])[:_N_PAIRS]
    columns = catalogue.columns
    pairs = [_formed_pair(problem, small, first, second, columns, modes, reference) for first, second, _ in best]
    return sorted(pairs, key=lambda pair: -pair.log_evidence)


def _formed_pair(
    problem: LinearProblem,
    small: Floats,
    first: Explanation,
    second: Explanation,
    columns: dict[str, list[Column]],
    modes: dict[str, Floats],
    reference: float,
) -> Pair:
    """Weigh a pair again with what both forms may miss; a second that hardly shows keeps what the screening gave."""
    if second.log_evidence < _WORTH_FORMING:
        return Pair(first=first, second=second, log_evidence=first.log_evidence + second.log_evidence, left_over=np.inf)
    given = first.column.columns * first.effect.strength.high
    name = second.effect.name
    if name not in modes:
        modes[name] = form_modes(problem, second.contribution)
    both = np.hstack([modes[first.effect.name], modes[name]])
    log_z, left_over, found = explain_formed(problem, np.hstack([small, given]), both, columns[name], FORM_SHARES)
    return Pair(first=first, second=found, log_evidence=log_z - reference, left_over=left_over)


def _discrepancy(problem: LinearProblem, small: Floats) -> float:
    """Log evidence of a smooth gap of no particular form: harmonics times {1, speed, load, time, feed}."""
    blocks = []
    varied = covariates(problem)
    rows = [np.ones(len(problem.parts)), varied["speed"], 1.0 - varied["idle"], varied["session"], varied["feed"]]
    for equation, form in problem.campaign.plant.equations.items():
        n_harmonics = form.n_harmonics
        for k in range(2 * min(_DISCREPANCY_HARMONICS, n_harmonics) + 1):
            for row in rows:
                column = np.zeros(len(problem.data))
                for part, weight in zip(problem.parts, row, strict=True):
                    if part.state.kind != "running" or equation not in part.layout.equations or not weight:
                        continue
                    place = part.layout.slices[equation]
                    n = 2 * n_harmonics + 1
                    index = 0 if k == 0 else (k + 1) // 2 if k % 2 else n_harmonics + k // 2
                    feature = np.zeros((part.blocks.shape[0], part.layout.size))
                    feature[:, place.start + min(index, n - 1)] = weight
                    column[part.place] = (feature @ part.whitener.T).ravel()
                norm = float(np.linalg.norm(column))
                if norm > 0:
                    blocks.append(column / norm)
    shapes = np.array(blocks).T
    return log_mean_exp(
        [_log_z(Marginal(problem, extra=np.hstack([small, size * shapes]))) for size in _DISCREPANCY_SIZES]
    )
