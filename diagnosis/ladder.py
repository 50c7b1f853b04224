"""How far the gap shrinks on operating points that no fit has seen: nominal, re-tuned, with the effect, noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.recording import Floats
from diagnosis.equations import Equation
from diagnosis.linear_problem import LinearProblem
from diagnosis.posterior import wide_scale

_N_BOOTSTRAP = 500


@dataclass(frozen=True, kw_only=True, slots=True)
class Rungs:
    """One quantity on the four rungs of the ladder."""

    nominal: float
    retuned: float
    with_effect: float
    noise_floor: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Ladder:
    """Held-out gap.

    Attributes
    ----------
    whitened : Rungs
        Root mean square of the residual over its noise.
    by_channel : dict of str to (Rungs, unit)
    gap_closed : float
        Share of the mean square that re-tuning leaves above the noise and the effect takes away.
    gap_closed_ci95 : tuple of float
        Over bootstraps of operating points.
    n_held_out : int
        Operating points that were held out, each in turn.
    """

    whitened: Rungs
    by_channel: dict[str, tuple[Rungs, str]]
    gap_closed: float
    gap_closed_ci95: tuple[float, float]
    n_held_out: int


def climb(problem: LinearProblem, columns: Floats | None, *, seed: int = 0) -> Ladder:
    """Hold out each operating point in turn and predict it from the others.

    Parameters
    ----------
    problem : LinearProblem
    columns : ndarray, shape (n, q), or None
        Whitened signatures of the cause, times a generous amplitude; None where there is none.
    seed : int
        Of the bootstrap.

    Returns
    -------
    Ladder
    """
    scale = wide_scale(problem)
    base = problem.nuisance * scale
    is_wood = np.array([name.startswith("k_fc") for name in problem.names])
    full = base if columns is None else np.hstack([base, columns])
    groups = list(dict.fromkeys(part.setting.operating_point for part in problem.parts))
    models = {"nominal": None, "retuned": base, "with_effect": full}
    residuals = {name: np.zeros_like(problem.data) for name in (*models, "noise_floor")}
    for group in groups:
        held = problem.rows(lambda s, g=group: s.operating_point == g)
        wood = base[held][:, is_wood]
        for name, design in models.items():
            rest = problem.data[held]
            if design is not None:
                theta = _ridge(design[~held], problem.data[~held])
                rest = rest - design[held] @ theta
            # How hard this piece of wood is, no model predicts: it is fitted on the held-out trials, for all rungs.
            residuals[name][held] = rest - wood @ _ridge(wood, rest)
        inside = full[held]
        residuals["noise_floor"][held] = problem.data[held] - inside @ _ridge(inside, problem.data[held])
    energy = {
        name: np.array([np.sum(r[problem.rows(lambda s, g=g: s.operating_point == g)] ** 2) for g in groups])
        for name, r in residuals.items()
    }
    rng = np.random.default_rng(seed)
    draws = [_closed(energy, rng.integers(0, len(groups), len(groups))) for _ in range(_N_BOOTSTRAP)]
    n = len(problem.data)
    return Ladder(
        whitened=Rungs(**{name: float(np.sqrt(values.sum() / n)) for name, values in energy.items()}),
        by_channel=_by_channel(problem, residuals),
        gap_closed=_closed(energy, np.arange(len(groups))),
        gap_closed_ci95=(float(np.quantile(draws, 0.025)), float(np.quantile(draws, 0.975))),
        n_held_out=len(groups),
    )


def _ridge(design: Floats, data: Floats) -> Floats:
    """Posterior mean of coefficients with unit normal priors."""
    if design.shape[1] == 0:
        return np.zeros(0)
    normal = np.eye(design.shape[1]) + design.T @ design
    return np.asarray(np.linalg.solve(normal, design.T @ data), dtype=np.float64)


def _closed(energy: dict[str, Floats], chosen: np.ndarray) -> float:
    retuned, effect, floor = (float(energy[k][chosen].sum()) for k in ("retuned", "with_effect", "noise_floor"))
    room = retuned - floor
    return float(np.clip((retuned - effect) / room, -1.0, 1.0)) if room > 1e-9 else 0.0


def _by_channel(problem: LinearProblem, residuals: dict[str, Floats]) -> dict[str, tuple[Rungs, str]]:
    forms = problem.campaign.plant.equations
    squares: dict[Equation, dict[str, list[float]]] = {}
    for part in problem.parts:
        if part.state.kind != "running":
            continue
        for name, whole in residuals.items():
            features = part.unwhiten(whole)
            for equation, place in part.layout.slices.items():
                factor = forms[equation].to_channel
                if factor is None:
                    continue
                block = factor * features[:, place]
                # Mean square over the turn of a Fourier series: c0^2 + half the squares of the others.
                square = float(np.mean(block[:, 0] ** 2 + 0.5 * np.sum(block[:, 1:] ** 2, axis=1)))
                squares.setdefault(equation, {}).setdefault(name, []).append(square)
    return {
        forms[equation].channel: (
            Rungs(**{name: float(np.sqrt(np.mean(values))) for name, values in found.items()}),
            forms[equation].channel_unit,
        )
        for equation, found in squares.items()
    }
