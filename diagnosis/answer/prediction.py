"""What each hypothesis predicts of withheld trials: one ladder and one forecast each, made when first asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.answer.channel_gap import ChannelGap, forecast
from sawbench.diagnosis.answer.hold_out import HoldOut, grams_without_each, grouping, rows_by_group
from sawbench.diagnosis.answer.ladder import Ladder
from sawbench.diagnosis.inference.columns import Column, columns_in, forms_beside
from sawbench.diagnosis.inference.dispersion import background_with_noise, stacked_with_noise, with_noise
from sawbench.diagnosis.inference.evidence import Explanation, explain
from sawbench.diagnosis.inference.hypothesis import Hypothesis
from sawbench.diagnosis.inference.linear_problem import FORM_OF_KNOWN, LinearProblem
from sawbench.diagnosis.inference.marginal import Marginal, best_within
from sawbench.diagnosis.inference.posterior import Posterior
from sawbench.diagnosis.inference.retuning import Retuning
from sawbench.diagnosis.inference.settings import Z95
from sawbench.diagnosis.inference.size import sized
from sawbench.modeling.effects.effect import BACKGROUND_SHARE, Effect

_MOST_SWEEPS: Final = 4


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


@dataclass(frozen=True, kw_only=True, slots=True)
class LawPrediction:
    """A law beyond the catalogue on withheld trials.

    Attributes
    ----------
    ladder : Ladder
    member : Explanation
        The law in its best form, fitted to all trials.
    """

    ladder: Ladder
    member: Explanation


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
        self._hold_outs: dict[tuple[bool, tuple[str, ...]], HoldOut] = {}
        self._found: dict[tuple[tuple[str, ...], bool, tuple[str, ...]], Prediction] = {}
        self._channels: dict[tuple[str, ...], ChannelGap | None] = {}
        # By cause, the data beyond a little of what it does not name; and ladders of them.
        self._beyond: dict[tuple[str, ...], Floats] = {}
        self._beside_a_little: dict[tuple[object, ...], Ladder] = {}
        # Of each cause, its effects with the magnitudes that the report states.
        self._sized: dict[tuple[str, ...], list[Explanation]] = {}
        # Beside each cause: log evidence that numbers of the plant are wrong, and which.
        self._retuned: dict[tuple[str, ...], tuple[float, tuple[str, ...]]] = {}
        # A model that is solved does not know what the form of a known effect may miss: the rest is fitted alone there.
        solved = problem.only(lambda name: not name.startswith(FORM_OF_KNOWN))
        self._solved = self if len(solved.names) == len(problem.names) else Predictions(solved, columns, posterior)

    def of(
        self, hypothesis: Hypothesis, *, by_trial: bool | None = None, freed: tuple[str, ...] | None = None
    ) -> Prediction:
        """Climb the ladder of one hypothesis.

        Parameters
        ----------
        hypothesis : Hypothesis
        by_trial : bool, optional
            Withhold trials, not operating points; default: where one operating point alone shows one of the effects.
        freed : tuple of str, optional
            Numbers of the plant that a fit may move beyond what is stated of them; default: `_freed_with`.
        """
        if by_trial is None:
            by_trial = any(self.is_local(member) for member in hypothesis.members)
        freed = self._freed_with(hypothesis) if freed is None else freed
        key = (hypothesis.effects, by_trial, freed)
        if key not in self._found:
            hold_out = self._hold_out(by_trial=by_trial, freed=freed)
            forms = self._forms(hypothesis.members)
            ladder = hold_out.climb(_of_any_size(forms))
            self._found[key] = Prediction(hold_out=hold_out, ladder=ladder, forms=forms)
        return self._found[key]

    def beyond_a_little(self, hypothesis: Hypothesis) -> Ladder:
        """Ladder of one hypothesis that leaves what it does where a little of the other effects is taken off first.

        That is what fits best beside the hypothesis, of each effect no more than background is at most: a machine that
        has a cause has a little of other effects too, and quiet sensors show it.
        """
        ladder = self.of(hypothesis).ladder
        left = self.beside_a_little(hypothesis, hypothesis).squares["with_effect"]
        return replace(ladder, squares=ladder.squares | {"with_effect": left})

    def beside_a_little(
        self,
        hypothesis: Hypothesis,
        cause: Hypothesis,
        *,
        by_trial: bool | None = None,
        freed: tuple[str, ...] | None = None,
    ) -> Ladder:
        """Ladder of one hypothesis for data off which a little of all effects is taken that a cause does not name."""
        key = (hypothesis.effects, cause.effects, by_trial, freed)
        if key not in self._beside_a_little:
            prediction = self.of(hypothesis, by_trial=by_trial, freed=freed)
            if cause.effects not in self._beyond:
                self._beyond[cause.effects] = self._without_a_little([m.column for m in cause.members])
            hold_out = prediction.hold_out.of(self._beyond[cause.effects])
            self._beside_a_little[key] = hold_out.climb(_of_any_size(prediction.forms))
        return self._beside_a_little[key]

    def _without_a_little(self, cause: Sequence[Column]) -> Floats:
        """Take off the data, (n,), a little of all effects that a cause does not name: what fits best beside it."""
        named = {column.effect.name for column in cause}
        dispersion = self._posterior.dispersion
        of_others = np.hstack(
            [
                np.zeros((len(dispersion), 0)),
                *(found for name, found in self._posterior.little.items() if name not in named),
            ]
        )
        named_columns = stacked(cause)
        beside = stacked_with_noise(self._problem, [named_columns, of_others], dispersion)
        limits = np.full(beside.shape[1], np.inf)
        limits[named_columns.shape[1] :] = self._problem.settings.forms.least_amplitude / BACKGROUND_SHARE
        fitted = best_within(*self._of_all.gram(beside), limits)[named_columns.shape[1] :]
        taken: Floats = of_others @ fitted
        return self._problem.data - taken

    def of_law(self, law: Effect) -> LawPrediction | None:
        """Climb the ladder of a law beyond the catalogue without a little of all effects; None where it is not seen."""
        columns = columns_in(self._problem, law, law.shapes)
        found = explain(Marginal(self._problem), columns)
        if found is None:
            return None
        hold_out = self._hold_out(by_trial=self.is_local(found), freed=self._posterior.freed)
        forms = [[c.columns] for c in columns if c.columns.shape == found.column.columns.shape]
        data = self._without_a_little([found.column])
        return LawPrediction(ladder=hold_out.of(data).climb(forms), member=found)

    def channels_of(self, hypothesis: Hypothesis) -> ChannelGap | None:
        """Predict the channels of withheld trials with one hypothesis; see `channel_gap.forecast`."""
        if hypothesis.effects not in self._channels:
            by_trial = self.of(hypothesis).ladder.held_out == "trials"
            found = self._solved.of(hypothesis, by_trial=by_trial)
            self._channels[hypothesis.effects] = forecast(found.hold_out, found.ladder, found.forms)
        return self._channels[hypothesis.effects]

    def sized(self, hypothesis: Hypothesis) -> list[Explanation]:
        """Members of a hypothesis with the magnitudes that the report states."""
        if hypothesis.effects not in self._sized:
            self._sized[hypothesis.effects] = sized(
                self._problem, hypothesis.members, self._columns, small=self._posterior.little,
                dispersion=self._posterior.dispersion,
            )  # fmt: skip
        return self._sized[hypothesis.effects]

    def freed_instead(self, hypothesis: Hypothesis, gained: float) -> tuple[str, ...]:
        """Name the numbers of the plant that, wrong, explain more beside a cause than a further effect does.

        Parameters
        ----------
        hypothesis : Hypothesis
            The cause without the further effect.
        gained : float
            Log evidence that the further effect adds.

        Returns
        -------
        tuple of str
            None where the effect explains more: what is stated of every number holds then with it and without it.
        """
        if hypothesis.effects not in self._retuned:
            dispersion, little = self._posterior.dispersion, self._posterior.little
            problem = with_noise(self._problem, dispersion)
            cause = stacked_with_noise(problem, [stacked([m.column for m in hypothesis.members])], dispersion)
            beside = np.hstack([cause, background_with_noise(little, dispersion)])
            retuning = Retuning(problem, Marginal(problem, extra=beside))
            self._retuned[hypothesis.effects] = (retuning.log_evidence, retuning.freed)
        log_evidence, freed = self._retuned[hypothesis.effects]
        return freed if log_evidence > gained else ()

    def _freed_with(self, hypothesis: Hypothesis) -> tuple[str, ...]:
        """Name the numbers of the plant that may be wrong where a cause is claimed.

        Those that pay without any cause, unless the cause explains more than they do: then those that pay beside it.
        Re-tuned by what is likelier an effect, the numbers would predict it as well as the effect does.
        """
        freed = self._posterior.freed
        if not freed or self._posterior.of("parameters").log_evidence > hypothesis.of_means:
            return freed
        return self.freed_instead(hypothesis, 0.0)

    def is_local(self, member: Explanation) -> bool:
        """Whether the trials of one operating point alone know that the effect is there.

        Without them its magnitude would not differ from zero in its 95 % interval, with them it does.
        """
        wave = member.contribution / np.sqrt(self._posterior.dispersion)
        if self._of_all.square(wave) < Z95**2:
            return False
        return any(square < Z95**2 for square in self._squares_without_each_point(wave))

    @cached_property
    def _of_all(self) -> Marginal:
        """All trials, with the noise that the posterior found."""
        return Marginal(with_noise(self._problem, self._posterior.dispersion))

    def _squares_without_each_point(self, wave: Floats) -> list[float]:
        """`Marginal.square` of a column without each operating point; none where trials are withheld instead."""
        held_out, group_of = grouping(self._problem, by_trial=False)
        if held_out != "operating points":
            return []
        problem = with_noise(self._problem, self._posterior.dispersion)
        design = np.column_stack([problem.nuisance, wave])
        squares = []
        for gram in grams_without_each(design, rows_by_group(problem, group_of)).values():
            root = np.linalg.cholesky(np.eye(len(gram) - 1) + gram[:-1, :-1])
            half = np.linalg.solve(root, gram[:-1, -1])
            squares.append(float(gram[-1, -1] - half @ half))
        return squares

    def _hold_out(self, *, by_trial: bool, freed: tuple[str, ...]) -> HoldOut:
        key = (by_trial, freed)
        if key not in self._hold_outs:
            self._hold_outs[key] = HoldOut(self._problem, self._best, by_trial=by_trial, freed=freed)
        return self._hold_outs[key]

    def _forms(self, members: Sequence[Explanation]) -> list[tuple[Column, ...]]:
        """Forms that are chosen from again in every fit: of each effect every one, beside the best ones of the others.

        Several effects are compared with fewer, whose forms are free: they must not be held to one form each. A ladder
        takes forms of as many numbers as the best one has.
        """
        names = {m.effect.name for m in members}
        every = [forms_beside(self._columns[name], names) for name in (m.effect.name for m in members)]
        best = self._best_together([m.column for m in members], every)
        found = [tuple(best)] if best else []
        for k, own in enumerate(best):
            alike = [c for c in every[k] if c is not own and c.columns.shape == own.columns.shape]
            found += [(*best[:k], other, *best[k + 1 :]) for other in alike]
        return found

    def _best_together(self, columns: list[Column], every: Sequence[Sequence[Column]]) -> list[Column]:
        """Best form of each effect beside the others, in turn until none changes."""
        best, alone = list(columns), Marginal(self._problem)
        for _ in range(_MOST_SWEEPS):
            before = list(best)
            for k in range(len(best)):
                others = [*best[:k], *best[k + 1 :]]
                found = explain(alone.beside(stacked(others)) if others else alone, every[k])
                best[k] = best[k] if found is None else found.column
            if all(old is new for old, new in zip(before, best, strict=True)):
                break
        return best


def _of_any_size(forms: Sequence[Sequence[Column]]) -> list[list[Floats]]:
    """Columns of forms at the largest amplitude that occurs: one array for a column that several forms share."""
    found = {id(column): column.of_any_size for form in forms for column in form}
    return [[found[id(column)] for column in form] for form in forms]


def stacked(columns: Sequence[Column]) -> Floats:
    """Columns side by side, at the largest amplitude that occurs."""
    return np.hstack([c.of_any_size for c in columns])
