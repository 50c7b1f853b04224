"""The term that no catalogue lists, learned from the residuals: which equation, which quantities, which function.

A term is a tensor product of cubic splines over one to three measured quantities. The values at its nodes are
Gaussian beforehand, alike where the quantities are alike (a smoothing prior, O'Hagan 1978), so that with whatever
may be mistuned it stays one linear problem. Candidates are weighed by what they predict of operating points that were
withheld: sum of squares of the whitened residuals there. Of all whose prediction is within one standard error
(paired, over the operating points) of the best one, the simplest is taken (Breiman et al. 1984, section 3.4.3).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from types import MappingProxyType
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.features import wave_of
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Part
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.standard_error import exceeds_its_error
from sawbench.modeling.effects.learned import (
    MOST_QUANTITIES,
    QUANTITIES,
    LearnedTerm,
    Site,
    node_weights,
    placed,
)
from sawbench.modeling.residuals import Baseline, Equation
from sawbench.modeling.state import TWO_PI

# Nodes of a quantity where there are one, two or three, and of the crank angle.
_N_NODES: Final = {1: 10, 2: 7, 3: 5}
_N_ANGLES: Final = {1: 32, 2: 20, 3: 12}
_NUMBERS: Final = SETTINGS.learning
_LEAST_VARIANCE, _MOST_COLUMNS = 1e-4, 60
# What an equation predicts is no quantity of its own term: with it any gap explains itself.
_PREDICTED: Final[Mapping[Site, str]] = MappingProxyType(
    {"mechanical": "motor_current_a", "cutting": "force_n", "force_reading": "force_n"}
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Candidate:
    """What a term may depend on.

    Attributes
    ----------
    site : Site
    quantities : tuple of str
    is_cutting_only : bool
    length : float
        Over which its values are alike, as a share of the range.
    """

    site: Site
    quantities: tuple[str, ...]
    is_cutting_only: bool
    length: float = _NUMBERS.smooth


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Design:
    """A candidate on a campaign.

    Attributes
    ----------
    candidate : Candidate
    nodes : tuple of tuple of float
    roots : tuple of ndarray, shape (n_nodes, r)
        Of each quantity: values at the nodes for one standard deviation of each mode.
    kept : ndarray of int, shape (n_quantities, m)
        Which mode of each quantity each column is a product of.
    scale : float
        Prior standard deviation of the term, in the unit of its site.
    columns : ndarray, shape (n, m)
        Whitened, for one standard deviation each.
    """

    candidate: Candidate
    nodes: tuple[tuple[float, ...], ...]
    roots: tuple[Floats, ...]
    kept: np.ndarray
    scale: float
    columns: Floats

    def modes(self, measured: Sequence[Floats]) -> Floats:
        """Term at measured quantities, shape (m, ...), for one standard deviation of each column."""
        shape = measured[0].shape
        found = np.full((self.kept.shape[1], measured[0].size), self.scale)
        for name, nodes, root, kept, values in zip(
            self.candidate.quantities, self.nodes, self.roots, self.kept, measured, strict=True
        ):
            weights = node_weights(nodes, values.ravel(), is_periodic=QUANTITIES[name].is_periodic)
            found *= (weights @ root).T[kept]
        return found.reshape(-1, *shape)

    def at_nodes(self) -> Floats:
        """Term at the nodes, shape (m, len(nodes[0]), ...)."""
        return self.modes(np.meshgrid(*self.nodes, indexing="ij"))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Learned:
    """What was chosen.

    Attributes
    ----------
    term : LearnedTerm
    rel_std : float
        Standard uncertainty of the term over its size, root mean squares over the campaign.
    columns : ndarray, shape (n, m)
        Whitened, times their prior standard deviation.
    contribution : ndarray, shape (n,)
        Whitened signature of the term.
    visited : tuple of ndarray
        Of each quantity, the values at which it was learned.
    """

    term: LearnedTerm
    rel_std: float
    columns: Floats
    contribution: Floats
    visited: tuple[Floats, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Strokes:
    """Running strokes of one part, with every quantity that was measured, in the shape of its smooth state."""

    part: Part
    measured: dict[str, Floats]


def learn(problem: LinearProblem, withheld: Callable[[Floats], Floats]) -> Learned | None:
    """Choose and fit a term.

    Parameters
    ----------
    problem : LinearProblem
        Of a saw.
    withheld : callable
        Whitened columns, shape (n, m) -> sum of squares that re-tuned parameters and they leave of each group of trials
        that is withheld in turn, shape (n_groups,), of at least two groups: `answer.hold_out.HoldOut.free_errors`.

    Returns
    -------
    Learned or None
        None where no candidate predicts withheld groups better than re-tuned parameters alone.
    """
    baseline = problem.campaign.baseline
    assert isinstance(baseline, Baseline)
    strokes = [_strokes(baseline, part) for part in problem.parts if part.state.kind == "running"]
    scales = _scales(problem, Marginal(problem).rest(problem.data))

    def tried(candidates: Iterable[Candidate]) -> list[tuple[Design, Floats]]:
        designs = (_design(problem, strokes, c, scales[c.site]) for c in dict.fromkeys(candidates))
        return _best_first((d, withheld(d.columns)) for d in designs if d is not None)

    domains = (False, True) if any(one.part.setting.is_idle for one in strokes) else (False,)
    found = best = tried(
        Candidate(site=site, quantities=(name,), is_cutting_only=only)
        for site, name, only in product(scales, QUANTITIES, domains)
        if name != _PREDICTED.get(site)
    )
    for _ in range(MOST_QUANTITIES - 1):
        best = tried(more for design, _ in best[: _NUMBERS.beam] for more in _with_one_more(design.candidate))
        found = _best_first([*found, *best])
    rough = tried(replace(design.candidate, length=_NUMBERS.rough) for design, _ in found[: _NUMBERS.beam])
    chosen = _simplest([*found, *rough], withheld(np.zeros((len(problem.data), 0))))
    return None if chosen is None else _fitted(problem, strokes, chosen)


def _with_one_more(candidate: Candidate) -> list[Candidate]:
    """Candidates with one quantity more, in the order of the table."""
    taken = candidate.quantities
    return [
        replace(candidate, quantities=tuple(q for q in QUANTITIES if q in {*taken, name}))
        for name in QUANTITIES
        if name not in taken and name != _PREDICTED.get(candidate.site)
    ]


def _best_first(found: Iterable[tuple[Design, Floats]]) -> list[tuple[Design, Floats]]:
    return sorted(found, key=lambda entry: float(entry[1].sum()))


def _simplest(found: Sequence[tuple[Design, Floats]], nothing: Floats) -> Design | None:
    """Fewest quantities, then the smoother, then the best, of all hardly worse than the best; None for none at all."""
    if not found:
        return None
    _, least = _best_first(found)[0]

    def is_alike(errors: Floats) -> bool:
        more = errors - least
        return not exceeds_its_error(more)

    if is_alike(nothing):
        return None
    alike = [(len(d.nodes), d.candidate.length == _NUMBERS.rough, float(e.sum()), k) for k, (d, e) in enumerate(found)
             if is_alike(e)]  # fmt: skip
    return found[min(alike)[-1]][0]


def _strokes(baseline: Baseline, part: Part) -> _Strokes:
    state = part.smooth
    found = {name: quantity.of(baseline, state) for name, quantity in QUANTITIES.items()}
    return _Strokes(
        part=part,
        measured={n: np.broadcast_to(v, state.angle_rad.shape) for n, v in found.items() if v is not None},
    )


def _scales(problem: LinearProblem, rest: Floats) -> dict[Site, float]:
    """Sites that hold much of what parameters leave, most first, each with the root mean square of that in its unit.

    None where the run-up holds most: a term that is silent there would only make up for what it does to parameters.
    """
    places = problem.rows_by_equation()
    sums: dict[tuple[Equation, str], float] = {
        k: float(np.sum(rest[p] ** 2 - problem.quiet)) for k, p in places.items()
    }
    excess: dict[Equation, float] = {
        equation: v for (equation, kind), v in sums.items() if kind == "running" and v > 0.0
    }
    if sum(v for (_, kind), v in sums.items() if kind == "start_up" and v > 0.0) > sum(excess.values()):
        return {}
    chosen: list[Equation] = sorted(excess, key=lambda e: -excess[e])[: _NUMBERS.most_sites]
    chosen = [e for e in chosen if excess[e] >= _NUMBERS.least_excess * sum(excess.values())]
    found: dict[Site, float] = {e: _size(problem, rest, e) for e in chosen}
    if "cutting" in found:
        found["force_reading"] = found["cutting"]
    return found


def _size(problem: LinearProblem, whitened: Floats, equation: Equation) -> float:
    """Root mean square over the strokes of one equation's residual, in its unit."""
    angle = (np.arange(problem.parts[0].smooth.angle_rad.shape[1]) + 0.5) * TWO_PI
    angle /= len(angle)
    squares = [
        float(np.mean(wave_of(row, angle) ** 2))
        for part in problem.parts
        if part.state.kind == "running" and equation in part.layout.equations
        for row in part.unwhiten(whitened)[:, part.layout.slices[equation]]
    ]
    return float(np.sqrt(np.mean(squares))) if squares else 0.0


