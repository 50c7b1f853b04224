"""Modes that every bench has somewhere, beyond the catalogue: nuisances of every hypothesis.

A saw in its clamp, with what holds the displacement sensor, rings at one frequency, which is not known beforehand. Of
an effect of the catalogue a little is background (`columns.little_of_each`); of a mode its ordinary size is. The form
that shows is looked for beside all background effects, between the frequencies of its forms too: near a harmonic of the
stroke, what a lightly damped mode does changes within a per cent of its frequency.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.columns import Column, little_of_each
from sawbench.diagnosis.inference.dispersion import background_with_noise
from sawbench.diagnosis.inference.evidence import explain
from sawbench.diagnosis.inference.one_form import lacking_of_forms_that_show
from sawbench.diagnosis.inference.refining import WeighedAlone, climbed


def ordinary_modes(
    weighed: WeighedAlone, beyond: Mapping[str, Sequence[Column]], little: Mapping[str, Floats]
) -> dict[str, Floats]:  # fmt: skip
    """Nuisance columns for the modes among the causes beyond the catalogue, times their prior standard deviation.

    Parameters
    ----------
    weighed : WeighedAlone
        Effects of the catalogue.
    beyond : mapping of str to sequence of Column
        Of `catalogue_columns`, of causes beyond the catalogue.
    little : mapping of str to ndarray, shape (n, q)
        Of `little_of_each`.

    Returns
    -------
    dict of str to ndarray, shape (n, r)
        By the cause's name.
    """
    problem = weighed.problem
    forms = {name: list(columns) for name, columns in beyond.items() if columns and columns[0].effect.is_at_one_place}
    if not forms:
        return {}
    as_measured = np.ones(len(problem.data))
    beside = weighed.marginal.beside(background_with_noise(little, as_measured))
    for columns in forms.values():
        best = explain(beside, columns)
        assert best is not None
        columns.append(climbed(problem, beside, best).column)
    found = little_of_each(problem, forms)
    beside = beside.beside(background_with_noise(found, as_measured))
    lacking = lacking_of_forms_that_show(found, forms, as_measured, [[beside]])
    return {name: np.hstack([of_any, lacking.get(name, of_any[:, :0])]) for name, of_any in found.items()}
