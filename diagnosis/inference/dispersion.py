"""Noise that is as much larger, equation by equation, as what even the best two effects leave there.

A likelihood whose noise is fixed beforehand is so sure of a strong gap that every prior gives way: parameters move by
twenty standard deviations, small background effects become large ones, and a second effect mops up what the form of
the first one leaves. What a form misses it misses in the equations that it moves: raised everywhere alike, the noise
would drown a second effect in an equation that nothing else has touched; raised to what a single effect leaves, it
would count that second effect itself as noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.columns import Column, distorting
from sawbench.diagnosis.inference.evidence import Catalogue, Explanation
from sawbench.diagnosis.inference.features import orders
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.refining import WeighedAlone


def noise_factor(weighed: WeighedAlone, beyond: Catalogue, ordinary: Floats | None = None) -> Floats:
    """Factor on the noise's variance of every feature.

    Parameters
    ----------
    weighed : WeighedAlone
        Effects of the catalogue.
    beyond : Catalogue
        Causes that have a form but no place there. A little of these is in any bench, but not known well enough to
        trust the equations in which it shows: what it moves counts as noise.
    ordinary : ndarray, shape (n, q), optional
        Nuisance columns of what every bench has beyond those of the problem, times their prior standard deviation.

    Returns
    -------
    ndarray, shape (n,)
        1 where the best effect and the best one of the catalogue beside it leave no more than an intact machine does;
        the same within an equation, while the machine runs and while it starts.
    """
    return _factor(weighed.problem, _rest_of_two(weighed, beyond, ordinary))


def noise_factor_beside(problem: LinearProblem, given: Floats, *, scale: Floats | None = None) -> Floats:
    """`noise_factor` by what columns of any size, (n, q), and nuisances, their priors times `scale`, (p,), leave."""
    return _factor(problem, Marginal(problem, scale=scale, extra=given).rest(problem.data))


def _factor(problem: LinearProblem, rest: Floats) -> Floats:
    factor = np.ones(len(problem.data))
    for rows in _alike(problem):
        factor[rows] = max(1.0, float(np.mean(rest[rows] ** 2)) / problem.quiet)
    return factor


def _alike(problem: LinearProblem) -> list[np.ndarray]:
    """Indices of the features that share a factor: those of an equation, in bands of harmonics where it has any."""
    forms, found = problem.campaign.plant.equations, []
    for (equation, kind), rows in problem.rows_by_equation().items():
        form = forms[equation]
        if not form.noise_bands or kind != "running":
            found.append(rows)
            continue
        order = orders(form.n_harmonics)
        band = np.digitize(order, form.noise_bands)
        by_feature = rows.reshape(-1, len(order))
        found += [by_feature[:, band == k].ravel() for k in range(len(form.noise_bands) + 1)]
    return found


def _rest_of_two(weighed: WeighedAlone, beyond: Catalogue, ordinary: Floats | None) -> Floats:
    """What the nuisances and two effects leave, each of any size.

    The second is the best beside the first, or one of a sensor's that shows the first as its distorted form says.
    """
    problem, marginal, catalogue, half = weighed.problem, weighed.marginal, weighed.catalogue, weighed.half
    if ordinary is not None:
        marginal = marginal.beside(ordinary)
        half = marginal.half(catalogue.stacked, half)
    first = _most_gain([*catalogue.explain(marginal, half).values(), *beyond.explain(marginal).values()])
    given = _of_any_size(problem, first)
    if first is not None:
        beside = marginal.beside(given)
        named = (first.effect.name,)
        seconds = catalogue.explain(beside, beside.half(catalogue.stacked, half), beside=named).values()
        second = _most_gain([e for e in seconds if e.effect.name != first.effect.name])
        given = np.hstack([given, _of_any_size(problem, second)])
    beside = (marginal.beside(pair) for pair in (given, *_shown_pairs(catalogue)))
    return min(beside, key=lambda one: one.misfit).rest(problem.data)


def _shown_pairs(catalogue: Catalogue) -> list[Floats]:
    """Every form of an effect as a sensor shows it with that form of the sensor's effect, of any size, (n, q)."""
    columns = catalogue.columns
    shown = [c for forms in columns.values() for c in forms if c.distortion is not None]
    pairs = [(c, sensor) for c in shown for sensor in distorting(columns[c.distortion.effect.name], [c])]
    return [np.hstack([c.of_any_size, sensor.of_any_size]) for c, sensor in pairs]


def _most_gain(found: Sequence[Explanation]) -> Explanation | None:
    best = max(found, key=lambda e: e.gain, default=None)
    return None if best is None or best.gain <= 0.0 else best


def _of_any_size(problem: LinearProblem, found: Explanation | None) -> Floats:
    """Columns at the largest amplitude that occurs, shape (n, q)."""
    return np.zeros((len(problem.data), 0)) if found is None else found.column.of_any_size


def with_noise(problem: LinearProblem, variance: Floats | float) -> LinearProblem:
    """Whiten all for noise whose variance is that much larger, shape (n,) or one number."""
    share = _share(problem, variance)
    return replace(
        problem, data=share[:, 0] * problem.data, known=share[:, 0] * problem.known, nuisance=share * problem.nuisance
    )  # fmt: skip


def columns_with_noise(
    problem: LinearProblem, columns: dict[str, list[Column]], variance: Floats | float
) -> dict[str, list[Column]]:
    """`with_noise` of the columns of effects."""
    share = _share(problem, variance)
    return {
        name: [replace(column, columns=share * column.columns) for column in entries]
        for name, entries in columns.items()
    }


def catalogue_with_noise(problem: LinearProblem, catalogue: Catalogue, variance: Floats) -> Catalogue:
    """`with_noise` of all columns of a catalogue, for the data of the problem."""
    share = _share(problem, variance)
    return catalogue.rescaled(share, share[:, 0] * problem.data)


def stacked_with_noise(problem: LinearProblem, columns: Sequence[Floats], variance: Floats | float) -> Floats:
    """`with_noise` of columns, each of shape (n, q), side by side; shape (n, 0) where there are none."""
    return _share(problem, variance) * np.hstack([np.zeros((len(problem.data), 0)), *columns])


def background_with_noise(little: Mapping[str, Floats], variance: Floats) -> Floats:
    """Background effects side by side, shape (n, q), scaled twice: noise that large, (n,), holds a part of them."""
    return np.hstack([np.zeros((len(variance), 0)), *(found / variance[:, None] for found in little.values())])


def _share(problem: LinearProblem, variance: Floats | float) -> Floats:
    return np.broadcast_to(1.0 / np.sqrt(variance), problem.data.shape)[:, None]
