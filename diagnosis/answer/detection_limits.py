"""How much of each effect a campaign would show: said before an effect that is not named is taken for absent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.columns import Column, forms_beside
from sawbench.diagnosis.inference.dispersion import (
    background_with_noise,
    columns_with_noise,
    stacked_with_noise,
    with_noise,
)
from sawbench.diagnosis.inference.form_error import form_modes
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import Posterior
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.strokes import StrokeWave

# Forms of an effect that are asked, at most.
_N_FORMS = 9
# Relative difference of equal numbers.
_SAME = 1e-6


@dataclass(frozen=True, kw_only=True, slots=True)
class DetectionLimit:
    """How much of an effect a campaign would show.

    Attributes
    ----------
    log_odds : float
        Expected against no gap, of the effect at its typical size; 0 where no channel shows it.
    name, unit : str
        Of the effect's magnitude; empty where its size has none (a frequency belongs to the form), and where none that
        occurs would show.
    change : float
        The effect shows where its magnitude differs by this much from that without effect.
    without : float or None
        Magnitude without effect. None of one that falls from infinity as the effect grows (a stiffness): the effect
        shows where it is below `change`.
    """

    log_odds: float
    name: str = ""
    unit: str = ""
    change: float = 0.0
    without: float | None = 0.0


def detection_limits(
    problem: LinearProblem, columns: Mapping[str, Sequence[Column]], posterior: Posterior, least: float
) -> dict[str, DetectionLimit]:
    """Return the limit of every effect beside the likeliest answer; what shows least at its typical size comes first.

    Beside the nuisances, the background effects, the other effects of that answer and what their forms may miss, by
    the noise that the evidence counts with.

    Parameters
    ----------
    problem : LinearProblem
    columns : mapping of str to sequence of Column
        Of `effect_columns`.
    posterior : Posterior
    least : float
        Log odds from which an effect shows; they grow with the square of its amplitude. One of background size is
        named only where the mean stroke differs by more than that of an intact machine does, and what every machine
        has as much of is not named.

    Returns
    -------
    dict of str to DetectionLimit
        Without waves of the wood: they are looked for from stroke to stroke.
    """
    noise = posterior.dispersion
    noisy = with_noise(problem, noise)
    nominal = Marginal(noisy, extra=background_with_noise(posterior.little, noise))

    @lru_cache
    def beside(others: tuple[str, ...]) -> Marginal:
        members = [m for m in posterior.best.members if m.effect.name in others]
        sizes = stacked_with_noise(problem, [m.column.of_any_size for m in members], noise)
        shown = stacked_with_noise(problem, [m.contribution[:, None] for m in members], noise).T
        missed = [problem.settings.forms.screen_share * form_modes(noisy, wave) for wave in shown]
        return nominal.beside(np.hstack([sizes, *missed])) if members else nominal

    found: dict[str, DetectionLimit] = {}
    for name, every in columns.items():
        others = posterior.best.without(name)
        forms = forms_beside(every, others)
        if not (forms and isinstance(forms[0].effect.strokes, StrokeWave)):
            asked = forms[:: 1 + len(forms) // _N_FORMS]
            shown = columns_with_noise(problem, {name: asked}, noise)[name]
            found[name] = _of_forms(beside(others), shown, least, gap=0.5 * problem.quiet * len(problem.data))
    return dict(sorted(found.items(), key=lambda item: item[1].log_odds))


def _of_forms(marginal: Marginal, forms: Sequence[Column], least: float, *, gap: float) -> DetectionLimit:
    # All columns of a form share its size: the mean over phases of what one unit explains.
    grams = marginal.grams([column.columns for column in forms]) if forms else []
    odds = np.array([0.5 * float(np.trace(gram)) / len(gram) for gram, _ in grams])
    middle = float(np.median(odds)) if forms else 0.0
    if middle <= 0.0:
        return DetectionLimit(log_odds=0.0)
    strength, without = forms[0].effect.strength, forms[0].effect.strength_without(forms[0].shape)
    of_typical = _magnitudes(forms, np.ones(len(forms)))
    # What is of background size is named only where it leaves a gap, and not below what every machine has.
    of_usual = 1.0 if strength.usual is None else strength.over_usual(np.abs(of_typical))
    sizes, numbers = 1.0 / np.maximum(of_usual, _SAME), SETTINGS.forms
    odds = np.maximum(odds, np.finfo(float).tiny)
    named = np.maximum(np.sqrt(least / odds), np.minimum(np.sqrt(gap / odds), numbers.background_amplitude * sizes))
    named = np.maximum(named, np.maximum(numbers.least_amplitude * sizes, strength.low))
    smallest = _magnitudes(forms, named)
    if np.array_equal(of_typical, smallest) or named.min() > strength.high:
        return DetectionLimit(log_odds=middle)
    changes = np.abs(smallest - (without or 0.0))
    if np.ptp(np.abs(of_typical)) <= _SAME * np.abs(of_typical).max():
        change = np.median(changes)  # any form may have any magnitude: half of them show more
    else:
        change = changes.max() if without is None else changes.min()  # each form has its own
    return DetectionLimit(
        log_odds=middle, name=strength.name, unit=strength.unit, change=float(change), without=without
    )


def _magnitudes(forms: Sequence[Column], amplitudes: Floats) -> Floats:
    return np.array([
        c.effect.reported_strength(amplitude * c.effect.strength.typical, c.shape)
        for c, amplitude in zip(forms, amplitudes, strict=True)
    ])  # fmt: skip
