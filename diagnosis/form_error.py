"""What an effect's signature may miss because nature's form is not the catalogue's.

Friction has another Stribeck dip, wear is not linear, a diode's voltage bends: near its signature s an effect may
leave s times a smooth factor, over the crank angle and over the trials. Each such factor is a column with a prior
in proportion to the effect's own size, so that a strong effect may leave much and a weak one nothing. Without it
a second effect, or "unknown", would always be there to mop up what the first one's form leaves.
"""

from __future__ import annotations

import numpy as np

from bench.recording import Floats
from diagnosis.equations import Equation
from diagnosis.features import START_UP_EDGES_S, harmonics
from diagnosis.linear_problem import LinearProblem, Part
from diagnosis.state import TWO_PI

# Standard deviation of each part of the smooth factor, as a share of the effect: all are tried.
FORM_SHARES = (0.0, 0.03, 0.1, 0.25)
_N_ANGLE = 4
_N_POINTS = 128
_N_TILTED = 3
# Of an effect that does not depend on time, the part that does.
_STEADY_SHARE = 0.1
# Each harmonic may also be larger and turned on its own, as another filter or a sharper corner would have it.
_HARMONIC_FACTOR = 1.5


def form_modes(problem: LinearProblem, contribution: Floats, *, in_time: bool = True) -> Floats:
    """Columns for what the form of an effect may leave.

    Parameters
    ----------
    problem : LinearProblem
    contribution : ndarray, shape (n,)
        The effect's whitened signature at its fitted size.
    in_time : bool
        Whether the effect grows or fades with time: what does not may differ with angle, speed and load, but hardly
        from one minute to the next.

    Returns
    -------
    ndarray, shape (n, q)
        For a factor of standard deviation 1; columns without any weight are left out.
    """
    factors = _factors(problem, in_time=in_time)
    operators = {equation: _operators(form.n_harmonics) for equation, form in problem.campaign.plant.equations.items()}
    rows: dict[tuple[Equation, str, int, int], list[tuple[Part, Floats]]] = {}
    for number, part in enumerate(problem.parts):
        if not contribution[part.place].any():
            continue
        features = part.unwhiten(contribution)
        for equation, place in part.layout.slices.items():
            block = features[:, place]
            if not block.any():
                continue
            known = operators[equation] if part.layout.kind == "running" else _START_UP
            for k, operator in enumerate(known):
                moved = block @ operator
                for j, weight in enumerate(factors[number] if k < _N_TILTED else factors[number][:1]):
                    wide = np.zeros_like(features)
                    wide[:, place] = weight * moved
                    rows.setdefault((equation, part.layout.kind, k, j), []).append((part, wide))
    columns = []
    for entries in rows.values():
        column = np.zeros(len(contribution))
        for part, wide in entries:
            column[part.place] += (wide @ part.whitener.T).ravel()
        if column.any():
            columns.append(column)
    return np.array(columns).T if columns else np.zeros((len(contribution), 0))


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
    load = [np.mean(part.state.slow.get("k_guess_n_s_per_m", 0.0)) for part in problem.parts]
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


def _factors(problem: LinearProblem, *, in_time: bool) -> list[list[Floats]]:
    """Factors of each part, (n_blocks, 1) each, in the order of `block_weights`."""
    steady = 1.0 if in_time else _STEADY_SHARE
    share = {"session": steady, "within": steady}
    scaled = [[share.get(name, 1.0) * w[:, None] for w in rows] for name, rows in block_weights(problem).items()]
    return [list(of_part) for of_part in zip(*scaled, strict=True)]


def _centred(values: Floats) -> Floats:
    """Values less their mean over their standard deviation, zeros where they do not vary."""
    spread = float(values.std())
    return (values - values.mean()) / spread if spread > 0 else np.zeros_like(values)


def _operators(n: int) -> list[Floats]:
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
        same[k, k] = same[n + k, n + k] = _HARMONIC_FACTOR
        turned[k, n + k], turned[n + k, k] = -_HARMONIC_FACTOR, _HARMONIC_FACTOR
        operators += [same, turned]
    return operators


def _start_up_operators() -> list[Floats]:
    middle = np.log(0.5 * (np.array(START_UP_EDGES_S[1:]) + np.array(START_UP_EDGES_S[:-1])))
    place = 2.0 * (middle - middle[0]) / (middle[-1] - middle[0]) - 1.0
    return [np.diag(np.cos(k * np.arccos(np.clip(place, -1.0, 1.0)))) for k in range(5)]


_START_UP = _start_up_operators()
