"""Probabilities over effects, pairs, "parameters", "no_gap" and "unknown"."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bench.recording import Floats
from diagnosis.credit import with_credit
from diagnosis.discrepancy import discrepancy
from diagnosis.dispersion import columns_with_noise, noise_factor, with_noise
from diagnosis.evidence import (
    Catalogue,
    Column,
    Explanation,
    background,
    catalogue_columns,
    explain,
    explain_formed,
    little_of_each,
)
from diagnosis.form_error import FORM_SHARES, form_modes
from diagnosis.linear_problem import WIDE, LinearProblem, Marginal
from diagnosis.off_stroke import Finding, off_stroke_finding
from diagnosis.stroke_series import Grain, grain_evidence
from diagnosis.stroke_trend import Trend, bends_force, blocks_of, trend_evidence
from diagnosis.weighing import AND, VERDICTS, weigh

GRAIN = "grain_variation"
Verdict = Literal["effect", "effects", "parameters", "no_gap", "unknown"]

_N_FORMED, _N_FIRST, _N_PAIRS = 12, 5, 8
_SCREEN_SHARE = 0.05
# Strokes are independent and their spectrum is fitted: one nat of theirs counts as that many of whitened features. The
# same alone, beside another effect and for a wave in time: else a second name would make the strokes speak louder.
STROKE_WEIGHT = 4.0
# Depths of a wave in the wood are tried in steps of this share.
GRAIN_STEP = 0.5
_WORTH_FORMING = 6.0
# Log evidence of the strokes below which they speak against an effect.
_AGAINST = -1.0
# Taken off a worn blade and a thick chip for which strokes speak: with a dozen pieces of wood luck looks like either.
_STROKES_PRICE = 7.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Pair:
    """Two effects that act together.

    Attributes
    ----------
    first, second : Explanation
        The second beside the first.
    log_evidence : float
    shared : float
        How much of the second lies in the equations that the first moves, 0 to 1: there, what the first one's
        form misses can be taken for it.
    is_formed : bool
        Weighed with what both forms may miss; else the second hardly shows beside the first.
    """

    first: Explanation
    second: Explanation
    log_evidence: float
    shared: float
    is_formed: bool


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
    shared : dict of str to float
        Of each pair; see `Pair`.
    left_over : dict of str to float
        Whitened misfit over the number of features, of the nominal model and after each cause.
    grain : Grain
        What the single strokes say of a wave in the wood.
    trend : Trend
        What they say of a worn blade and a chip's thickness.
    off_stroke : Finding or None
        What does not follow the stroke and is no scatter: it speaks for "unknown".
    resembles : str
        What speaks for "unknown" most; empty for a gap of no particular form.
    dispersion : ndarray, shape (n,)
        Factor on the noise's variance of every feature: 1 where the best effect explains the gap as an intact machine
        is explained.
    little : dict of str to ndarray, shape (n, q)
        Nuisance columns for a little of each effect, times their prior standard deviation.
    """

    verdict: Verdict
    probabilities: dict[str, float]
    explanations: tuple[Explanation, ...]
    pairs: tuple[Pair, ...]
    log_evidence: dict[str, float]
    shared: dict[str, float]
    left_over: dict[str, float]
    grain: Grain
    trend: Trend
    off_stroke: Finding | None
    resembles: str
    dispersion: Floats
    little: dict[str, Floats]

    @property
    def small(self) -> Floats:
        """All of `little` side by side, shape (n, q)."""
        return np.hstack([np.zeros((len(self.dispersion), 0)), *self.little.values()])


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
    original = columns = {name: entries for name, entries in columns.items() if entries}
    catalogue = Catalogue(columns, problem.data)
    beyond = catalogue_columns(problem, problem.campaign.plant.beyond_catalogue)
    ordinary = background(problem, [e for e in problem.campaign.plant.beyond_catalogue if e.background])
    little = little_of_each(problem, [entries[0].effect for entries in columns.values()])
    dispersion = noise_factor(problem, catalogue, Catalogue(beyond, problem.data))
    if dispersion.max() > 1.0:
        problem = with_noise(problem, dispersion)
        columns, beyond = (columns_with_noise(problem, found, dispersion) for found in (columns, beyond))
        catalogue = Catalogue(columns, problem.data)
    # A little of each effect is scaled twice: noise that large already holds the small effects.
    share = 1.0 / np.sqrt(dispersion)[:, None]
    small = np.hstack([*(share**2 * found for found in little.values()), share * ordinary])
    nominal = Marginal(problem, extra=small)
    retuned = Marginal(problem, scale=wide_scale(problem), extra=small)
    reference = _log_z(nominal)
    log_evidence = {"no_gap": 0.0, "parameters": _log_z(retuned) - reference}
    found = (with_credit(problem, nominal, e) for e in catalogue.explain(nominal).values())
    rough = sorted(found, key=lambda e: -e.log_evidence)
    modes = {e.effect.name: _modes(problem, e) for e in rough[:_N_FORMED]}
    formed = [
        _with_form(problem, small, e, columns[e.effect.name], modes[e.effect.name], reference)
        for e in rough[:_N_FORMED]
    ]
    explanations = sorted([*(e for e, _ in formed), *rough[_N_FORMED:]], key=lambda e: -e.log_evidence)
    for explanation in explanations:
        log_evidence[explanation.effect.name] = explanation.log_evidence
    grain = grain_evidence(problem.campaign.strokes)
    given = {e.effect.name: _in_either_shape(e, column) for e, column in formed}
    firsts = [e for e in explanations if e.effect.name in given][:_N_FIRST]
    pairs = _pairs(problem, small, firsts, given, catalogue, modes, reference)
    left_over = {
        "no_gap": _left_over(problem, dispersion, nominal),
        "parameters": _left_over(problem, dispersion, retuned),
    }
    left_over |= {e.effect.name: _left_over(problem, dispersion, nominal, e) for e in explanations}
    for pair in pairs:
        log_evidence[_pair_name(pair)] = pair.log_evidence
        both = (pair.first, pair.second)
        left_over[_pair_name(pair)] = _left_by(problem, dispersion, small, both) if pair.is_formed else np.inf
    beside = off_stroke_finding(problem.campaign.off_stroke)
    unnamed = _unnamed(problem, small, _beyond(problem, nominal, small, beyond, reference), grain, beside, reference)
    resembles = max(unnamed, key=lambda text: unnamed[text])
    log_evidence["unknown"] = unnamed[resembles]
    shared = {_pair_name(pair): pair.shared for pair in pairs}
    by_strokes = _add_strokes(log_evidence, GRAIN, alone=grain.log_evidence, beside={}, is_whole=False)
    trend = trend_evidence(blocks_of(problem.campaign.states, problem.campaign.strokes))
    bending = [e.name for e in problem.campaign.plant.effects if bends_force(e)]
    for effect, alone in trend.alone.items():
        beside_cut = dict.fromkeys(bending, trend.beside_cutting[effect])
        by_strokes |= _add_strokes(log_evidence, effect, alone=alone, beside=beside_cut, is_whole=True)
    members = {e.effect.name: e for e in explanations}
    for name in sorted(by_strokes):
        shared[name] = 0.0
        if AND in name and not np.isfinite(left_over.get(name, np.inf)):
            # Mean strokes do not know the grain.
            shown = [members[n] for n in name.split(AND) if n != GRAIN]
            left_over[name] = _left_by(problem, dispersion, small, shown)
    probabilities = weigh(
        log_evidence, left_over, n_effects=len(problem.campaign.plant.effects), quiet=problem.quiet, shared=shared
    )
    return Posterior(
        verdict=_verdict(probabilities),
        probabilities=probabilities,
        explanations=tuple(
            sized_by_strokes(_undispersed(_sized(e, left_over, problem.quiet), original, dispersion), grain, trend)
            for e in explanations
        ),
        pairs=tuple(_undispersed_pair(pair, original, dispersion) for pair in pairs),
        log_evidence=log_evidence,
        shared=shared,
        left_over=left_over,
        grain=grain,
        trend=trend,
        off_stroke=beside,
        resembles=resembles if unnamed[resembles] > 0.0 else "",
        dispersion=dispersion,
        little=little,
    )


