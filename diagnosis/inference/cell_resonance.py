"""The load cell's own resonance, where a campaign shows it: a part of the model, and no gap.

All of the force goes through the cell, so a ring has one size only, and a frequency and a damping that are the same in
every trial. What the edges of a force do that no form of the catalogue has right may look like a ring too. So the ring
is compared beside the best effect as it shows that, or the best two, with the best further effect in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from sawbench.bench.plain_digits import rounded
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
from sawbench.diagnosis.inference.effect_columns import weighed_effects
from sawbench.diagnosis.inference.evidence import Catalogue, Explanation, explain
from sawbench.diagnosis.inference.linear_problem import LinearProblem, build_problem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.refining import WeighedAlone, climbed, coefficients
from sawbench.diagnosis.inference.shown_pair import best_shown_pair
from sawbench.modeling.effects.effect import Effect
from sawbench.modeling.effects.known import KnownEffect

# Above this share of the sample rate a filter before the converter takes off what rings, or it appears elsewhere.
_HIGHEST: Final = 0.45
_DIFFERENCE: Final = 1e-3
# A ring that was refined to the end of its range is there but for rounding.
_INSIDE: Final = 1.0 + 1e-6


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
        ringing = None if is_known else cell_resonance(weighed, one)
        if ringing is not None:
            weighed = weighed_effects(build_problem(with_known(campaign, (*known, ringing))))
    return weighed


def cell_resonance(weighed: WeighedAlone, resonance: Effect) -> KnownEffect | None:
    """Resonance of the load cell as a model can hold it.

    Parameters
    ----------
    weighed : WeighedAlone
        Of `weighed_effects`.
    resonance : Effect

    Returns
    -------
    KnownEffect or None
        None where the best further effect of the catalogue explains as much in its place.
    """
    problem = weighed.problem
    forms = columns_in(problem, resonance, _sampled(problem.campaign, resonance))
    if not forms:
        return None
    weighing = _Weighing(weighed)
    found = weighing.likeliest(forms)
    if not (_is_inside(found.ring.column, forms) and weighing.is_shown(found, n_forms=len(forms))):
        return None
    noise = noise_factor_beside(problem, np.hstack([column.of_any_size for column in found.columns]))
    columns = columns_with_noise(problem, weighed.columns, noise)
    weighing = _Weighing(WeighedAlone(with_noise(problem, noise), columns))
    if not weighing.is_shown(found.with_noise(problem, noise), n_forms=len(forms)):
        return None
    return _known(problem, found.ring, noise)


def _is_inside(ring: Column, forms: Sequence[Column]) -> bool:
    """Whether a ring has a frequency between those of its forms: at the end of their range what rings is beyond."""
    name = ring.effect.strength.name
    every = [form.shape[name] for form in forms]
    return min(every) * _INSIDE < ring.shape[name] < max(every) / _INSIDE


@dataclass(frozen=True, kw_only=True, slots=True)
class _Ringing:
    """A ring beside the effect that explains most with it.

    Attributes
    ----------
    ring : Explanation
    base : Column, optional
        Of the effect as the ring shows it; None where the ring is best alone.
    """

    ring: Explanation
    base: Column | None

    @property
    def columns(self) -> list[Column]:
        """Of the ring, and of the effect if there is one."""
        return [self.ring.column, *([] if self.base is None else [self.base])]

    def with_noise(self, problem: LinearProblem, variance: Floats) -> _Ringing:
        """Both whitened for noise whose variance is that much larger, (n,)."""
        ring, *base = columns_with_noise(problem, {"": self.columns}, variance)[""]
        return _Ringing(ring=replace(self.ring, column=ring), base=next(iter(base), None))


class _Weighing:
    """What a ring explains beside the best effects of the catalogue, and what these explain without it."""

    def __init__(self, weighed: WeighedAlone) -> None:
        self._problem, self._alone = weighed.problem, weighed.marginal
        self._catalogue, self._half = weighed.catalogue, weighed.half
        best = [one.column for one in weighed.best[: weighed.problem.settings.forms.n_first]]
        self._given = [(None, self._alone), *((column, self._beside(column)) for column in best)]

    def likeliest(self, forms: Sequence[Column]) -> _Ringing:
        """Best ring, with the effect beside which it is best; both between the forms of the catalogue."""
        rings = Catalogue({"": list(forms)}, self._problem.data)
        half = self._alone.half(rings.stacked)
        given = [(None, self._alone, half), *((c, m, m.half(rings.stacked, half)) for c, m in self._given[1:])]
        base, marginal, ring = max(
            ((base, marginal, rings.explain(marginal, taken)[""]) for base, marginal, taken in given),
            key=lambda each: each[1].log_evidence + each[2].log_evidence,
        )
        pair = None if base is None else best_shown_pair(self._problem, self._alone, forms, base)
        if pair is not None:
            return _Ringing(ring=pair.sensor, base=pair.shown.column)
        return _Ringing(ring=climbed(self._problem, marginal, ring), base=base)

    def is_shown(self, found: _Ringing, *, n_forms: int) -> bool:
        """Whether a ring, the best of so many forms, gains more than the best further effect in its place.

        Beside one effect, or beside two. More by the standard deviation of the log evidence without it, its square
        root; at least by `settings.Report.odds`.
        """
        least = np.log(self._problem.settings.report.odds)
        best, without = max(self._given, key=lambda each: each[1].log_evidence)
        names = [] if best is None else [best.effect.name]
        shown, stacked = self._beside(found.base), self._catalogue.stacked
        half = self._half if best is None else without.half(stacked, self._half)
        for is_last in (False, True):
            ring = explain(shown, [found.ring.column])
            others = self._catalogue.explain(without, half, beside=names)
            further = max((one for name, one in others.items() if name not in names), key=lambda one: one.log_evidence)
            rival = without.log_evidence + max(further.log_evidence, 0.0)
            scatter = max(np.sqrt(max(rival - self._alone.log_evidence, 0.0)), least)
            if ring is not None and shown.log_evidence + ring.log_evidence - np.log(n_forms) - rival > scatter:
                return True
            if is_last:
                break
            names.append(further.effect.name)
            without, shown = (one.beside(further.column.of_any_size) for one in (without, shown))
            half = without.half(stacked, half)
        return False

    def _beside(self, column: Column | None) -> Marginal:
        return self._alone if column is None else self._alone.beside(column.of_any_size)


def _known(problem: LinearProblem, ring: Explanation, noise: Floats) -> KnownEffect:
    """A ring as a model can hold it, its frequency as uncertain as noise, (n,), that nothing explains leaves it."""
    effect, shape = ring.effect, ring.column.shape
    name = effect.strength.name
    (near,) = columns_in(problem, effect, [{**shape, name: (1.0 + _DIFFERENCE) * shape[name]}])
    slope = (near.columns - ring.column.columns) @ coefficients(ring)[:, None] / _DIFFERENCE
    gram, _ = Marginal(with_noise(problem, noise)).gram(stacked_with_noise(problem, [slope], noise))
    return KnownEffect(
        effect=effect, value=rounded(shape[name]), std=rounded(shape[name] / float(np.sqrt(gram[0, 0]))),
        form={key: rounded(value) for key, value in shape.items() if key != name},
    )  # fmt: skip


def _sampled(campaign: Campaign, resonance: Effect) -> list[dict[str, float]]:
    """Forms that ring at a frequency which the force was sampled for."""
    rates_hz = [one.rate_hz for one in campaign.health if one.channel == FORCE.name]
    highest_hz = _HIGHEST * min(rates_hz, default=0.0)
    return [shape for shape in resonance.shapes if shape["frequency_hz"] < highest_hz]
