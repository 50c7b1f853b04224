"""Residual features of one length for every campaign: what forest and network learn from."""

from __future__ import annotations

from collections import Counter

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.features import times_over_angles
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Part
from sawbench.modeling.state import TrialSetting

from benchmarks.diagnosis_peers.reduction import Reduced, physical, retuned

POINTS = ("idle low", "idle middle", "idle high", "cut low", "cut middle", "cut high", "other feed", "other stock")
_TINY = 1e-12


def feature_vector(reduced: Reduced) -> Floats:
    """Lay the re-tuned residuals of a campaign out in a fixed order.

    Parameters
    ----------
    reduced : Reduced
        Of a campaign where all five equations can be evaluated.

    Returns
    -------
    ndarray, shape (n,)
        Harmonics of every equation by class of operating point; mean start-ups; change within a trial and over the
        session; scatter between strokes; re-tuned parameters; hardness by class; misfit by equation. Zero where the
        campaign has no such trial. The cutting equation is relative to the force of the campaign.
    """
    problem = reduced.problem
    x, rest = retuned(problem)
    running = [part for part in problem.parts if part.state.kind == "running"]
    place_of = operating_classes([part.setting for part in running])
    blocks = {part.setting.label: _scaled(part, physical(part, rest[:, None])[:, :, 0]) for part in running}
    size = max(part.layout.size for part in running)
    pieces = [_mean([blocks[p.setting.label].mean(axis=0) for p in running if place_of[p.setting.label] == name], size)
              for name in POINTS]  # fmt: skip
    for is_idle in (True, False):
        chosen = [p for p in running if p.setting.is_idle == is_idle]
        pieces.append(_mean([blocks[p.setting.label][-1] - blocks[p.setting.label][0] for p in chosen], size))
        pieces.append(_mean([_scatter(problem, p) for p in chosen], size))
        starts = [p for p in problem.parts if p.state.kind == "start_up" and p.setting.is_idle == is_idle]
        length = 3 * 14
        pieces.append(_mean([physical(p, rest[:, None])[0, :, 0] for p in starts], length))
    pieces.append(_session_trend(running, blocks, place_of, size))
    pieces.append(_shared_nuisances(problem, x))
    pieces.append(_hardness(problem, running, place_of))
    pieces.append(_misfits(problem, rest))
    return np.concatenate(pieces)


def operating_classes(settings: list[TrialSetting]) -> dict[str, str]:
    """Class of operating point of every trial, by label; duties are ranked within the campaign."""
    cutting = [s for s in settings if not s.is_idle]
    stock = Counter(s.stock for s in cutting).most_common(1)[0][0] if cutting else ""
    feed = Counter(s.feed_m_s for s in cutting if s.stock == stock).most_common(1)[0][0] if cutting else 0.0
    found = {}
    for setting in settings:
        if not setting.is_idle and setting.stock != stock:
            found[setting.label] = "other stock"
        elif not setting.is_idle and setting.feed_m_s != feed:
            found[setting.label] = "other feed"
        else:
            duties = sorted({s.duty for s in settings if s.is_idle == setting.is_idle})
            rank = "middle"
            if len(duties) > 1 and setting.duty in (duties[0], duties[-1]):
                rank = "low" if setting.duty == duties[0] else "high"
            found[setting.label] = f"{'idle' if setting.is_idle else 'cut'} {rank}"
    return found


def _scaled(part: Part, features: Floats) -> Floats:
    """Cutting features in shares of the campaign's peak force; it is what all of them grow with."""
    out = features.copy()
    place = part.layout.slices.get("cutting")
    if place is not None:
        out[:, place] *= 100.0 / max(part.state.peak_force_n, _TINY)
    return out


def _mean(rows: list[Floats], size: int) -> Floats:
    rows = [row for row in rows if len(row) == size]
    return np.mean(rows, axis=0) if rows else np.zeros(size)


def _scatter(problem: LinearProblem, part: Part) -> Floats:
    """Logarithm of the standard deviation of each feature between units of a few strokes."""
    features = part.layout.place(problem.campaign.plant.residuals(part.state), times_over_angles(part.state))
    return np.log10(np.std(np.diff(features, axis=0), axis=0) + 1e-9) if len(features) > 1 else np.zeros(0)


def _session_trend(running: list[Part], blocks: dict[str, Floats], place_of: dict[str, str], size: int) -> Floats:
    """Slope of the features over the session, per 1000 s, within the classes of operating points."""
    times, rows = [], []
    for name in POINTS:
        group = [p for p in running if place_of[p.setting.label] == name]
        if len(group) < 2:
            continue
        t = np.array([p.setting.session_s for p in group]) / 1000.0
        y = np.array([blocks[p.setting.label].mean(axis=0) for p in group])
        times.append(t - t.mean())
        rows.append(y - y.mean(axis=0))
    if not rows:
        return np.zeros(size)
    t = np.concatenate(times)
    return t @ np.concatenate(rows) / max(float(t @ t), _TINY)


def _shared_nuisances(problem: LinearProblem, x: Floats) -> Floats:
    wanted = [n.name for n in problem.campaign.plant.nuisances()]
    found = dict(zip(problem.names, x, strict=True))
    return np.array([found.get(name, 0.0) for name in wanted])


def _hardness(problem: LinearProblem, running: list[Part], place_of: dict[str, str]) -> Floats:
    """Logarithm of k_Fc of each cutting class against that at the middle duty."""
    baseline = problem.campaign.baseline
    logs: dict[str, list[float]] = {}
    for part in running:
        if part.setting.is_idle or part.state.force_n is None:
            continue
        speed = baseline.cutting_speed(part.smooth)
        k = float(np.sum(part.smooth.force_n * speed) / np.sum(speed * speed))
        logs.setdefault(place_of[part.setting.label], []).append(np.log(max(k, 1.0)))
    middle = float(np.mean(logs["cut middle"])) if "cut middle" in logs else 0.0
    return np.array([np.mean(logs[name]) - middle if name in logs else 0.0 for name in POINTS[3:]])


def _misfits(problem: LinearProblem, rest: Floats) -> Floats:
    """Logarithm of the mean square of the whitened residual, in air, in wood and at the start."""
    squares: dict[str, list[float]] = {"idle": [], "cut": [], "start": []}
    for part in problem.parts:
        kind = "start" if part.state.kind == "start_up" else "idle" if part.setting.is_idle else "cut"
        squares[kind].append(float(np.mean(rest[part.place] ** 2)))
    return np.array([np.log10(np.mean(values)) if values else 0.0 for values in squares.values()])
