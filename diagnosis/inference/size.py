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

Where the number belongs to the form (a stiffness, a delay), the form is there as a whole or not at all: the number is
the one at which the whole form explains most. A form of any amplitude states two numbers, by its shape and by its
amplitude; what they differ by is what nature's form misses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.columns import Column, columns_in, forms_beside
from sawbench.diagnosis.inference.dispersion import stacked_with_noise, with_noise
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.modeling.effects.known import carried

# What nuisances leave of a form's square, at least, for it to have a weight; and what a form that is nearly the sum of
# others has of its own: there the weights are shared evenly.
_LEAST_SHOWN = 1e-7
_RIDGE = 1e-9
_SAME = 1e-9
# Gauss-Newton steps of the logarithm of a number of the form, and the step of its difference quotient.
_N_STEPS, _DIFFERENCE = 4, 1e-3


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
        With `mixture`, of size 0 where no form has a positive weight; as it was where the forms cannot be mixed, or
        where single strokes have said the size.
    """
    if member.mixture is not None or not is_mixable(columns):
        return member
    named = {member.effect.name, *(other.effect.name for other in beside)}
    fixed = [other.column.of_any_size for other in beside]
    others = [entries for name, entries in small.items() if name not in named]
    signs = np.array([_direction(c) for c in columns])

    tempered = problem.settings.forms.size_temperature * dispersion

    def sums(marginal: Marginal, variance: Floats | float) -> tuple[float, float, float]:
        return _sum_of_weights(marginal, stacked_with_noise(problem, [c.columns for c in columns], variance), signs)

    marginal = Marginal(with_noise(problem, tempered), extra=stacked_with_noise(problem, fixed, tempered))
    size, known, _ = sums(marginal, tempered)
    if not size:
        return replace(member, mixture=(0.0, member.amplitude_std))
    _, _, with_form = sums(marginal.beside(stacked_with_noise(problem, others, tempered)), tempered)
    every = stacked_with_noise(problem, [*fixed, *others], dispersion)
    _, by_noise, _ = sums(Marginal(with_noise(problem, dispersion), extra=every), dispersion)
    std = max(by_noise, min(with_form, problem.settings.forms.most_std * abs(size)))
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
    found = []
    for member in members:
        beside = [other for other in members if other is not member]
        forms = forms_beside(columns[member.effect.name], names)
        over_forms = mixed(problem, member, forms, beside=beside, small=small, dispersion=dispersion)
        found.append(as_a_whole(problem, over_forms, beside=beside, dispersion=dispersion))
    return found


def as_a_whole(
    problem: LinearProblem, member: Explanation, *, beside: Sequence[Explanation], dispersion: Floats | float
) -> Explanation:
    """State a number of the form as that at which the whole form explains most.

    Parameters
    ----------
    problem : LinearProblem
    member : Explanation
    beside : sequence of Explanation
        Other effects of the same cause: of any size, in their best form.
    dispersion : ndarray, shape (n,), or float
        Factor on the noise's variance.

    Returns
    -------
    Explanation
        In that form, of amplitude 1: between the number of its shape and the one by its amplitude; half of their
        distance is a standard deviation. As it was where no continuous number of the form grows with the size, and
        where single strokes have said the size.
    """
    key = number_of_form(member.column)
    if key is None or member.mixture is not None or member.amplitude <= 0.0:
        return member
    variance = problem.settings.forms.size_temperature * dispersion
    scaled = with_noise(problem, variance)
    fixed = stacked_with_noise(problem, [other.column.of_any_size for other in beside], variance)
    marginal = Marginal(scaled, extra=fixed)

    def form_at(place: float) -> Column:
        shape = {**member.column.shape, key: float(np.exp(place))}
        return columns_in(problem, member.effect, [shape], member.column.distortion)[0]

    def products(*columns: Floats) -> tuple[Floats, Floats]:
        return marginal.gram(stacked_with_noise(problem, columns, variance))

    place, whole = float(np.log(member.column.shape[key])), member.column
    by_amplitude = float(np.log(carried(member.effect, member.column.shape, key, member.strength)))
    low, high = sorted((place, by_amplitude))
    for _ in range(_N_STEPS):
        slope = (form_at(place + _DIFFERENCE).columns - whole.columns) / _DIFFERENCE
        gram, moment = products(whole.columns, slope)
        better = float(np.clip(place + (moment[1] - gram[1, 0]) / gram[1, 1], low, high))
        nearer = form_at(better)
        its_gram, its_moment = products(nearer.columns)
        if its_moment[0] - 0.5 * its_gram[0, 0] <= moment[0] - 0.5 * gram[0, 0]:
            break
        place, whole = better, nearer
    found = replace(
        member, column=whole, amplitude=1.0, amplitude_std=member.amplitude_std / member.amplitude,
        contribution=whole.columns[:, 0],
    )  # fmt: skip
    by_shape = member.effect.reported_strength(member.effect.strength.typical, member.column.shape)
    missed = 0.5 * abs(member.strength - by_shape) / abs(found.strength - found.absent)
    return replace(found, form_share=float(np.hypot(member.form_share, missed)))


def number_of_form(column: Column) -> str | None:
    """Name of the continuous number of a form that is reported of it, where the amplitude is a part of that.

    Of a frequency or a fraction of the stroke the amplitude says nothing.
    """
    effect, shape = column.effect, column.shape
    one, two = (effect.reported_strength(amplitude * effect.strength.typical, shape) for amplitude in (1.0, 2.0))
    key = next((name for name in effect.carries if shape.get(name)), None)
    return key if one != two and key in effect.continuous else None


def together(
    problem: LinearProblem, marginal: Marginal, members: Sequence[Explanation], *, dispersion: Floats
) -> list[Explanation]:
    """Sizes of several effects that act at once, by least squares with the nuisances.

    Parameters
    ----------
    problem : LinearProblem
    marginal : Marginal
        Of the problem `with_noise` of that dispersion.
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
    gram, moment = marginal.gram(stacked)
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