def _verdict(probabilities: dict[str, float]) -> Verdict:
    top = max(probabilities, key=lambda name: probabilities[name])
    if top in ("no_gap", "parameters", "unknown"):
        return top
    return "effects" if AND in top else "effect"


def _left_over(
    problem: LinearProblem, dispersion: Floats, marginal: Marginal, explanation: Explanation | None = None
) -> float:
    """Misfit over the number of features, whitened by the noise as it was measured."""
    data = problem.data if explanation is None else problem.data - explanation.contribution
    return float((dispersion * data) @ marginal.rest(data)) / len(data)


def _left_by(problem: LinearProblem, dispersion: Floats, small: Floats, members: Sequence[Explanation]) -> float:
    """The same of several effects, each of the size that fits best beside the others."""
    given = [member.column.columns * member.effect.strength.high for member in members]
    return _left_over(problem, dispersion, Marginal(problem, extra=np.hstack([small, *given])))


def _undispersed(explanation: Explanation, original: dict[str, list[Column]], dispersion: Floats) -> Explanation:
    column = next(c for c in original[explanation.effect.name] if c.shape == explanation.column.shape)
    return replace(explanation, column=column, contribution=np.sqrt(dispersion) * explanation.contribution)


def _undispersed_pair(pair: Pair, original: dict[str, list[Column]], dispersion: Floats) -> Pair:
    first, second = (_undispersed(e, original, dispersion) for e in (pair.first, pair.second))
    return replace(pair, first=first, second=second)


