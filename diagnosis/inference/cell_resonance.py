"""The load cell's own resonance, where a campaign shows it: a part of the model, and no gap.

All of the force goes through the cell, so a ring has one size only, and a frequency and a damping that are the same in
every trial. What the edges of a force do that no form of the catalogue has right may look like a ring too. So the ring
is compared beside the best effect, with the best second effect in its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.units import FORCE
from sawbench.diagnosis.campaign import Campaign, with_known
from sawbench.diagnosis.inference.columns import Column, columns_in
from sawbench.diagnosis.inference.dispersion import (
    columns_with_noise,
    noise_factor_beside,
    stacked_with_noise,
    with_noise,
)
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.evidence import Catalogue, Explanation, explain
from sawbench.diagnosis.inference.linear_problem import LinearProblem, build_problem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.refining import climbed, coefficients, worth_it
from sawbench.diagnosis.inference.shown_pair import best_shown_pair
from sawbench.modeling.effects.effect import Effect
from sawbench.modeling.effects.known import KnownEffect

# Above this share of the sample rate a filter before the converter takes off what rings, or it appears elsewhere.
_HIGHEST: Final = 0.45
_DIFFERENCE: Final = 1e-3


def with_cell_resonance(campaign: Campaign) -> tuple[LinearProblem, dict[str, list[Column]]]:
    """Problem of a campaign and the columns of its effects, with the load cell's resonance in the model if it has one.

    Parameters
    ----------
    campaign : Campaign

    Returns
    -------
    problem : LinearProblem
        Its campaign is the one given, or that with the resonance among what is known.
    columns : dict of str to list of Column
        Of `effect_columns`.
    """
    problem = build_problem(campaign)
    columns = effect_columns(problem)
    for one in campaign.plant.machine.sensor_properties:
        known = campaign.plant.known
        is_known = any(one.name == other.effect.name for other in known)
        ringing = None if is_known else cell_resonance(problem, columns, one)
        if ringing is not None:
            problem = build_problem(with_known(campaign, (*known, ringing)))
            columns = effect_columns(problem)
    return problem, columns


def cell_resonance(
    problem: LinearProblem, columns: Mapping[str, Sequence[Column]], resonance: Effect
) -> KnownEffect | None:
    """Resonance of the load cell as a model can hold it.

    Parameters
    ----------
    problem : LinearProblem
    columns : mapping of str to sequence of Column
        Of `effect_columns`.
    resonance : Effect

    Returns
    -------
    KnownEffect or None
        None where the best second effect of the catalogue explains as much in its place.
    """
    forms = columns_in(problem, resonance, _sampled(problem.campaign, resonance))
    if not forms:
        return None
    effects = {name: list(entries) for name, entries in columns.items() if entries}
    rough = _likeliest(problem, effects, forms)
    if not rough.is_shown:
        return None
    shown = [rough.ring.column, *([] if rough.base is None else [rough.base])]
    noise = noise_factor_beside(problem, np.hstack([column.of_any_size for column in shown]))
    scaled = columns_with_noise(problem, {**effects, resonance.name: forms}, noise)
    found = _likeliest(with_noise(problem, noise), scaled, scaled.pop(resonance.name))
    if not found.is_shown:
        return None
    base = found.base and next(c for c in effects[found.base.effect.name] if c.is_form_of(found.base))
    return _known(problem, _refined(problem, forms, found.ring.column.shape, base), noise)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Ringing:
    """The likeliest ring.

    Attributes
    ----------
    ring : Explanation
        Beside the effect that leaves most evidence with it.
    base : Column, optional
        Best form of that effect; None where the ring is best alone.
    gained : float
        Log evidence beyond that of the best effect with the best second one in the ring's place.
    scatter : float
        Standard deviation of that one's log evidence, its square root; at least `settings.Report.odds`.
    """

    ring: Explanation
    base: Column | None
    gained: float
    scatter: float

    @property
    def is_shown(self) -> bool:
        return self.gained > self.scatter


def _likeliest(problem: LinearProblem, effects: dict[str, list[Column]], forms: Sequence[Column]) -> _Ringing:
    alone, catalogue = Marginal(problem), Catalogue(effects, problem.data)
    half = alone.half(catalogue.stacked)
    found = worth_it(catalogue.explain(alone, half), problem.settings.forms.worth_forming)
    best = [None, *(e.column for e in found[: problem.settings.forms.n_first])]
    given = [alone if column is None else alone.beside(column.of_any_size) for column in best]
    rings = [
        (explain(marginal, forms), column, marginal.log_evidence) for marginal, column in zip(given, best, strict=True)
    ]
    ring, base, with_ring = max(
        ((ring, column, before + ring.log_evidence) for ring, column, before in rings if ring is not None),
        key=lambda each: each[2],
    )
    first = max(range(len(given)), key=lambda k: given[k].log_evidence)
    column = best[first]
    names = () if column is None else (column.effect.name,)
    of_first = half if column is None else given[first].half(catalogue.stacked, half)
    seconds = catalogue.explain(given[first], of_first, beside=names)
    second = max((e.log_evidence for name, e in seconds.items() if name not in names), default=0.0)
    without = given[first].log_evidence + max(second, 0.0)
    scatter = max(np.sqrt(max(without - alone.log_evidence, 0.0)), np.log(problem.settings.report.odds))
    return _Ringing(ring=ring, base=base, gained=with_ring - without, scatter=float(scatter))


def _refined(
    problem: LinearProblem, forms: Sequence[Column], shape: dict[str, float], base: Column | None
) -> Explanation:
    """Refine the ring, from a shape of its forms, beside an effect as the ring shows that."""
    alone = Marginal(problem)
    pair = None if base is None else best_shown_pair(problem, alone, forms, base)
    if pair is not None:
        return pair.sensor
    marginal = alone if base is None else alone.beside(base.of_any_size)
    begun = explain(marginal, [form for form in forms if form.shape == shape])
    assert begun is not None
    return climbed(problem, marginal, begun)


def _known(problem: LinearProblem, ring: Explanation, noise: Floats) -> KnownEffect:
    """A ring as a model can hold it, its frequency as uncertain as noise, (n,), that nothing explains leaves it."""
    effect, shape = ring.effect, ring.column.shape
    name = effect.strength.name
    (near,) = columns_in(problem, effect, [{**shape, name: (1.0 + _DIFFERENCE) * shape[name]}])
    slope = (near.columns - ring.column.columns) @ coefficients(ring)[:, None] / _DIFFERENCE
    gram, _ = Marginal(with_noise(problem, noise)).gram(stacked_with_noise(problem, [slope], noise))
    return KnownEffect(
        effect=effect, value=_rounded(shape[name]), std=_rounded(shape[name] / float(np.sqrt(gram[0, 0]))),
        form={key: _rounded(value) for key, value in shape.items() if key != name},
    )  # fmt: skip


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")


def _sampled(campaign: Campaign, resonance: Effect) -> list[dict[str, float]]:
    """Forms that ring at a frequency which the force was sampled for."""
    rates_hz = [one.rate_hz for one in campaign.health if one.channel == FORCE.name]
    highest_hz = _HIGHEST * min(rates_hz, default=0.0)
    return [shape for shape in resonance.shapes if shape["frequency_hz"] < highest_hz]
