"""What the report says of a learned term: where it stands, what it depends on, how far it closes, what it resembles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.answer.hold_out import HoldOut
from sawbench.diagnosis.answer.ladder import Ladder
from sawbench.diagnosis.inference.columns import Column, forms_beside
from sawbench.diagnosis.inference.learning import Learned, learn
from sawbench.diagnosis.inference.linear_problem import LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal
from sawbench.diagnosis.inference.posterior import Posterior
from sawbench.diagnosis.inference.settings import SETTINGS, Z95
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.learned import (
    NAME,
    QUANTITIES,
    SITES,
    LearnedTerm,
    Site,
    learned_effect,
    out_of_range,
)
from sawbench.modeling.residuals import Baseline

_NUMBERS: Final = SETTINGS.learning
# How many effects are listed that a term resembles.
_MOST_SHOWN: Final = 5
_WORDS: Final[Mapping[Site, str]] = {
    "electrical": "in the motor's voltage balance",
    "mechanical": "in the balance of torques",
    "cutting": "in the cutting force",
    "supply": "in the battery's voltage",
    "converter": "in the converter's current",
    "force_reading": "in the reading of the load cell",
}
NOTHING: Final = (
    "no function of one to three measured quantities reduces the error at withheld operating points: no term was"
    " learned"
)


@dataclass(frozen=True, kw_only=True, slots=True)
class LearnedAnswer:
    """A term that predicts withheld operating points.

    Attributes
    ----------
    learned : Learned
    ladder : Ladder
        With the term as the cause.
    resembles : tuple of (str, float)
        Effects with the correlation of their signature, largest first.
    """

    learned: Learned
    ladder: Ladder
    resembles: tuple[tuple[str, float], ...]

    @property
    def known(self) -> KnownEffect:
        """As the model takes it."""
        return KnownEffect(effect=learned_effect(self.learned.term), value=1.0, std=self.learned.rel_std)

    def report(self) -> dict[str, Any]:
        """`learned_term` of the gap report."""
        term, ladder = self.learned.term, self.ladder
        place, unit, channel = SITES[term.site]
        closed, interval = ladder.closed
        return {
            "equation": place,
            "channel": channel,
            "stands_in": term.site,
            "cutting_only": term.is_cutting_only,
            "quantities": [
                {
                    "name": name,
                    "words": QUANTITIES[name].words,
                    "unit": QUANTITIES[name].unit,
                    "range": list(term.range[name]),
                    "dependence": _dependence(term, k),
                }
                for k, name in enumerate(term.quantities)
            ],
            "table": {
                "unit": unit,
                "nodes": [list(nodes) for nodes in term.nodes],
                "values": term.values.tolist(),
                "low": (term.values - Z95 * term.stds).tolist(),
                "high": (term.values + Z95 * term.stds).tolist(),
                "typical": [float(np.median(values)) for values in self.learned.visited],
            },
            "rel_std": self.learned.rel_std,
            "gap_closed": closed,
            "gap_closed_ci95": list(interval),
            "held_out": ladder.held_out,
            "resembles": [{"effect": name, "correlation": value} for name, value in self.resembles],
            "words": self.words(),
        }

    def words(self) -> str:
        """Say it in one sentence, without its full stop."""
        term = self.learned.term
        depends = " and ".join(f"{_dependence(term, k)} {QUANTITIES[q].words}" for k, q in enumerate(term.quantities))
        alike = "no known effect"
        if self.resembles and self.resembles[0][1] >= _NUMBERS.resembles:
            name, value = self.resembles[0]
            alike = f"{name.replace('_', ' ')} (correlation {value:.2f})"
        when = " while the blade cuts" if term.is_cutting_only else ""
        return f"{_WORDS[term.site]}{when}; it {depends}, and resembles {alike}"


def learned_answer(
    problem: LinearProblem, columns: Mapping[str, Sequence[Column]], posterior: Posterior
) -> LearnedAnswer | None:
    """Learn the missing term where the answer is "unknown".

    Parameters
    ----------
    problem : LinearProblem
    columns : mapping of str to sequence of Column
        Signatures of the catalogue, to say what the term resembles.
    posterior : Posterior

    Returns
    -------
    LearnedAnswer or None
        None for every other verdict, for machines other than saws, without a measured crank angle or withheld trials,
        where the model holds a learned term already, and where no term predicts withheld operating points.
    """
    if posterior.verdict != "unknown" or not _can_learn(problem):
        return None
    hold_out = HoldOut(problem, freed=posterior.freed)
    if hold_out.held_out == "nothing":
        return None
    found = learn(problem, hold_out.free_errors)
    if found is None:
        return None
    ladder = HoldOut(problem, found.columns, freed=posterior.freed).climb([[found.columns]])
    taken = 1.0 - (ladder.whitened.with_effect / ladder.whitened.retuned) ** 2
    if taken < _NUMBERS.least_taken or ladder.closed[1][0] <= 0.0:
        return None
    return LearnedAnswer(learned=found, ladder=ladder, resembles=_resembles(problem, columns, found.contribution))


def learned_warnings(problem: LinearProblem, posterior: Posterior, answer: LearnedAnswer | None) -> list[str]:
    """Say where a learned term could not be found, and where one that the model holds is beyond its range."""
    campaign = problem.campaign
    if not isinstance(campaign.baseline, Baseline):
        return []
    said = [NOTHING] if answer is None and posterior.verdict == "unknown" and _can_learn(problem) else []
    return [*said, *out_of_range(campaign.plant.known, campaign.baseline, [part.smooth for part in problem.parts])]


def _can_learn(problem: LinearProblem) -> bool:
    campaign = problem.campaign
    holds_one = any(known.effect.name == NAME for known in campaign.plant.known)
    return isinstance(campaign.baseline, Baseline) and not campaign.angle_is_assumed and not holds_one


def _resembles(
    problem: LinearProblem, columns: Mapping[str, Sequence[Column]], contribution: Floats
) -> tuple[tuple[str, float], ...]:
    """Correlation of the term with the best form of each effect, once what parameters take up is taken out."""
    marginal = Marginal(problem)
    found = {}
    for name, entries in columns.items():
        best = 0.0
        for entry in forms_beside(entries):
            gram, _ = marginal.gram(np.hstack([contribution[:, None], entry.columns]))
            own, with_term, among = gram[0, 0], gram[0, 1:], gram[1:, 1:]
            if len(with_term) == 1:
                # An effect has a sign.
                value = float(with_term[0] / np.sqrt(max(own * among[0, 0], 1e-30)))
            else:
                explained = with_term @ np.linalg.lstsq(among, with_term, rcond=None)[0]
                value = float(np.sqrt(max(explained / max(own, 1e-30), 0.0)))
            best = max(best, min(value, 1.0))
        found[name] = best
    return tuple(sorted(found.items(), key=lambda item: -item[1])[:_MOST_SHOWN])


def _dependence(term: LearnedTerm, axis: int) -> str:
    """Whether the term rises, falls or varies with a quantity, averaged over the others where it is well known."""
    if QUANTITIES[term.quantities[axis]].is_periodic:
        return "varies with"
    others = tuple(k for k in range(term.values.ndim) if k != axis)
    weights = 1.0 / np.maximum(term.stds, 1e-3 * np.abs(term.values).max() + 1e-30) ** 2
    steps = np.diff(np.average(term.values, axis=others, weights=weights) if others else term.values)
    way = float(steps.sum() / max(np.abs(steps).sum(), 1e-30))
    return "rises with" if way > _NUMBERS.one_way else "falls with" if way < -_NUMBERS.one_way else "varies with"