def _design(problem: LinearProblem, strokes: Sequence[_Strokes], candidate: Candidate, size: float) -> Design | None:
    """Lay a candidate out; None where a quantity was not measured everywhere, or does not vary."""
    counted = [one for one in strokes if not (candidate.is_cutting_only and one.part.setting.is_idle)]
    names = candidate.quantities
    if size <= 0.0 or not counted or not all(name in one.measured for one in counted for name in names):
        return None
    nodes, roots = [], []
    for name in names:
        found = _nodes([one.measured[name] for one in counted], name, len(names))
        if found is None:
            return None
        nodes.append(found)
        roots.append(_root(found, candidate.length, is_periodic=QUANTITIES[name].is_periodic))
    empty = Design(
        candidate=candidate, nodes=tuple(nodes), roots=tuple(roots), kept=_kept(roots), scale=_NUMBERS.generous * size,
        columns=np.zeros((len(problem.data), 0)),
    )  # fmt: skip
    columns = np.zeros((len(problem.data), empty.kept.shape[1]))
    for one in counted:
        waves = empty.modes([one.measured[name] for name in names])
        columns[one.part.place] = _whitened(problem, one.part, candidate.site, waves)
    return replace(empty, columns=columns)


def _whitened(problem: LinearProblem, part: Part, site: Site, waves: Floats) -> Floats:
    """Columns of one part for waves at a site, shape (features of the part, m)."""
    baseline = problem.campaign.baseline
    assert isinstance(baseline, Baseline)
    kept = baseline.evaluable_equations(part.smooth)
    signatures = [placed(baseline, part.smooth, site, wave) for wave in waves]
    return part.whiten_all([{e: w for e, w in s.items() if e in kept} for s in signatures]).T


