"""What each hypothesis predicts of withheld trials: one ladder and one forecast each, made when first asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.answer.channel_gap import ChannelGap, forecast
from sawbench.diagnosis.answer.ladder import HoldOut, Ladder
from sawbench.diagnosis.inference.dispersion import with_noise
from sawbench.diagnosis.inference.evidence import Column, Explanation
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.linear_problem import LinearProblem, Marginal
from sawbench.diagnosis.inference.posterior import Posterior
from sawbench.diagnosis.inference.settings import Z95


@dataclass(frozen=True, kw_only=True, slots=True)
class Prediction:
    """One hypothesis on withheld trials.

    Attributes
    ----------
    hold_out : HoldOut
    ladder : Ladder
    forms : list of tuple of Column
        For each alternative of the ladder, the columns it was made of, one an effect; empty where there is no cause.
    """

    hold_out: HoldOut
    ladder: Ladder
    forms: list[tuple[Column, ...]]


class Predictions:
    """Ladders of the hypotheses of one campaign.

    Parameters
    ----------
    problem : LinearProblem
    columns : mapping of str to sequence of Column
        By effect.
    posterior : Posterior
        The signatures of its likeliest claim set the noise of the start-ups for all ladders.
    """

    def __init__(self, problem: LinearProblem, columns: Mapping[str, Sequence[Column]], posterior: Posterior) -> None:
        self._problem, self._columns, self._posterior = problem, columns, posterior
        claims = posterior.claims
        self._best = stacked([m.column for m in claims[0].members]) if claims else None
        self._hold_outs: dict[bool, HoldOut] = {}
        self._found: dict[tuple[tuple[str, ...], bool], Prediction] = {}
        self._channels: dict[tuple[str, ...], ChannelGap | None] = {}

    def of(self, hypothesis: Hypothesis, *, by_trial: bool | None = None) -> Prediction:
        """Climb the ladder of one hypothesis.

        Parameters
        ----------
        hypothesis : Hypothesis
        by_trial : bool, optional
            Withhold trials, not operating points; default: where one operating point alone shows one of the effects.
        """
        if by_trial is None:
            by_trial = any(self.is_local(member) for member in hypothesis.members)
        key = (hypothesis.effects, by_trial)
        if key not in self._found:
            hold_out = self._hold_out(by_trial=by_trial)
            forms = self._forms(hypothesis.members)
            ladder = hold_out.climb([stacked(form) for form in forms])
            self._found[key] = Prediction(hold_out=hold_out, ladder=ladder, forms=forms)
        return self._found[key]

    def channels_of(self, hypothesis: Hypothesis) -> ChannelGap | None:
        """Predict the channels of withheld trials with one hypothesis; see `channel_gap.forecast`."""
        if hypothesis.effects not in self._channels:
            found = self.of(hypothesis)
            self._channels[hypothesis.effects] = forecast(found.hold_out, found.ladder, found.forms)
        return self._channels[hypothesis.effects]

    def is_local(self, member: Explanation) -> bool:
        """Whether the trials of one operating point alone know that the effect is there.

        Without them its magnitude would not differ from zero in its 95 % interval, with them it does.
        """
        noise = self._posterior.dispersion
        problem, wave = with_noise(self._problem, noise), (member.contribution / np.sqrt(noise))[:, None]
        least = Z95**2 * problem.settings.weights.temperature

        def information(rows: np.ndarray | None) -> float:
            return float(Marginal(problem, rows=rows).gram(wave)[0][0, 0])

        if information(None) < least:
            return False
        hold_out = self._hold_out(by_trial=False)
        return hold_out.held_out == "operating points" and any(
            information(~rows) < least for rows in hold_out.rows.values()
        )

    def _hold_out(self, *, by_trial: bool) -> HoldOut:
        if by_trial not in self._hold_outs:
            self._hold_outs[by_trial] = HoldOut(self._problem, self._best, by_trial=by_trial)
        return self._hold_outs[by_trial]

    def _forms(self, members: Sequence[Explanation]) -> list[tuple[Column, ...]]:
        """Forms that are chosen from again in every fit: of each effect every one, beside the best ones of the others.

        Several effects are compared with fewer, whose forms are free: they must not be held to one form each.
        """
        best = tuple(m.column for m in members)
        found = [best] if best else []
        for k, own in enumerate(best):
            alike = (c for c in self._columns[own.effect.name] if c.columns.shape == own.columns.shape)
            found += [(*best[:k], other, *best[k + 1 :]) for other in alike if other is not own]
        return found


def stacked(columns: Sequence[Column]) -> Floats:
    """Columns side by side, at the largest amplitude that occurs."""
    return np.hstack([c.columns * c.effect.strength.high for c in columns])
