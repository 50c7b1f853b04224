"""The load cell's own resonance, where a campaign shows it: a part of the model, and no gap.

A ring has a frequency, a damping and a share of the force that are the same in every trial. What the edges of a force
do that no form of the catalogue has right may look like a ring too. So the ring that the mean strokes show
(`ring_search`) is compared with the best further effect in its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.units import FORCE
from sawbench.diagnosis.campaign import Campaign, with_known
from sawbench.diagnosis.inference.columns import little_of_each
from sawbench.diagnosis.inference.dispersion import (
    background_with_noise,
    columns_with_noise,
    noise_factor_beside,
    with_noise,
)
from sawbench.diagnosis.inference.effect_columns import weighed_effects
from sawbench.diagnosis.inference.evidence import Catalogue, Explanation
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.refining import WeighedAlone
from sawbench.diagnosis.inference.ring_search import likeliest_ring
from sawbench.modeling.effects.effect import Effect
from sawbench.modeling.effects.known import KnownEffect

# Above this share of the sample rate a filter before the converter takes off what rings, or it appears elsewhere.
_HIGHEST: Final = 0.45
# Effects beside which a model with a ring and one without are compared.
_FURTHER: Final = 3


def with_cell_resonance(campaign: Campaign) -> WeighedAlone:
    """Effects of a campaign in all their forms, with the load cell's resonance in the model if it has one.

    Parameters
    ----------
    campaign : Campaign

    Returns
    -------
    WeighedAlone
        Of `weighed_effects`; the campaign of its problem is the one given, or that with the resonance among what is
        known.
    """
    weighed = weighed_effects(build_problem(campaign))
    for one in campaign.plant.machine.sensor_properties:
        known = campaign.plant.known
        is_known = any(one.name == other.effect.name for other in known)
        ring = None if is_known else _ring_of(campaign, one)
        if ring is not None:
            ringing = weighed_effects(build_problem(with_known(campaign, (*known, ring))))
            weighed = ringing if _explains_more(ringing, weighed) else weighed
    return weighed


def _ring_of(campaign: Campaign, resonance: Effect) -> KnownEffect | None:
    """Likeliest ring at a frequency that the force was sampled for."""
    rates_hz = [one.rate_hz for one in campaign.health if one.channel == FORCE.name]
    return likeliest_ring(campaign, resonance, _HIGHEST * min(rates_hz, default=0.0))


def _explains_more(ringing: WeighedAlone, weighed: WeighedAlone) -> bool:
    """Whether a model with a ring explains more than the best further effect does in its place.

    Beside none, one or two effects. More by the standard deviation of the log evidence without it, its square root; at
    least by `settings.Report.odds`; for the noise as it was measured, and for as much as the ring leaves.
    """
    least = np.log(weighed.problem.settings.report.odds)
    noise = np.ones(len(weighed.problem.data))
    with_it, without_it = ((one, little_of_each(one.problem, one.columns)) for one in (ringing, weighed))
    for _ in range(2):
        rung, given = _log_evidences(*with_it, noise)
        plain, _ = _log_evidences(*without_it, noise)
        scatter = max(np.sqrt(max(plain[-1] - plain[0], 0.0)), least)
        if max(with_ring - without for with_ring, without in zip(rung, plain[1:], strict=False)) < scatter:
            return False
        noise = noise_factor_beside(ringing.problem, given)
    return True


def _log_evidences(
    weighed: WeighedAlone, little: Mapping[str, Floats], noise: Floats
) -> tuple[list[float], Floats]:  # fmt: skip
    """Log evidence beside none, one, two and three of the best effects; background and these effects, of any size."""
    problem, columns = with_noise(weighed.problem, noise), columns_with_noise(weighed.problem, weighed.columns, noise)
    marginal = Marginal(problem).beside(background_with_noise(little, noise))
    catalogue = Catalogue(columns, problem.data)
    found, names, given = [marginal.log_evidence], list[str](), [*little.values()]
    for _ in range(_FURTHER):
        best = _best(catalogue, marginal, names)
        if best is not None:
            names.append(best.effect.name)
            marginal = marginal.beside(best.column.of_any_size)
            given += [c.of_any_size for c in weighed.columns[best.effect.name] if c.is_form_of(best.column)]
        found.append(marginal.log_evidence)
    return found, np.hstack(given)


def _best(catalogue: Catalogue, marginal: Marginal, names: Sequence[str]) -> Explanation | None:
    """Effect with the most evidence beside some others, if any has more than none."""
    found = catalogue.explain(marginal, marginal.half(catalogue.stacked), beside=names)
    best = max((e for name, e in found.items() if name not in names), key=lambda e: e.log_evidence, default=None)
    return None if best is None or best.log_evidence <= 0.0 else best