def _nodes(values: Sequence[Floats], name: str, n_quantities: int) -> tuple[float, ...] | None:
    if QUANTITIES[name].is_periodic:
        return tuple(float(v) for v in np.arange(_N_ANGLES[n_quantities]) * TWO_PI / _N_ANGLES[n_quantities])
    low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
    if high - low <= _NUMBERS.least_range * max(abs(low), abs(high)):
        return None
    return tuple(float(v) for v in np.linspace(low, high, _N_NODES[n_quantities]))


def _root(nodes: tuple[float, ...], length: float, *, is_periodic: bool) -> Floats:
    """Principal axes of the prior of the values at the nodes, shape (n_nodes, n_nodes), largest first."""
    place = np.array(nodes)
    apart = np.subtract.outer(place, place)
    if is_periodic:
        kernel = np.exp(-2.0 * (np.sin(0.5 * apart) / (TWO_PI * _NUMBERS.turn_share * length)) ** 2)
    else:
        kernel = np.exp(-0.5 * (apart / (length * (place[-1] - place[0]))) ** 2)
    values, vectors = np.linalg.eigh(_NUMBERS.level + kernel)
    return vectors[:, ::-1] * np.sqrt(np.maximum(values[::-1], 0.0) / (1.0 + _NUMBERS.level))


def _kept(roots: Sequence[Floats]) -> np.ndarray:
    """Products of modes that hold most of the prior variance, shape (n_quantities, m)."""
    variances = [np.sum(root**2, axis=0) for root in roots]
    together = variances[0]
    for more in variances[1:]:
        together = np.multiply.outer(together, more)
    order = np.argsort(-together, axis=None)[:_MOST_COLUMNS]
    order = order[together.ravel()[order] > _LEAST_VARIANCE * together.max()]
    return np.array(np.unravel_index(order, together.shape))


def _fitted(problem: LinearProblem, strokes: Sequence[_Strokes], design: Design) -> Learned:
    """Fit to all trials, parameters held by their stated uncertainty; noise raised to what is left."""
    whole = np.hstack([problem.nuisance, design.columns])
    covariance = np.linalg.inv(np.eye(whole.shape[1]) + whole.T @ whole)
    solution = covariance @ (whole.T @ problem.data)
    rest = problem.data - whole @ solution
    n = problem.nuisance.shape[1]
    raised = max(float(rest @ rest) / len(rest) / problem.quiet, 1.0)
    coefficients, root = solution[n:], np.linalg.cholesky(raised * covariance[n:, n:])
    candidate = design.candidate
    at_nodes = design.at_nodes()
    term = LearnedTerm(
        site=candidate.site,
        quantities=candidate.quantities,
        nodes=design.nodes,
        values=np.tensordot(coefficients, at_nodes, axes=1),
        stds=np.sqrt(np.sum(np.tensordot(root.T, at_nodes, axes=1) ** 2, axis=0)),
        is_cutting_only=candidate.is_cutting_only,
    )
    counted = [one for one in strokes if not (candidate.is_cutting_only and one.part.setting.is_idle)]
    visited = tuple(np.concatenate([one.measured[name].ravel() for one in counted]) for name in candidate.quantities)
    modes = design.modes(visited)
    size = float(np.sqrt(np.mean((coefficients @ modes) ** 2)))
    return Learned(
        term=term,
        rel_std=float(np.sqrt(np.mean(np.sum((root.T @ modes) ** 2, axis=0)))) / max(size, 1e-12),
        columns=design.columns,
        contribution=design.columns @ coefficients,
        visited=visited,
    )
