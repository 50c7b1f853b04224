"""Whitened signatures of effects, form by form: the columns that are fitted to what a campaign leaves.

A sensor that is late, lags or rings distorts what every effect adds to the force, too: beside it an effect has further
forms, as that sensor shows them. The sum of two signatures would be right for small distortions alone: a force that
comes a third of a period late has another phase than the sensor's own signature of the expected force.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Part
from sawbench.diagnosis.inference.marginal import side_by_side
from sawbench.modeling.effects.effect import Effect, TransferFunction
from sawbench.modeling.effects.transfer import shown_through
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

# Sum of squares of a whitened signature that noise hides.
_HIDDEN = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Distortion:
    """How a sensor that has an effect itself shows what others add.

    Attributes
    ----------
    effect : Effect
        Of the sensor, with `distorts`.
    shape : dict
    coefficients : tuple of float
        Of its signatures, in units of its strength.
    """

    effect: Effect
    shape: dict[str, float]
    coefficients: tuple[float, ...]

    def shown(self, baseline: Baseline, state: State, signatures: Sequence[Signature]) -> Sequence[Signature]:
        """Signatures of another effect as the sensor shows them."""
        return shown_through(baseline, state, signatures, self.transfers(state))

    def rows(self, problem: LinearProblem) -> np.ndarray:
        """Indices of the features of the equations whose terms it distorts."""
        equations = self.transfers(problem.parts[0].smooth)
        return np.concatenate([rows for (name, _), rows in problem.rows_by_equation().items() if name in equations])

    def transfers(self, state: State) -> Mapping[str, TransferFunction]:
        """Transfer functions of the sensor, by equation."""
        assert self.effect.distorts is not None
        return self.effect.distorts(state, self.coefficients, **self.shape)


@dataclass(frozen=True, kw_only=True, slots=True)
class Column:
    """Whitened signature of one effect in one form.

    Attributes
    ----------
    effect : Effect
    shape : dict
    columns : ndarray, shape (n, q)
        For an amplitude of `typical`; q is 2 or more where the phase is free.
    distortion : Distortion, optional
        Of the sensor that shows it: a form that there is beside that effect only.
    """

    effect: Effect
    shape: dict[str, float]
    columns: Floats
    distortion: Distortion | None = None

    def combined(self, baseline: Baseline, state: State, coefficients: Floats) -> Signature:
        """Sum of its signatures on a state times coefficients, in units of the effect's strength."""
        whole = self.effect.combined(baseline, state, self.shape, coefficients)
        return whole if self.distortion is None else self.distortion.shown(baseline, state, [whole])[0]

    @property
    def of_any_size(self) -> Floats:
        """At the largest amplitude that occurs, shape (n, q)."""
        return self.columns * self.effect.strength.high

    def is_there_beside(self, others: Collection[str]) -> bool:
        """Whether it is a form beside effects of these names."""
        return self.distortion is None or self.distortion.effect.name in others

    def is_form_of(self, other: Column) -> bool:
        """Whether both are the same form, whatever the noise that they are whitened for."""
        return self.shape == other.shape and self.distortion == other.distortion


def catalogue_columns(problem: LinearProblem, effects: Sequence[Effect]) -> dict[str, list[Column]]:
    """Whitened signatures of every effect and shape that this campaign can show at all.

    Parameters
    ----------
    problem : LinearProblem
    effects : sequence of Effect

    Returns
    -------
    dict of str to list of Column
        By effect; an empty list where the campaign shows nothing of it.
    """
    # This process begins with those of most forms, whose results are large.
    ordered = sorted(effects, key=lambda effect: -len(effect.shapes))
    found = on_two_cores(lambda effect: _of_typical_size(problem, effect, effect.shapes), ordered)
    by_name = {effect.name: _as_columns(effect, effect.shapes, one) for effect, one in zip(ordered, found, strict=True)}
    return {effect.name: by_name[effect.name] for effect in effects}


def distorting(of_sensor: Sequence[Column], forms: Sequence[Column]) -> list[Column]:
    """Forms of a sensor's effect by which some forms of another effect are distorted."""
    shapes = [form.distortion.shape for form in forms if form.distortion is not None]
    return [column for column in of_sensor if column.distortion is None and column.shape in shapes]


def known_parts(columns: Mapping[str, Sequence[Column]]) -> list[object]:
    """What `on_two_cores` need not send of explanations by some columns: these, and their effects."""
    return [part for entries in columns.values() for column in entries for part in (column, column.effect)]


def columns_in(
    problem: LinearProblem, effect: Effect, shapes: Sequence[dict[str, float]], distortion: Distortion | None = None
) -> list[Column]:
    """`catalogue_columns` of one effect in any forms; without those of which the campaign shows nothing."""
    return _as_columns(effect, shapes, _of_typical_size(problem, effect, shapes, distortion), distortion)


