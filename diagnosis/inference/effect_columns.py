"""Every form that effects are weighed in: those of the catalogue, between these, and as a distorting sensor shows them.

Where two effects leave more than an intact machine does, and one of them is a sensor's that is late, lags or rings, the
other may be what that sensor makes of it: a force that comes a third of a period late has another phase.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.columns import Column, Distortion, catalogue_columns, columns_in, known_parts
from sawbench.diagnosis.inference.dispersion import noise_factor_beside
from sawbench.diagnosis.inference.evidence import Catalogue, Explanation, explain
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.refining import (
    add_form,
    climbed,
    coefficients,
    likeliest_pairs,
    refined,
    worth_it,
)
from sawbench.diagnosis.inference.settings import SETTINGS

# Of refining the effect of a sensor, and another one as that sensor shows it; and how many others are.
_N_TURNS: Final = 2
_N_REFINED: Final = 3


def effect_columns(problem: LinearProblem) -> dict[str, list[Column]]:
    """Signatures of every effect of the plant, in all forms: what `judge` weighs.

    Parameters
    ----------
    problem : LinearProblem

    Returns
    -------
    dict of str to list of Column
        By effect; an empty list where the campaign shows nothing of it.
    """
    columns = refined(problem, catalogue_columns(problem, problem.campaign.plant.effects))
    for column in _as_shown(problem, columns):
        add_form(columns, column)
    return columns


def _as_shown(problem: LinearProblem, columns: dict[str, list[Column]]) -> list[Column]:
    """Best forms of effects as the likeliest effects of sensors show them, and of these beside them."""
    alone = Marginal(problem)
    pairs = likeliest_pairs(problem, alone, Catalogue(columns, problem.data))
    # Of two sensors the second begins: alone, the first stands for what both do.
    ordered = [pair[::-1] if pair[1].effect.distorts is not None else pair for pair in pairs]
    of_sensors = [(sensor, other) for sensor, other in ordered if sensor.effect.distorts is not None]
    if not of_sensors:
        return []
    likeliest, _ = of_sensors[0]
    rows = distortion_of(likeliest).rows(problem)
    left = noise_factor_beside(problem, np.hstack([e.column.of_any_size for e in pairs[0]]))[rows]
    if left.max(initial=1.0) <= 1.0 + SETTINGS.ladder.left_by_an_intact:
        return []
    others = _others_shown(problem, alone, columns, likeliest)
    starts = [(sensor.effect.name, other.column) for sensor, other in of_sensors[:_N_REFINED]]
    starts += [(likeliest.effect.name, other.column) for other in others[:_N_REFINED]]
    refined_forms = on_two_cores(
        lambda start: _in_turn(problem, alone, columns, *start), starts, known=known_parts(columns)
    )
    return [column for forms in refined_forms for column in forms]


def _others_shown(
    problem: LinearProblem, alone: Marginal, columns: Mapping[str, Sequence[Column]], sensor: Explanation
) -> list[Explanation]:
    """Effects that explain more beside one of a sensor, each as that shows it, most of it first."""
    distortion, name = distortion_of(sensor), sensor.effect.name
    rows = distortion.rows(problem)
    acting = [
        found[0].effect
        for other, found in columns.items()
        if other != name and any(column.columns[rows].any() for column in found)
    ]
    shown = on_two_cores(
        lambda effect: columns_in(problem, effect, effect.shapes, distortion), acting, known=known_parts(columns)
    )
    catalogue = Catalogue({effect.name: forms for effect, forms in zip(acting, shown, strict=True)}, problem.data)
    found = catalogue.explain(alone.beside(sensor.column.of_any_size), beside=(name,))
    return worth_it(found, problem.settings.forms.worth_forming)


def _in_turn(
    problem: LinearProblem, alone: Marginal, columns: Mapping[str, Sequence[Column]], name: str, other: Column
) -> list[Column]:
    """Best form of an effect of a sensor beside another effect, and of that as the sensor shows it, in turn.

    Two effects of sensors change parts: each is refined as the other one shows it. None where what the sensor shows
    explains no more than the effect itself.
    """
    of_sensor = columns[name]
    sensor = _refined(problem, alone, beside=other, forms=of_sensor)
    known, distortion = sensor.column, distortion_of(sensor)
    shapes = {column.effect.name: _alike(column) for column in (known, other)}
    itself = explain(alone.beside(known.of_any_size), columns[other.effect.name])
    least = -np.inf if itself is None else itself.log_evidence + problem.settings.forms.worth_forming
    pair: list[Column] = []
    for _ in range(_N_TURNS):
        forms = columns_in(problem, other.effect, shapes[other.effect.name], distortion)
        if not forms:
            break
        found = _refined(problem, alone, beside=known, forms=forms)
        if not pair and found.log_evidence < least:
            break
        shown = found.column
        pair = [known, shown]
        shapes[other.effect.name] = [shown.shape]
        if other.effect.distorts is None:
            sensor = _refined(problem, alone, beside=shown, forms=of_sensor)
            known, distortion = sensor.column, distortion_of(sensor)
        else:
            plain = columns_in(problem, other.effect, [shown.shape])
            if not plain:
                break
            other, known, distortion = known, plain[0], distortion_of(found)
    return pair


def _refined(problem: LinearProblem, alone: Marginal, *, beside: Column, forms: Sequence[Column]) -> Explanation:
    """Best form of one effect beside a form of another, between those of the catalogue."""
    marginal = alone.beside(beside.of_any_size)
    found = explain(marginal, forms)
    assert found is not None
    return climbed(problem, marginal, found)


def _alike(column: Column) -> list[dict[str, float]]:
    """Shapes of an effect that differ from one in numbers that are continuous alone."""
    effect, shape = column.effect, column.shape
    choices = {name: value for name, value in shape.items() if name not in effect.continuous}
    return [shape, *(other for other in effect.shapes if choices.items() <= other.items())]


def distortion_of(sensor: Explanation) -> Distortion:
    """How a sensor distorts by the size that its effect was found with."""
    found: Floats = coefficients(sensor) * sensor.effect.strength.typical
    return Distortion(effect=sensor.effect, shape=sensor.column.shape, coefficients=tuple(found.tolist()))
