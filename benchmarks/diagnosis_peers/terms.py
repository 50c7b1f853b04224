"""The dictionary of terms of one campaign: parameters, the best form of every effect, and terms of no name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.columns import catalogue_columns
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Part
from sawbench.modeling.residuals import Equation

from benchmarks.diagnosis_peers.reduction import Reduced, naive_std, physical, retuned

_N_HARMONICS = 2
SPREAD = "k_fc spread of "
STOCK = "k_fc of "
NAMELESS = "nameless "
# A column of which parameters leave less than this share of the energy is one of them, to rounding.
ABSORBED = 1e-6


@dataclass(frozen=True, kw_only=True, slots=True)
class Terms:
    """Columns that may explain the residuals of a campaign.

    Attributes
    ----------
    names : tuple of str
        Of the columns after the first, which is the residual: nuisances, effects ("effect/0", "effect/1" where a
        phase is free), "nameless ..." terms.
    gram : ndarray, shape (1 + m, 1 + m)
        Inner products of residual and columns under sensor noise and raw sample counts.
    rows : ndarray, shape (n, 1 + m)
        The same columns as rows for a regression, each equation divided by the scatter of its re-tuned residual.
    n_samples : int
        Raw samples of all channels.
    """

    names: tuple[str, ...]
    gram: Floats
    rows: Floats
    n_samples: int


def terms_of(reduced: Reduced) -> Terms:
    """Build the dictionary; the form of each effect is the one that fits best under sensor noise.

    Parameters
    ----------
    reduced : Reduced

    Returns
    -------
    Terms
    """
    problem = reduced.problem
    stds = [naive_std(reduced, part) for part in problem.parts]
    effects = catalogue_columns(problem, problem.campaign.plant.effects)
    nuisance = _naive(problem, stds, problem.nuisance)
    data = _naive(problem, stds, problem.data[:, None])
    basis, _ = np.linalg.qr(nuisance)
    data_rest = data[:, 0] - basis @ (basis.T @ data[:, 0])
    forms = [shape.columns for shapes in effects.values() for shape in shapes]
    all_forms = _naive(problem, stds, np.hstack(forms))
    whole_size = np.sum(all_forms**2, axis=0)
    all_forms -= basis @ (basis.T @ all_forms)
    all_forms[:, np.sum(all_forms**2, axis=0) < ABSORBED * whole_size] = 0.0
    names, chosen, start = [], [], 0
    for name, shapes in effects.items():
        gains = []
        for shape in shapes:
            width = shape.columns.shape[1]
            gains.append(_gain(all_forms[:, start : start + width], data_rest))
            start += width
        if shapes:
            best = shapes[int(np.argmax(gains))].columns
            chosen.append(best)
            names += [f"{name}/{k}" for k in range(best.shape[1])]
    nameless_names, nameless = _nameless(problem)
    whole = np.hstack([problem.data[:, None], problem.nuisance, *chosen, nameless])
    naive = _naive(problem, stds, whole)
    return Terms(
        names=(*problem.names, *names, *nameless_names),
        gram=naive.T @ naive,
        rows=_rows(problem, whole),
        n_samples=_n_samples(reduced),
    )


def _naive(problem: LinearProblem, stds: list[Floats], columns: Floats) -> Floats:
    """Columns in units of the sensor noise, shape (n, q)."""
    out = np.empty(columns.shape)
    for part, std in zip(problem.parts, stds, strict=True):
        out[part.place] = (physical(part, columns) / std[:, :, None]).reshape(-1, columns.shape[1])
    return out


def _gain(columns: Floats, data: Floats) -> float:
    """Fall of the squared misfit by one effect; a single column may only be added, not subtracted."""
    moment = columns.T @ data
    gram = columns.T @ columns
    if len(moment) == 1:
        return float(max(moment[0], 0.0) ** 2 / max(gram[0, 0], 1e-30))
    return float(moment @ np.linalg.lstsq(gram, moment, rcond=1e-10)[0])


def _nameless(problem: LinearProblem) -> tuple[list[str], Floats]:
    """Low harmonics of every equation times {1, duty, load, time, feed}, in units of the re-tuned residual's size."""
    settings = [part.setting for part in problem.parts]
    ones = np.ones(len(settings))
    is_cutting = np.array([0.0 if s.is_idle else 1.0 for s in settings])
    feed = np.nan_to_num(np.array([s.feed_m_s for s in settings]))
    covariates = {
        "1": ones, "duty": _centred(np.array([s.duty for s in settings])), "load": is_cutting - is_cutting.mean(),
        "time": _centred(np.array([s.session_s for s in settings])), "feed": is_cutting * _centred(feed),
    }  # fmt: skip
    rest = retuned(problem)[1]
    names, columns = [], []
    for equation, form in problem.campaign.plant.equations.items():
        n, size = form.n_harmonics, _size(problem, rest, equation)
        for order in range(_N_HARMONICS + 1):
            for index in (order, n + order) if order else (0,):
                for name, weights in covariates.items():
                    column = np.zeros(len(problem.data))
                    for part, weight in zip(problem.parts, weights, strict=True):
                        _put(column, part, equation, index, weight)
                    if column.any():
                        names.append(f"{NAMELESS}{equation}/{index}/{name}")
                        columns.append(column * size)
    return names, np.array(columns).T


def _put(column: Floats, part: Part, equation: Equation, index: int, weight: float) -> None:
    place = part.layout.slices.get(equation) if part.state.kind == "running" else None
    if place is None or not weight:
        return
    feature = np.zeros((part.blocks.shape[0], part.layout.size))
    feature[:, place.start + index] = weight
    column[part.place] = (feature @ part.whitener.T).ravel()


def _size(problem: LinearProblem, rest: Floats, equation: Equation) -> float:
    """Root mean square of an equation's re-tuned residual features while running."""
    squares = [
        np.mean(physical(part, rest[:, None])[:, part.layout.slices[equation], 0] ** 2)
        for part in problem.parts
        if part.state.kind == "running" and equation in part.layout.slices
    ]
    return float(np.sqrt(np.mean(squares)))


def _rows(problem: LinearProblem, whole: Floats) -> Floats:
    """Mean features of every trial, equations side by side on one scale."""
    rest = retuned(problem)[1]
    out = []
    for kind in ("running", "start_up"):
        parts = [part for part in problem.parts if part.state.kind == kind]
        scale: dict[str, list[float]] = {}
        for part in parts:
            left = physical(part, rest[:, None])[:, :, 0]
            for equation, place in part.layout.slices.items():
                scale.setdefault(equation, []).append(float(np.mean(left[:, place] ** 2)))
        for part in parts:
            features = physical(part, whole)
            for equation, place in part.layout.slices.items():
                features[:, place] /= np.sqrt(np.mean(scale[equation])) + 1e-12
            out.append(features.mean(axis=0))
    return np.concatenate(out)


def _n_samples(reduced: Reduced) -> int:
    total = 0.0
    for part in reduced.problem.parts:
        if part.state.kind == "running":
            seconds = float(part.state.n_strokes.sum()) * 2.0 * np.pi / float(np.mean(part.state.speed_rad_s))
            total += seconds * reduced.rate_hz * len(part.layout.equations)
    return round(total)


def _centred(values: Floats) -> Floats:
    spread = float(values.std())
    return (values - values.mean()) / spread if spread > 0 else np.zeros_like(values)
