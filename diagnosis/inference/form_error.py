"""What an effect's signature may miss because nature's form is not the catalogue's.

Friction has another Stribeck dip, wear is not linear, a diode's voltage bends: near its signature s an effect may
leave s times a smooth factor, over the crank angle and over the trials. Each such factor is a column with a prior
in proportion to the effect's own size, so that a strong effect may leave much and a weak one nothing. Without it
a second effect, or "unknown", would always be there to mop up what the first one's form leaves.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.features import START_UP_EDGES_S, harmonics
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.modeling.residuals import Equation
from sawbench.modeling.state import TWO_PI

_N_ANGLE = 4
_N_POINTS = 128
_N_TILTED = 3


def form_modes(problem: LinearProblem, contribution: Floats) -> Floats:
    """Columns for what the form of an effect may leave.

    Parameters
    ----------
    problem : LinearProblem
    contribution : ndarray, shape (n,)
        The effect's whitened signature at its fitted size.

    Returns
    -------
    ndarray, shape (n, q)
        For a factor of standard deviation 1; columns without any weight are left out.
    """
    factors = _factors(problem)
    operators = {
        equation: _operators(form.n_harmonics, problem.settings.forms.harmonic_factor)
        for equation, form in problem.campaign.plant.equations.items()
    }
    tables: dict[tuple[Equation, str], Floats] = {}
    for part, weights in zip(problem.parts, factors, strict=True):
        features = part.unwhiten(contribution)
        for equation, place in part.layout.slices.items():
            if not features[:, place].any():
                continue
            known = operators[equation] if part.layout.kind == "running" else _START_UP
            # (operators, blocks, whitened features of a block)
            moved = features[:, place] @ known @ part.whitener[:, place].T
            tilted = moved[:_N_TILTED, None] * weights
            columns = np.concatenate([tilted.reshape(-1, *moved.shape[1:]), weights[0] * moved[_N_TILTED:]])
            key = (equation, part.layout.kind)
            table = tables.setdefault(key, np.zeros((len(contribution), len(columns))))
            table[part.place] = columns.reshape(len(columns), -1).T
    found = np.hstack([np.zeros((len(contribution), 0)), *tables.values()])
    return found[:, found.any(axis=0)]


def block_weights(problem: LinearProblem) -> dict[str, list[Floats]]:
    """What varies between blocks, one array of shape (n_blocks,) a part.

    Parameters
    ----------
    problem : LinearProblem

    Returns
    -------
    dict of str to list of ndarray
        "one"; "speed", "load", "session" and "feed" of the trial, centred and scaled; "idle", 0 or 1; "within", the
        time in the trial from -1 to 1.
    """
    settings = [part.setting for part in problem.parts]
    load = [part.state.k_guess_n_s_per_m for part in problem.parts]
    counts = [part.blocks.shape[0] for part in problem.parts]
    trials = {
        "one": np.ones(len(settings)),
        "speed": _centred(np.array([s.duty for s in settings])),
        "load": _centred(np.array(load, dtype=np.float64)),
        "session": _centred(np.array([s.session_s for s in settings])),
        "feed": _centred(np.nan_to_num(np.array([s.feed_m_s for s in settings]))),
        "idle": np.array([float(s.is_idle) for s in settings]),
    }
    found = {name: [np.full(n, v) for n, v in zip(counts, values, strict=True)] for name, values in trials.items()}
    return found | {"within": [np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1) for n in counts]}


def _factors(problem: LinearProblem) -> list[Floats]:
    """Factors of each part, shape (factors, n_blocks, 1), in the order of `block_weights`."""
    return [np.array(of_part)[..., None] for of_part in zip(*block_weights(problem).values(), strict=True)]


def _centred(values: Floats) -> Floats:
    """Values less their mean over their standard deviation, zeros where they do not vary."""
    spread = float(values.std())
    return (values - values.mean()) / spread if spread > 0 else np.zeros_like(values)


@lru_cache(maxsize=16)
def _operators(n: int, harmonic_factor: float) -> Floats:
    """Matrices on feature rows: times 1, cos, sin, cos 2, ... of the angle; then each harmonic, as it is and turned."""
    angle = (np.arange(_N_POINTS) + 0.5) * TWO_PI / _N_POINTS
    order = np.arange(1, n + 1)
    # `harmonics` has its angle zero at the first point: stay with that for both ways.
    shifted = angle - angle[0]
    synthesis = np.vstack([np.ones(_N_POINTS), np.cos(np.outer(order, shifted)), np.sin(np.outer(order, shifted))])
    factors = [np.ones(_N_POINTS)]
    for k in range(1, _N_ANGLE + 1):
        factors += [np.cos(k * angle) / np.sqrt(k), np.sin(k * angle) / np.sqrt(k)]
    operators = [harmonics(synthesis * factor, n) for factor in factors]
    for k in range(1, n + 1):
        same, turned = np.zeros((2 * n + 1, 2 * n + 1)), np.zeros((2 * n + 1, 2 * n + 1))
        same[k, k] = same[n + k, n + k] = harmonic_factor
        turned[k, n + k], turned[n + k, k] = -harmonic_factor, harmonic_factor
        operators += [same, turned]
    return np.array(operators)


def _start_up_operators() -> list[Floats]:
    middle = np.log(0.5 * (np.array(START_UP_EDGES_S[1:]) + np.array(START_UP_EDGES_S[:-1])))
    place = 2.0 * (middle - middle[0]) / (middle[-1] - middle[0]) - 1.0
    return [np.diag(np.cos(k * np.arccos(np.clip(place, -1.0, 1.0)))) for k in range(5)]


_START_UP = np.array(_start_up_operators())