class KeptForms:
    """Columns of one effect, often of the same forms as other distortions show them: these are worked out once."""

    def __init__(self, problem: LinearProblem, effect: Effect) -> None:
        self._problem, self._effect = problem, effect
        self._kept: dict[tuple[int, tuple[tuple[str, float], ...]], tuple[Signature, ...]] = {}

    def columns_in(self, shapes: Sequence[dict[str, float]], distortion: Distortion) -> list[Column]:
        """`columns_in` of the effect."""
        sized = [(shape, self._effect.strength.typical) for shape in shapes]
        found = _signatures(self._problem, self._effect, sized, distortion, worked_out=self._worked_out)
        return _as_columns(self._effect, shapes, found, distortion)

    def _worked_out(self, part: Part, shapes: Sequence[dict[str, float]]) -> list[tuple[Signature, ...]]:
        keys = [(part.place.start, tuple(shape.items())) for shape in shapes]
        missing = [at for at, key in enumerate(keys) if key not in self._kept]
        baseline = self._problem.campaign.baseline
        found = self._effect.signatures_of(baseline, part.smooth, [shapes[at] for at in missing]) if missing else []
        self._kept |= {keys[at]: one for at, one in zip(missing, found, strict=True)}
        return [self._kept[key] for key in keys]


def forms_beside(columns: Sequence[Column], others: Collection[str] = ()) -> list[Column]:
    """Forms that an effect has beside some others: distorted ones only beside the effect that distorts them."""
    return [column for column in columns if column.is_there_beside(others)]


def _of_typical_size(
    problem: LinearProblem, effect: Effect, shapes: Sequence[dict[str, float]], distortion: Distortion | None = None
) -> list[Floats | None]:
    return _signatures(problem, effect, [(shape, effect.strength.typical) for shape in shapes], distortion)


def _as_columns(
    effect: Effect,
    shapes: Sequence[dict[str, float]],
    found: Sequence[Floats | None],
    distortion: Distortion | None = None,
) -> list[Column]:
    return [
        Column(effect=effect, shape=shape, columns=columns, distortion=distortion)
        for shape, columns in zip(shapes, found, strict=True)
        if columns is not None
    ]


def _signatures(
    problem: LinearProblem,
    effect: Effect,
    sized: Sequence[tuple[dict[str, float], float]],
    distortion: Distortion | None = None,
    worked_out: Callable[[Part, Sequence[dict[str, float]]], list[tuple[Signature, ...]]] | None = None,
) -> list[Floats | None]:
    """Whitened signatures of some shapes, each times a strength, (n, q); None where nothing of a typical one shows."""
    if not sized:
        return []
    baseline = problem.campaign.baseline
    of_part = worked_out or (lambda part, shapes: effect.signatures_of(baseline, part.smooth, shapes))
    placed = []
    for part in problem.parts:
        groups = of_part(part, [shape for shape, _ in sized])
        counts, signatures = [len(group) for group in groups], [one for group in groups for one in group]
        for transfers in _transfers(problem, part, distortion):
            signatures = shown_through(baseline, part.smooth, signatures, transfers)
        placed.append((part.place, counts, part.whiten_all(signatures)))
    ends = [np.cumsum([0, *counts]) for _, counts, _ in placed]
    out: list[Floats | None] = []
    for k, (_, strength) in enumerate(sized):
        # Column by column in memory: as they are filled, and as they are put side by side.
        columns = np.zeros((max(counts[k] for _, counts, _ in placed), len(problem.data))).T
        for (place, counts, rows), end in zip(placed, ends, strict=True):
            columns[place, : counts[k]] = rows[end[k] : end[k + 1]].T
        shown = np.isfinite(columns).all() and np.abs(columns).max(initial=0.0) * effect.strength.typical > 1e-9
        columns *= strength
        out.append(columns if shown else None)
    return out


def _transfers(
    problem: LinearProblem, part: Part, distortion: Distortion | None
) -> list[Mapping[str, TransferFunction]]:
    """By what known effects of sensors and one more distort the equations that are compared there."""
    every = [known.transfers(part.smooth) for known in problem.campaign.plant.known]
    if distortion is not None:
        every.append(distortion.transfers(part.smooth))
    return [{name: one for name, one in each.items() if name in part.layout.equations} for each in every if each]


def little_of_each(problem: LinearProblem, columns: Mapping[str, Sequence[Column]]) -> dict[str, Floats]:
    """Nuisance columns for small amounts of every effect, times their prior standard deviation, by its name.

    Parameters
    ----------
    problem : LinearProblem
    columns : mapping of str to sequence of Column
        Of `catalogue_columns`, of the same problem; effects that show nothing are left out.
    """
    found = {}
    for name, entries in columns.items():
        if not entries:
            continue
        effect = entries[0].effect
        if effect.background is None:
            found[name] = _little_of_any_form(forms_beside(entries))
        else:
            sized = [(shape, share * effect.strength.typical) for shape, share in effect.background]
            kept = [little for little in _signatures(problem, effect, sized) if little is not None]
            found[name] = np.hstack([np.zeros((len(problem.data), 0)), *kept])
    return found


def _little_of_any_form(entries: Sequence[Column]) -> Floats:
    """Principal axes of a little of an effect, whose form is any of some, but for what noise hides, shape (n, q)."""
    share = entries[0].effect.background_share / np.sqrt(len(entries))
    each = share * side_by_side([column.columns for column in entries], len(entries[0].columns))
    energy, axes = np.linalg.eigh(each.T @ each)
    return each @ axes[:, np.cumsum(energy) > _HIDDEN]
