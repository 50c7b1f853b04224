"""A little of an effect that is at one place of a wide range is a little of one form: of the one that shows.

A carriage has one light mode at an unknown frequency, not one at each. The mean covariance of a little of any form
(`columns.little_of_each`) spreads it over as many axes as the forms have, and a single form of ordinary size is then as
unlikely as an amount far beyond it. Of the form that shows, unless it is as large as a cause, what that covariance
lacks is added, so that one standard deviation of it costs no more than half a nat. The form is chosen from the data; as
it is a nuisance of every hypothesis alike, the choice favours none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.columns import Column, forms_beside
from sawbench.diagnosis.inference.evidence import Catalogue
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.effect import BACKGROUND_SHARE

# Standard deviations from which an amplitude is that of a cause.
_MOST = SETTINGS.forms.least_amplitude / BACKGROUND_SHARE


def lacking_of_forms_that_show(
    little: Mapping[str, Floats],
    columns: Mapping[str, Sequence[Column]],
    variance: Floats,
    beside: Sequence[Sequence[Marginal]],
) -> dict[str, Floats]:
    """What the background of every effect at one place lacks of the forms that the data show.

    Parameters
    ----------
    little : mapping of str to ndarray, shape (n, q)
        Of `little_of_each`.
    columns : mapping of str to sequence of Column
        By effect, whitened as `little`.
    variance : ndarray, shape (n,)
        Factor on the noise's variance that the data are whitened with; see `dispersion.background_with_noise`.
    beside : sequence of sequence of Marginal
        Beside what a form may show: each with `little`. Of each sequence the others are the first `Marginal.beside`
        something more: what that takes up of the forms is worked out once.

    Returns
    -------
    dict of str to ndarray, shape (n, r)
        By effect; without those that lack nothing.
    """
    forms = {
        name: forms_beside(entries)
        for name, entries in columns.items()
        if entries and entries[0].effect.is_at_one_place
    }

    def that_show(asked: tuple[str, Sequence[Marginal]]) -> set[int]:
        name, marginals = asked
        scaled = [replace(c, columns=c.columns * (c.effect.background_share / variance)[:, None]) for c in forms[name]]
        return _that_show(marginals, scaled)

    asked = [(name, marginals) for name in forms for marginals in beside]
    found: dict[str, set[int]] = {}
    for (name, _), chosen in zip(asked, on_two_cores(that_show, asked), strict=True):
        found[name] = found.get(name, set()) | chosen
    shown = {name: [forms[name][at] for at in sorted(chosen)] for name, chosen in found.items() if chosen}
    return {
        name: np.hstack([_lacking(c.effect.background_share * c.columns, little[name]) for c in of_it])
        for name, of_it in shown.items()
    }


def _that_show(marginals: Sequence[Marginal], forms: list[Column]) -> set[int]:
    """Which forms have the most evidence beside the first marginal, and beside each of those that add to it."""
    catalogue = Catalogue({"": forms}, marginals[0].data)
    half = marginals[0].half(catalogue.stacked)
    halves = [half, *(marginal.half(catalogue.stacked, half) for marginal in marginals[1:])]
    found = (_that_shows(catalogue.grams(*each)) for each in zip(marginals, halves, strict=True))
    return {at for at in found if at is not None}


def _that_shows(grams: Sequence[tuple[Floats, Floats]]) -> int | None:
    """Which form has the most evidence, of amplitudes of unit standard deviation; None where it is no little."""
    gains, amplitudes = [], []
    for gram, moment in grams:
        covariance = np.linalg.inv(np.eye(len(gram)) + gram)
        gains.append(0.5 * float(moment @ covariance @ moment + np.linalg.slogdet(covariance)[1]))
        amplitudes.append(float(np.abs(covariance @ moment).max()))
    best = int(np.argmax(gains))
    return best if amplitudes[best] < _MOST else None


def _lacking(form: Floats, little: Floats) -> Floats:
    """What the background, shape (n, q), lacks of a form of one standard deviation, shape (n, r)."""
    taken = np.linalg.solve(np.eye(little.shape[1]) + little.T @ little, little.T @ form)
    cost = float(np.sum(form * (form - little @ taken))) / form.shape[1]
    return np.sqrt(max(1.0 - 1.0 / cost, 0.0)) * form
