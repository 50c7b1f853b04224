"""How far `gap_closed` is as good as it can be: as stated, by an oracle, and by nature without the effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sawbench.blindcheck.score_statistics import Estimate, Floats, Proportion, mean_of, ratio_of_medians, wilson
from sawbench.blindcheck.scored_case import Case

# Share of what can be closed that a correct claim should close.
ENOUGH = 0.9
# Where less of the gap can be closed it is that of the small background effects, and the share says nothing.
LEAST_CLOSABLE = 0.1


@dataclass(frozen=True, kw_only=True, slots=True)
class GapScore:
    """Stated `gap_closed` against that of an oracle which is told the effects.

    Attributes
    ----------
    error, absolute_error : Estimate
        Stated minus oracle, all claims of an effect.
    coverage : Proportion
        How often the stated 95 % interval holds the oracle's value, all claims. The oracle computes it as the answer
        does, from the same recordings: of a correct claim it says no more than that the form was well chosen.
    share_of_oracle : Estimate
        Median stated over median oracle, of correct claims where the oracle closes something.
    share_of_closable : Estimate
        Median stated over median of what is gone in a twin simulated without the effects, of correct claims where that
        is at least `LEAST_CLOSABLE`.
    closes_enough : Proportion
        How often at least `ENOUGH` of that is closed, of the same.
    """

    error: Estimate
    absolute_error: Estimate
    coverage: Proportion
    share_of_oracle: Estimate
    share_of_closable: Estimate
    closes_enough: Proportion


def gap_score(cases: Sequence[Case]) -> GapScore | None:
    """Compare the cases that claim an effect and were shown to the oracle; None where there is none."""
    chosen = [c for c in cases if c.claims_effect and c.gap_closed is not None and c.oracle_gap_closed is not None]
    if not chosen:
        return None
    right = [case for case in chosen if case.answer == case.truth]
    error = _values(chosen, "gap_closed") - _values(chosen, "oracle_gap_closed")
    told = [case for case in right if (case.oracle_gap_closed or 0.0) > 0.0]
    open_gap = [case for case in right if (case.closable or 0.0) >= LEAST_CLOSABLE]
    closed, closable = _values(open_gap, "gap_closed"), _values(open_gap, "closable")
    return GapScore(
        error=mean_of(error),
        absolute_error=mean_of(np.abs(error)),
        coverage=wilson(sum(map(_is_covered, chosen)), len(chosen)),
        share_of_oracle=ratio_of_medians(_values(told, "gap_closed"), _values(told, "oracle_gap_closed")),
        share_of_closable=ratio_of_medians(closed, closable),
        closes_enough=wilson(int(np.sum(closed >= ENOUGH * closable)), len(open_gap)),
    )


def _values(cases: Sequence[Case], name: str) -> Floats:
    """One number of every case, shape (n,)."""
    return np.array([getattr(case, name) for case in cases], dtype=np.float64)


def _is_covered(case: Case) -> bool:
    if case.gap_closed_ci95 is None or case.oracle_gap_closed is None:
        return False
    low, high = case.gap_closed_ci95
    return low <= case.oracle_gap_closed <= high
