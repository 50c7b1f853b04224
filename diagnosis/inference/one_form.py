"""A little of an effect that is at one place of a wide range is a little of one form: of the one that shows.

A carriage has one light mode at an unknown frequency, not one at each. The mean covariance of a little of any
form (`columns.little_of_each`) spreads it over as many axes as the forms have, and a single form of ordinary size is
then as unlikely as an amount far beyond it. Of the form that shows, what that covariance lacks is added, so that one
standard deviation of it costs no more than half a nat. The form is chosen from the data; as it is a nuisance of every
hypothesis alike, the choice favours none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.columns import Column, forms_beside
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.modeling.effects.effect import BACKGROUND_SHARE


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
        forms = [BACKGROUND_SHARE * column.columns for column in forms_beside(entries)]
        scaled = [form / variance[:, None] for form in forms]
        chosen = {int(np.argmax(_gains(marginal, scaled))) for marginal in beside}
        found[name] = np.hstack([little[name], *(_lacking(forms[at], little[name]) for at in sorted(chosen))])
    return found


def _gains(marginal: Marginal, forms: Sequence[Floats]) -> list[float]:
    """Log evidence that each form adds, its amplitudes of unit standard deviation."""
    found = []
    for gram, moment in marginal.grams(forms):
        root = np.linalg.cholesky(np.eye(len(gram)) + gram)
        half = np.linalg.solve(root, moment)
        found.append(0.5 * float(half @ half) - float(np.log(np.diag(root)).sum()))
    return found


def _lacking(form: Floats, little: Floats) -> Floats:
    """What the background, shape (n, q), lacks of a form of one standard deviation, shape (n, r)."""
    taken = np.linalg.solve(np.eye(little.shape[1]) + little.T @ little, little.T @ form)
    cost = float(np.sum(form * (form - little @ taken))) / form.shape[1]
    return np.sqrt(max(1.0 - 1.0 / cost, 0.0)) * form
