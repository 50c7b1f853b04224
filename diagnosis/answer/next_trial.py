"""Which one extra trial would best separate what is still confused."""

from __future__ import annotations

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.evidence import Explanation
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import Posterior
from sawbench.diagnosis.inference.settings import SETTINGS


def next_trial(problem: LinearProblem, posterior: Posterior) -> str:
    """Advise one extra trial, in words.

    Parameters
    ----------
    problem : LinearProblem
    posterior : Posterior

    Returns
    -------
    str
        What the campaign lacks first (idle run, duties, repeat, feed); else the operating point at which the two
        likeliest causes differ most once parameters are re-tuned, with the log odds one more trial there is worth.
    """
    campaign = problem.campaign
    top = posterior.best
    lacking = campaign.plant.next_trial(campaign.states, has_gap=top.other != "no_gap")
    if lacking is not None:
        return lacking
    if top.other == "no_gap":
        return "none: the model explains the measurements"
    if top.other is not None:
        return f"a longer trial at {_most_left(problem, posterior)}: most of the unexplained residual is there"
    alone = {e.effect.name: e for e in posterior.explanations}
    leading = max((alone[name] for name in top.effects), key=lambda e: e.gain)
    is_sure = top.probability > SETTINGS.report.settled
    # No trial is worth telling a cause from one that is out of the question; of a sure cause all are.
    least = 0.0 if is_sure else SETTINGS.report.shown_probability
    rivals = [
        alone[h.name] for h in posterior.claims
        if len(h.effects) == 1 and h.name not in top.effects and h.probability >= least
    ]  # fmt: skip
    return _between(problem, posterior, leading, rivals, is_sure=is_sure)


def _between(
    problem: LinearProblem, posterior: Posterior, named: Explanation, rivals: list[Explanation], *, is_sure: bool
) -> str:
    """Say which trial separates the named cause from its likeliest rival."""
    noise = posterior.dispersion
    if not rivals:
        point, _ = _most_informative(problem, named.contribution, noise)
        return f"a repeat of {point}: it reduces the uncertainty of the magnitude of {_words(named)} most"
    point, worth = _most_informative(problem, named.contribution - rivals[0].contribution, noise)
    words, other = _words(named), _words(rivals[0])
    if is_sure:
        return (
            f"none is needed to identify the cause; a repeat of {point} would confirm the distinction between"
            f" {words} and {other}"
        )
    if worth > SETTINGS.report.worth:
        return f"one more trial at {point}: there {words} and {other} differ most (log odds {worth:.0f})"
    return f"{named.effect.told_apart_by or point}: it separates {words} from {other}"


def _words(explanation: Explanation) -> str:
    return explanation.effect.name.replace("_", " ")


def _most_informative(problem: LinearProblem, difference: Floats, dispersion: Floats) -> tuple[str, float]:
    """Operating point at which a whitened difference is largest after re-tuning, and half its square for a trial."""
    rest = Marginal(problem).rest(difference) / np.sqrt(dispersion)
    squares: dict[str, float] = {}
    trials: dict[str, set[str]] = {}
    for part in problem.parts:
        point = part.setting.operating_point
        squares[point] = squares.get(point, 0.0) + float(np.sum(rest[part.place] ** 2))
        trials.setdefault(point, set()).add(part.setting.label)
    each = {point: 0.5 * square / len(trials[point]) for point, square in squares.items()}
    best = max(each, key=lambda point: each[point])
    return best, each[best]


def _most_left(problem: LinearProblem, posterior: Posterior) -> str:
    """Operating point with the largest misfit a number while running, after re-tuning and the best effect.

    A longer trial has no more of its start.
    """
    best = max(posterior.explanations, key=lambda e: e.gain, default=None)
    data = problem.data if best is None else problem.data - best.contribution
    rest = Marginal(problem).rest(data)
    means: dict[str, list[float]] = {}
    for part in [p for p in problem.parts if p.state.kind == "running"] or problem.parts:
        means.setdefault(part.setting.operating_point, []).append(float(np.mean(rest[part.place] ** 2)))
    return max(means, key=lambda point: float(np.mean(means[point])))