def _sized(explanation: Explanation, left_over: dict[str, float], quiet: float) -> Explanation:
    """A form that leaves much of the gap is not nature's: half of that share, in amplitude, is uncertain."""
    rest = max(left_over[explanation.effect.name] - quiet, 0.0)
    share = 0.5 * float(np.sqrt(rest / max(left_over["no_gap"] - quiet, rest, 1e-12)))
    return replace(explanation, form_share=max(explanation.form_share, share))


def sized_by_strokes(explanation: Explanation, grain: Grain, trend: Trend) -> Explanation:
    """Size of an effect from the single strokes, where they speak for it; mean strokes hardly know it.

    Parameters
    ----------
    explanation : Explanation
    grain : Grain
    trend : Trend

    Returns
    -------
    Explanation
        With the depth of the wood's wave, the growth of a worn blade or the exponent of the chip; others as they were.
    """
    name, typical = explanation.effect.name, explanation.effect.strength.typical
    if name == GRAIN and grain.log_evidence > 0.0:
        size = grain.depth / typical
        return replace(explanation, amplitude=size, amplitude_std=GRAIN_STEP * size)
    if trend.beside_cutting.get(name, 0.0) > 0.0:
        mean, std = trend.sizes[name]
        return replace(explanation, mixture=(mean / typical, std / typical), form_share=0.0)
    return explanation


def _add_strokes(
    log_evidence: dict[str, float],
    effect: str,
    *,
    alone: float,
    beside: Mapping[str, float],
    is_whole: bool,
) -> set[str]:
    """Add what single strokes say for or against an effect that mean strokes hardly show.

    Parameters
    ----------
    log_evidence : dict of str to float
        By hypothesis; changed.
    effect : str
    alone : float
        Log evidence of the strokes.
    beside : mapping of str to float
        The same beside another effect, where it is not that.
    is_whole : bool
        The strokes know all of the effect: where they speak against it, what mean strokes say for it comes of
        something else.

    Returns
    -------
    set of str
        Hypotheses whose second effect rests on the strokes: what the first one's form misses does not look like it.
    """
    if effect not in log_evidence:
        return set()
    resting: set[str] = set()
    others = {n: v for n, v in log_evidence.items() if n not in VERDICTS and AND not in n and n != effect}
    with_effect = {n: v for n, v in log_evidence.items() if effect in n.split(AND)}

    def counted(said: float) -> float:
        return STROKE_WEIGHT * said - (_STROKES_PRICE if is_whole and said > 0.0 else 0.0)

    for name, value in with_effect.items():
        other = next((n for n in name.split(AND) if n != effect), "")
        said = beside.get(other, alone)
        known = min(value, others.get(other, 0.0)) if is_whole and said < _AGAINST else value
        log_evidence[name] = known + counted(said)
        if said > 0.0 or not is_whole:
            resting.add(name)
    for name in sorted(others, key=lambda n: -others[n])[:_N_FIRST]:
        both = AND.join(sorted((name, effect)))
        said = beside.get(name, alone)
        if is_whole and said <= 0.0:
            continue
        log_evidence[both] = max(log_evidence.get(both, -np.inf), others[name] + counted(said))
        resting.add(both)
    return resting


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
    entries: list[Column],
    modes: Floats,
    reference: float,
) -> tuple[Explanation, Column]:
    """Weigh one effect again, with what its form may miss; its best shape then is another one than without."""
    log_z, formed = explain_formed(problem, small, modes, entries, FORM_SHARES)
    explanation = replace(
        rough,
        log_evidence=_carried(rough.log_evidence, log_z - reference),
        shape_spread=formed.shape_spread,
        form_share=formed.form_share,
    )
    return explanation, formed.column


def _in_either_shape(explanation: Explanation, formed: Column) -> list[Floats]:
    """Columns of any size for the shape that is best as it is, and for the one that is best with what it may miss.

    Which of them is nature's shows only once the other effect is there too.
    """
    shapes = [explanation.column] if explanation.column is formed else [explanation.column, formed]
    return [column.columns * explanation.effect.strength.high for column in shapes]


