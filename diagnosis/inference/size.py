"""How large a named effect is, if nature's form is some mixture of the catalogue's.

The evidence looks for the best single form. Nature's lies between them: what the best form misses, the nuisances
make up for at little cost (one per cent of a gain, a resistance that is a little off, a little of another effect), and
they take a part of the size with them, up to half of it. Where every form of an effect states the same number in the
same place (a voltage at 10 A, a force for 20 mm), any sum of them with positive weights is a form of it too, and its
size is the sum of the weights. The weights are found by non-negative least squares together with the nuisances. Noise
is scaled by dispersion, as the weighing scales it, and by a temperature that sizes have of their own; priors are not:
what a nuisance may hide is known no better on a quiet bench.

Background effects widen the stated uncertainty but does not move the size, for what the form still misses
would be taken for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.columns import Column, forms_beside
from sawbench.diagnosis.inference.dispersion import stacked_with_noise, with_noise
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal

# What nuisances leave of a form's square, at least, for it to have a weight; and what a form that is nearly the sum of
# others has of its own: there the weights are shared evenly.
_LEAST_SHOWN = 1e-7
_RIDGE = 1e-9
_SAME = 1e-9


def is_mixable(columns: Sequence[Column]) -> bool:
    """Whether a sum of the forms has the sum of their sizes: each is one column, and its amplitude is the number.

    Give or take the sign, which the form may hold (a drift up or down).
    """
    return all(
        c.effect.size_of is None and c.columns.shape[1] == 1 and abs(abs(_direction(c)) - 1.0) < _SAME for c in columns
    )


def _direction(column: Column) -> float:
    """Reported number over amplitude, where that is all there is to it; else not a number of magnitude one."""
    one, two = (column.effect.reported_strength(amplitude, column.shape) for amplitude in (1.0, 2.0))
    return one if abs(two - 2.0 * one) < _SAME else np.nan


def mixed(
    problem: LinearProblem,
    member: Explanation,
    columns: Sequence[Column],
    *,
    beside: Sequence[Explanation],
    small: Mapping[str, Floats],
    dispersion: Floats | float,
) -> Explanation:
    """State the size of an effect over mixtures of its forms.

    Parameters
    ----------
    problem : LinearProblem
    member : Explanation
        Of the effect; what else it says is kept.
    columns : sequence of Column
        All forms of the effect.
    beside : sequence of Explanation
        Other effects of the same cause: of any size, in their best form.
    small : mapping of str to ndarray, shape (n, q)
        Nuisance columns of the background effects, by its name.
    dispersion : ndarray, shape (n,), or float
        Factor on the noise's variance.

    Returns
    -------
    Explanation
        With `mixture`; as it was where the forms cannot be mixed, or where single strokes have said the size.
    """
    if member.mixture is not None or not is_mixable(columns):
        return member
    variance = problem.settings.forms.size_temperature * dispersion
    named = {member.effect.name, *(other.effect.name for other in beside)}
    fixed = [other.column.of_any_size for other in beside]
    others = [entries for name, entries in small.items() if name not in named]
    scaled = with_noise(problem, variance)
    stacked = stacked_with_noise(problem, [c.columns for c in columns], variance)
    signs = np.array([_direction(c) for c in columns])
    marginal = Marginal(scaled, extra=stacked_with_noise(problem, fixed, variance))
    size, known, _ = _sum_of_weights(marginal, stacked, signs)
    beside_little = marginal.beside(stacked_with_noise(problem, others, variance))
    _, whole, shared = _sum_of_weights(beside_little, stacked, signs)
    std = max(whole, min(shared, problem.settings.forms.most_std * abs(size)))
    return replace(member, mixture=(size, std)) if np.isfinite(known + std) else member


def sized(
    problem: LinearProblem,
    members: Sequence[Explanation],
    columns: Mapping[str, Sequence[Column]],
    *,
    small: Mapping[str, Floats],
    dispersion: Floats | float,
) -> list[Explanation]:
    """State the sizes of all effects of one cause; see `mixed`.

    Parameters
    ----------
    problem : LinearProblem
    members : sequence of Explanation
    columns : mapping of str to sequence of Column
        By effect.
    small : mapping of str to ndarray, shape (n, q)
    dispersion : ndarray, shape (n,), or float

    Returns
    -------
    list of Explanation
    """
    names = {member.effect.name for member in members}
    return [
        mixed(
            problem, member, forms_beside(columns[member.effect.name], names),
            beside=[other for other in members if other is not member], small=small, dispersion=dispersion,
        )
        for member in members
    ]  # fmt: skip


def together(problem: LinearProblem, members: Sequence[Explanation], *, dispersion: Floats) -> list[Explanation]:
    """Sizes of several effects that act at once, by least squares with the nuisances.

    Parameters
    ----------
    problem : LinearProblem
    members : sequence of Explanation
        Their forms are kept.
    dispersion : ndarray, shape (n,)
        Factor on the noise's variance.

    Returns
    -------
    list of Explanation
        With amplitude, its standard deviation and contribution in the presence of the others.
    """
    stacked = stacked_with_noise(problem, [m.column.columns for m in members], dispersion)
    gram, moment = Marginal(with_noise(problem, dispersion)).gram(stacked)
    covariance = np.linalg.pinv(gram)
    solution = covariance @ moment
    found, start = [], 0
    for member in members:
        place = slice(start, start + member.column.columns.shape[1])
        start = place.stop
        size = solution[place]
        spread = np.sqrt(np.maximum(np.diag(covariance)[place], 0.0))
        found.append(
            replace(
                member,
                amplitude=member.effect.amplitude(size),
                amplitude_std=float(spread[0] if len(size) == 1 else np.sqrt(0.5 * np.sum(spread[:2] ** 2))),
                contribution=member.column.columns @ size,
            )
        )
    return found


def _sum_of_weights(marginal: Marginal, columns: Floats, signs: Floats) -> tuple[float, float, float]:
    """Sum of the non-negative weights of columns, shape (n, q), times signs, and two standard deviations of it.

    Only weights above zero are uncertain; without any the sum is 0, known not at all. The first is of the mixture as it
    stands: how much of the effect is there. The second lets the weights be shared otherwise among its forms: those
    with nearly one signature that state different numbers make a size uncertain, never doubtful.
    """
    from scipy.optimize import nnls

    gram, moment = marginal.gram(columns)
    shown = np.diag(gram) > _LEAST_SHOWN * np.sum(columns**2, axis=0)
    if not shown.any():
        return 0.0, np.inf, np.inf
    gram, moment, signs = gram[np.ix_(shown, shown)], moment[shown], signs[shown]
    scale = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    root = np.sqrt(np.maximum(values, _RIDGE))
    correlation = (vectors * root**2) @ vectors.T
    weights, _ = nnls(root[:, None] * vectors.T, vectors.T @ (moment / scale) / root, maxiter=100 * len(scale))
    kept = weights > 0.0
    if not kept.any():
        return 0.0, np.inf, np.inf
    each, found = (signs / scale)[kept], weights[kept]
    correlation = correlation[np.ix_(kept, kept)]
    size, variance = float(each @ found), float(each @ np.linalg.inv(correlation) @ each)
    of_whole = size**2 / float(found @ correlation @ found)
    return size, float(np.sqrt(of_whole)), float(np.sqrt(max(variance, of_whole)))
