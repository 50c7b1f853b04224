"""An effect of a sensor and another effect as that sensor shows it, their forms refined together.

What the other effect adds is shown later, smaller or ringing by as much as the sensor's form says: neither form can be
refined while the other one is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.columns import Column, Distortion, KeptForms, columns_in
from sawbench.diagnosis.inference.evidence import Explanation, explain
from sawbench.diagnosis.inference.form_numbers import choices, kind, of_same_choices, ranges
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.refining import climbed, coefficients, gauss_newton

# Forms of the sensor's effect from which it begins: all over the catalogue, for the best one lies in a narrow valley.
_N_BEGUN: Final = 12
# Choices between forms, a device or an order, of which the best are climbed from.
_N_CLIMBED: Final = 2


@dataclass(frozen=True, kw_only=True, slots=True)
class ShownPair:
    """Two effects.

    Attributes
    ----------
    sensor, shown : Explanation
        The effect of the sensor, and the other one as that shows it, each beside the other.
    log_evidence : float
        Of both: that of the data, with sizes of any amount.
    """

    sensor: Explanation
    shown: Explanation
    log_evidence: float


def best_shown_pair(
    problem: LinearProblem, alone: Marginal, of_sensor: Sequence[Column], other: Column
) -> ShownPair | None:
    """Best forms of an effect of a sensor and of another one as it shows that.

    Parameters
    ----------
    problem : LinearProblem
    alone : Marginal
        Nuisances without any effect.
    of_sensor : sequence of Column
        Forms of the sensor's effect.
    other : Column
        Form of the other effect to begin with.

    Returns
    -------
    ShownPair or None
        None where the sensor's effect shows nothing beside the other one, or where what it shows explains no more than
        the other effect itself.
    """
    own = [form for form in of_sensor if form.distortion is None]
    beside_other = alone.beside(other.of_any_size)
    as_they_are = explain(beside_other, own)
    if as_they_are is None:
        return None
    as_they_are = climbed(problem, beside_other, as_they_are)
    pairs = _Pairs(problem, alone, other, beside_other)
    begun = pairs.best_of_each_choice([as_they_are.column, *own[:: max(len(own) // _N_BEGUN, 1)]], other.shape)
    same = of_same_choices(other)
    # The law that is best by itself need not be the best one as the sensor shows it.
    laws = [same, [shape for shape in other.effect.shapes if shape not in same]]
    found = [pairs.of(pair.sensor.column, law) for pair in begun[:_N_CLIMBED] for law in laws if law]
    chosen = sorted((pair for pair in found if pair is not None), key=lambda pair: -pair.log_evidence)
    climbed_pairs = on_two_cores(pairs.climbed, chosen[:_N_CLIMBED], known=(other.effect, as_they_are.effect))
    best = max(climbed_pairs, key=lambda pair: pair.log_evidence, default=None)
    least = beside_other.log_evidence + as_they_are.log_evidence + problem.settings.forms.worth_forming
    return best if best is not None and best.log_evidence > least else None


class _Pairs:
    """Pairs of one effect of a sensor and one other effect."""

    def __init__(self, problem: LinearProblem, alone: Marginal, other: Column, beside_other: Marginal) -> None:
        self._problem, self._alone, self._beside_other = problem, alone, beside_other
        self._forms = KeptForms(problem, other.effect)

    def of(self, form: Column, shapes: Sequence[dict[str, float]]) -> ShownPair | None:
        """Take one form of the sensor's effect and the best one, of some, of the other effect as that shows it."""
        sensor = explain(self._beside_other, [form])
        if sensor is None:
            return None
        forms = self._forms.columns_in(shapes, distortion_of(sensor))
        beside = self._alone.beside(form.of_any_size)
        shown = explain(beside, forms) if forms else None
        if shown is None:
            return None
        sensor = explain(self._alone.beside(shown.column.of_any_size), [form]) or sensor
        return ShownPair(sensor=sensor, shown=shown, log_evidence=beside.log_evidence + shown.log_evidence)

    def best_of_each_choice(self, forms: Sequence[Column], shape: dict[str, float]) -> list[ShownPair]:
        """Pairs of some forms of the sensor's effect with one of the other effect, most evidence first."""
        best: dict[object, ShownPair] = {}
        for form in forms:
            choice = choices(form), kind(form)
            pair, known = self.of(form, [shape]), best.get(choice)
            if pair is not None and (known is None or pair.log_evidence > known.log_evidence):
                best[choice] = pair
        return sorted(best.values(), key=lambda pair: -pair.log_evidence)

    def climbed(self, begun: ShownPair) -> ShownPair:
        """Go by Gauss-Newton steps to the best pair within the ranges of the catalogue."""
        parts = (begun.sensor.column, begun.shown.column)
        bounds = {(k, name): of for k, part in enumerate(parts) for name, of in ranges(part).items()}

        def at(place: Floats) -> ShownPair | None:
            shapes = [dict(part.shape) for part in parts]
            for (k, name), value in zip(bounds, np.exp(place).tolist(), strict=True):
                shapes[k][name] = value
            forms = columns_in(self._problem, parts[0].effect, [shapes[0]])
            return self.of(forms[0], [shapes[1]]) if forms else None

        return gauss_newton(
            self._alone, begun, at, _signatures,
            here=np.log([parts[k].shape[name] for k, name in bounds]),
            bounds=np.log(np.reshape(list(bounds.values()), (-1, 2))),
        )  # fmt: skip


def _signatures(fitted: ShownPair) -> Callable[[ShownPair], Floats]:
    """Signatures of both effects in any of their forms, shape (n, 2), with the coefficients that were fitted to one."""
    of_sensor, of_shown = coefficients(fitted.sensor), coefficients(fitted.shown)
    return lambda found: np.column_stack(
        [found.sensor.column.columns @ of_sensor, found.shown.column.columns @ of_shown]
    )


def distortion_of(sensor: Explanation) -> Distortion:
    """How a sensor distorts by the size that its effect was found with."""
    found: Floats = coefficients(sensor) * sensor.effect.strength.typical
    return Distortion(effect=sensor.effect, shape=sensor.column.shape, coefficients=tuple(found.tolist()))
