"""Where the gap between the measurement and the model as configured lies: by equation, crank angle and growth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.features import wave_of
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import Posterior
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.effect import Effect
from sawbench.modeling.residuals import Equation
from sawbench.modeling.state import TWO_PI

_SECTORS = 24


@dataclass(frozen=True, kw_only=True, slots=True)
class Spot:
    """One place of the gap; fields as in the gap report."""

    equation: str
    channel: str
    share: float
    crank_angle_rad: tuple[tuple[float, float], ...]
    grows_with: tuple[str, ...]


def gap_of(problem: LinearProblem, posterior: Posterior) -> tuple[Floats, Floats]:
    """Features of the gap of the model as configured, and of what the likeliest cause leaves of it.

    Parameters
    ----------
    problem : LinearProblem
    posterior : Posterior

    Returns
    -------
    gap, rest : ndarray, shape (n,)
        Whitened. Parameters take up what they can within their stated uncertainty, beside the cause: without it they
        would be dragged along, and leave the gap in other equations than its own.
    """
    cause = sum((m.contribution for m in posterior.best.members), np.zeros(len(problem.data)))
    rest = Marginal(problem).rest(problem.data - cause)
    return cause + rest, rest


def locate(problem: LinearProblem, posterior: Posterior) -> tuple[Spot, ...]:
    """Share the whitened energy of the gap among the equations.

    Parameters
    ----------
    problem : LinearProblem
    posterior : Posterior

    Returns
    -------
    tuple of Spot
        Largest share first; they sum to 1. What the likeliest cause explains counts at the place of its effects: play
        in the yoke is felt in the back-EMF, because the crank angle is read off the plunger, but lies in the yoke. What
        the cause leaves counts in the equation that leaves it, less what an intact machine would leave there.
    """
    gap, rest = gap_of(problem, posterior)
    forms = problem.campaign.plant.equations
    noise = problem.sums_by_equation(np.full(len(rest), problem.quiet))
    energy: dict[tuple[str, str], dict[Equation, float]] = {}

    def add(equation: Equation, value: float, effect: Effect | None = None) -> None:
        form = forms[equation]
        if effect is not None:
            form = next((one for one in forms.values() if one.place == effect.place), form)
        place, channel = form.place, form.channel
        if effect is not None and effect.place == "sensing":
            # What a sensor gets wrong is not the machine's equation that its reading enters.
            place, channel = "sensing", effect.needs[0] if effect.needs else channel
        if value > 0.0:
            held = energy.setdefault((place, channel), {})
            held[equation] = held.get(equation, 0.0) + value

    for equation, value in problem.sums_by_equation(rest**2).items():
        add(equation, value - noise[equation])
    for member in posterior.best.members:
        for equation, value in _explained(problem, posterior, member).items():
            add(equation, value, member.effect)
    total = sum(sum(held.values()) for held in energy.values())
    kept = {place: held for place, held in energy.items() if sum(held.values()) > SETTINGS.report.shown_share * total}
    shown = sum(sum(held.values()) for held in kept.values())
    spots = []
    for (place, channel), held in kept.items():
        main = max(held, key=lambda equation: held[equation])
        spots.append(
            Spot(
                equation=place,
                channel=channel,
                share=sum(held.values()) / shown,
                crank_angle_rad=_sectors(problem, gap, main),
                grows_with=_grows_with(problem, gap, main),
            )
        )
    return tuple(sorted(spots, key=lambda spot: -spot.share))


def _explained(problem: LinearProblem, posterior: Posterior, member: Explanation) -> Mapping[Equation, float]:
    """Energy of one effect by equation; where single strokes carry it, what they say in the equation it moves most."""
    found = problem.sums_by_equation(member.contribution**2)
    said = posterior.strokes.get(member.effect.name)
    if said is not None:
        main = max(found, key=lambda equation: found[equation])
        # A log evidence is half the misfit that it takes away.
        found[main] += 2.0 * max(said.beside_cutting, 0.0)
    return found


def _sectors(problem: LinearProblem, gap: Floats, equation: Equation) -> tuple[tuple[float, float], ...]:
    """Crank-angle ranges that hold more than half again the average square of the mean gap."""
    angle = (np.arange(_SECTORS) + 0.5) * TWO_PI / _SECTORS
    square = np.zeros(_SECTORS)
    for part in problem.parts:
        if part.state.kind != "running" or equation not in part.layout.equations:
            continue
        features = part.unwhiten(gap)
        square += wave_of(features[:, part.layout.slices[equation]].mean(axis=0), angle) ** 2
    if square.sum() <= 0:
        return ()
    high = square > SETTINGS.report.high_square * square.mean()
    if not high.any() or high.all():
        return ((0.0, float(TWO_PI)),)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], high.astype(int), [0]])))
    width = TWO_PI / _SECTORS
    return tuple((float(a * width), float(b * width)) for a, b in zip(edges[::2], edges[1::2], strict=True))


def _grows_with(problem: LinearProblem, gap: Floats, equation: Equation) -> tuple[str, ...]:
    """What the size of the gap goes with over the trials, by rank correlation."""
    sizes, speed, load, time, feed = [], [], [], [], []
    for part in problem.parts:
        if part.state.kind != "running" or equation not in part.layout.equations:
            continue
        block = gap[part.place].reshape(-1, part.layout.size)[:, part.layout.slices[equation]]
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
            and _rank_correlation(values, sizes) > SETTINGS.report.grows_with
        ):
            found.append(name)
    return tuple(found)


def _rank_correlation(one: Sequence[float], other: Sequence[float]) -> float:
    """Spearman's coefficient; `scipy.stats` would take longer to import than everything else here to compute."""
    return float(np.corrcoef(_ranks(one), _ranks(other))[0, 1])


def _ranks(values: Sequence[float]) -> Floats:
    """Ranks from 1 on; equal values share the mean of theirs."""
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - 0.5 * (counts - 1))[place]
