"""A little of an effect that is at one place of a wide range is a little of one form: of the one that shows.

A carriage has one light mode at an unknown frequency, not one at each. The mean covariance of a little of any form
(`columns.little_of_each`) spreads it over as many axes as the forms have, and a single form of ordinary size is then as
unlikely as an amount far beyond it. Of the form that shows, unless it is as large as a cause, what that covariance
lacks is added, so that one standard deviation of it costs no more than half a nat. The form is chosen from the data; as
it is a nuisance of every hypothesis alike, the choice favours none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.columns import Column, forms_beside
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.effect import BACKGROUND_SHARE

# Standard deviations from which an amplitude is that of a cause.
_MOST = SETTINGS.forms.least_amplitude / BACKGROUND_SHARE


def with_the_form_that_shows(
    little: Mapping[str, Floats],
    columns: Mapping[str, Sequence[Column]],
    variance: Floats,
    beside: Sequence[Marginal],
) -> dict[str, Floats]:
    """Add to the background of every effect at one place what that lacks of the forms that the data show.

    Parameters
    ----------
    little : mapping of str to ndarray, shape (n, q)
        Of `little_of_each`.
    columns : mapping of str to sequence of Column
        By effect, whitened as `little`.
    variance : ndarray, shape (n,)
        Factor on the noise's variance that the data are whitened with; see `dispersion.background_with_noise`.
    beside : sequence of Marginal
        Beside what a form may show: each with `little`.

    Returns
    -------
    dict of str to ndarray, shape (n, q + r)
    """
    found = dict(little)
    for name, entries in columns.items():
        if not entries or not entries[0].effect.is_at_one_place:
            continue
        forms = [column.effect.background_share * column.columns for column in forms_beside(entries)]
        scaled = [form / variance[:, None] for form in forms]
        chosen = {at for at in (_that_shows(marginal, scaled) for marginal in beside) if at is not None}
        found[name] = np.hstack([little[name], *(_lacking(forms[at], little[name]) for at in sorted(chosen))])
    return found


def _that_shows(marginal: Marginal, forms: Sequence[Floats]) -> int | None:
    """Which form has the most evidence, of amplitudes of unit standard deviation; None where it is no little."""
    gains, amplitudes = [], []
    for gram, moment in marginal.grams(forms):
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