def _carried(by_form: float, with_modes: float) -> float:
    """Log evidence with what a form may miss: that cannot weigh more than what the form itself explains."""
    return min(with_modes, by_form + max(by_form, 0.0))


def _modes(problem: LinearProblem, explanation: Explanation) -> Floats:
    return form_modes(problem, explanation.contribution, in_time="time" in explanation.effect.grows_with)


def _beyond(
    problem: LinearProblem, nominal: Marginal, small: Floats, beyond: dict[str, list[Column]], reference: float
) -> dict[str, float]:
    """Log evidence of each cause that has a form but no place in the catalogue."""
    found = {}
    for name, entries in beyond.items():
        rough = explain(nominal, entries)
        if rough is not None:
            formed, _ = _with_form(problem, small, rough, entries, _modes(problem, rough), reference)
            found[name] = formed.log_evidence - float(np.log(len(beyond)))
    return found


def _unnamed(
    problem: LinearProblem,
    small: Floats,
    beyond: dict[str, float],
    grain: Grain,
    beside: Finding | None,
    reference: float,
) -> dict[str, float]:
    """Log evidence of whatever is not in the catalogue, by what it looks like; "" for a gap of no particular form."""
    found = {"": discrepancy(problem, small) - reference, **beyond}
    # A wave that keeps its frequency in time rather than its length on the path is not the wood's.
    found["hardness of the wood that waves in time, not along the feed"] = STROKE_WEIGHT * grain.in_time
    if beside is not None:
        found[beside.text] = beside.log_evidence
    return found


def _pairs(
    problem: LinearProblem,
    small: Floats,
    firsts: Sequence[Explanation],
    given: Mapping[str, list[Floats]],
    catalogue: Catalogue,
    modes: dict[str, Floats],
    reference: float,
) -> list[Pair]:
    """Evidence of pairs: the first as `given` and with what its form may miss, then every second."""
    rough: dict[frozenset[str], list[tuple[float, Explanation, Explanation]]] = {}
    for first in firsts:
        name = first.effect.name
        marginal = Marginal(problem, extra=np.hstack([small, *given[name], _SCREEN_SHARE * modes[name]]))
        for other, found in catalogue.explain(marginal).items():
            if other == name:
                continue
            second = with_credit(problem, marginal, found) if found.log_evidence > _WORTH_FORMING else found
            total = second.log_evidence + _log_z(marginal)
            rough.setdefault(frozenset((name, other)), []).append((total, first, second))
    best = sorted(rough.values(), key=lambda orders: -max(total for total, *_ in orders))[:_N_PAIRS]
    pairs = []
    for orders in best:
        # In either order, where both may come first: only the second one's size and form are integrated out.
        both = (
            _formed_pair(problem, small, first, given[first.effect.name], second, catalogue.columns, modes, reference)
            for _, first, second in orders
        )
        pairs.append(max(both, key=lambda pair: pair.log_evidence))
    return sorted(pairs, key=lambda pair: -pair.log_evidence)


def _formed_pair(
    problem: LinearProblem,
    small: Floats,
    first: Explanation,
    given: list[Floats],
    second: Explanation,
    columns: dict[str, list[Column]],
    modes: dict[str, Floats],
    reference: float,
) -> Pair:
    """Weigh a pair again with what both forms may miss; a second that hardly shows keeps what the screening gave."""
    if second.log_evidence < _WORTH_FORMING:
        both_ways = first.log_evidence + second.log_evidence
        return Pair(first=first, second=second, log_evidence=both_ways, shared=1.0, is_formed=False)
    name = second.effect.name
    if name not in modes:
        modes[name] = _modes(problem, second)
    both = np.hstack([modes[first.effect.name], modes[name]])
    found_in_each = [
        explain_formed(problem, np.hstack([small, shape]), both, columns[name], FORM_SHARES) for shape in given
    ]
    log_z, found = max(found_in_each, key=lambda each: each[0])
    gained = _carried(second.log_evidence, log_z - reference - first.log_evidence)
    shared = _shared(problem, first.contribution, found.contribution)
    log_evidence = first.log_evidence + gained
    return Pair(first=first, second=found, log_evidence=log_evidence, shared=shared, is_formed=True)


def _shared(problem: LinearProblem, first: Floats, second: Floats) -> float:
    """Sum over the equations of the shares of energy that two signatures have there, multiplied."""
    one, other = (np.array(list(problem.sums_by_equation(signature**2).values())) for signature in (first, second))
    return float(one @ other / max(one.sum() * other.sum(), 1e-300))
