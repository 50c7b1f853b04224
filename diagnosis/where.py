"""Where the gap lies that re-tuned parameters leave: by equation, crank angle and what it grows with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.recording import Floats
from diagnosis.equations import Equation
from diagnosis.features import wave_of
from diagnosis.linear_problem import LinearProblem, Marginal
from diagnosis.posterior import wide_scale
from diagnosis.state import TWO_PI

_SECTORS = 24
_SHOWN_SHARE = 0.02
_CORRELATED = 0.6


@dataclass(frozen=True, kw_only=True, slots=True)
class Spot:
    """One place of the gap; fields as in the gap report."""

    equation: str
    channel: str
    share: float
    crank_angle_rad: tuple[tuple[float, float], ...]
    grows_with: tuple[str, ...]


def locate(problem: LinearProblem) -> tuple[Spot, ...]:
    """Share the whitened energy that re-tuning leaves among the equations.

    Parameters
    ----------
    problem : LinearProblem

    Returns
    -------
    tuple of Spot
        Largest share first. Energy that noise alone would leave (its median over the features) is taken off.
    """
    marginal = Marginal(problem, scale=wide_scale(problem))
    rest = marginal.rest(marginal.data)
    energy: dict[Equation, float] = {}
    for part in problem.parts:
        block = rest[part.place].reshape(-1, part.layout.size)
        for equation, place in part.layout.slices.items():
            square = block[:, place] ** 2
            noise = float(np.median(square)) / 0.455
            energy[equation] = energy.get(equation, 0.0) + max(float(square.sum()) - noise * square.size, 0.0)
    total = sum(energy.values())
    if total <= 0:
        return ()
    forms = problem.campaign.plant.equations
    spots = [
        Spot(
            equation=forms[equation].place,
            channel=forms[equation].channel,
            share=value / total,
            crank_angle_rad=_sectors(problem, rest, equation),
            grows_with=_grows_with(problem, rest, equation),
        )
        for equation, value in energy.items()
        if value / total > _SHOWN_SHARE
    ]
    return tuple(sorted(spots, key=lambda spot: -spot.share))


def _sectors(problem: LinearProblem, rest: Floats, equation: Equation) -> tuple[tuple[float, float], ...]:
    """Crank-angle ranges that hold more than half again the average square of the mean residual."""
    angle = (np.arange(_SECTORS) + 0.5) * TWO_PI / _SECTORS
    square = np.zeros(_SECTORS)
    for part in problem.parts:
        if part.state.kind != "running" or equation not in part.layout.equations:
            continue
        features = part.unwhiten(rest)
        square += wave_of(features[:, part.layout.slices[equation]].mean(axis=0), angle) ** 2
    if square.sum() <= 0:
        return ()
    high = square > 1.5 * square.mean()
    if not high.any() or high.all():
        return ((0.0, float(TWO_PI)),)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], high.astype(int), [0]])))
    width = TWO_PI / _SECTORS
    return tuple((float(a * width), float(b * width)) for a, b in zip(edges[::2], edges[1::2], strict=True))


def _grows_with(problem: LinearProblem, rest: Floats, equation: Equation) -> tuple[str, ...]:
    """What the size of the residual goes with over the trials, by rank correlation."""
    from scipy.stats import spearmanr

    sizes, speed, load, time, feed = [], [], [], [], []
    for part in problem.parts:
        if part.state.kind != "running" or equation not in part.layout.equations:
            continue
        block = rest[part.place].reshape(-1, part.layout.size)[:, part.layout.slices[equation]]
        sizes.append(float(np.sqrt(np.mean(block**2))))
        speed.append(float(part.state.speed_rad_s.mean()))
        load.append(0.0 if part.state.force_n is None else float(np.abs(part.state.force_n).mean()))
        time.append(part.setting.session_s)
        feed.append(float(np.nan_to_num(part.setting.feed_m_s)))
    found = []
    for name, values in (("speed", speed), ("load", load), ("time", time), ("feed", feed)):
        if (
            len(set(values)) > 2
            and len(set(sizes)) > 2
            and float(np.asarray(spearmanr(values, sizes))[0]) > _CORRELATED
        ):
            found.append(name)
    return tuple(found)
