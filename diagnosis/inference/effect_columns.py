"""Every form that effects are weighed in: those of the catalogue, between these, and as a distorting sensor shows them.

Where two effects leave more than an intact machine does, and one of them is a sensor's that is late, lags or rings, the
other may be what that sensor makes of it: a force that comes a third of a period late has another phase.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.columns import Column, catalogue_columns, columns_in, known_parts
from sawbench.diagnosis.inference.dispersion import noise_factor_beside
from sawbench.diagnosis.inference.evidence import Catalogue, Explanation
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.refining import WeighedAlone, refined, worth_it
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.inference.shown_pair import best_shown_pair, distortion_of

# Pairs of a sensor's effect and another one that are refined, and others beside the likeliest sensor's.
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
    return weighed_effects(problem).columns


def weighed_effects(problem: LinearProblem) -> WeighedAlone:
    """`effect_columns`, with what each effect explains alone.

    Parameters
    ----------
    problem : LinearProblem
    """
    weighed = refined(WeighedAlone(problem, catalogue_columns(problem, problem.campaign.plant.effects)))
    return weighed.with_forms(_as_shown(weighed))


def _as_shown(weighed: WeighedAlone) -> list[Column]:
    """Best forms of effects as the likeliest effects of sensors show them, and of these beside them."""
    problem, alone, columns = weighed.problem, weighed.marginal, weighed.columns
    pairs = weighed.likeliest_pairs
    # Of two sensors the second begins: alone, the first stands for what both do.
    ordered = [pair[::-1] if pair[1].effect.distorts is not None else pair for pair in pairs]
    of_sensors = [(sensor, other) for sensor, other in ordered if sensor.effect.distorts is not None]
    if not of_sensors:
        return []
    left = noise_factor_beside(problem, np.hstack([e.column.of_any_size for e in pairs[0]]))

    def leaves_much(sensor: Explanation) -> bool:
        rows = distortion_of(sensor).rows(problem)
        return bool(left[rows].max(initial=1.0) > 1.0 + SETTINGS.ladder.left_by_an_intact)

    of_sensors = [(sensor, other) for sensor, other in of_sensors if leaves_much(sensor)]
    if not of_sensors:
        return []
    likeliest, _ = of_sensors[0]
    others = _others_shown(problem, alone, columns, likeliest)
    pairs_to_refine = [*of_sensors[:_N_REFINED], *((likeliest, other) for other in others[:_N_REFINED])]
    starts = {(s.effect.name, o.effect.name): o.column for s, o in reversed(pairs_to_refine)}
    found = on_two_cores(
        lambda names: best_shown_pair(problem, alone, columns[names[0]], starts[names]), list(starts),
        known=known_parts(columns),
    )  # fmt: skip
    return [part.column for pair in found if pair is not None for part in (pair.sensor, pair.shown)]


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
