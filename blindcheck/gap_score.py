"""How far `gap_closed` is as good as it can be: stated, and by an oracle that is told the effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from blindcheck.score_statistics import Estimate, Floats, Proportion, mean_of, ratio_of_medians, wilson
from blindcheck.scored_case import Case

# Share of the oracle's `gap_closed` that a right claim should close.
ENOUGH = 0.9


@dataclass(frozen=True, kw_only=True, slots=True)
class GapScore:
    """Stated `gap_closed` against that of an oracle which is told the effects.

    Attributes
    ----------
    error, absolute_error : Estimate
        Stated minus oracle, all claims of an effect.
    coverage, right_coverage : Proportion
        How often the stated 95 % interval holds the oracle's value, of all claims and of right ones.
    share_of_oracle : Estimate
        Median stated over median oracle, of right claims where the oracle closes something.
    closes_enough : Proportion
        How often at least `ENOUGH` of what the oracle closes is closed, of the same.
    """

    error: Estimate
    absolute_error: Estimate
    coverage: Proportion
    right_coverage: Proportion
    share_of_oracle: Estimate
    closes_enough: Proportion


def gap_score(cases: Sequence[Case]) -> GapScore | None:
    """Compare the cases that claim an effect and were shown to the oracle; None where there is none."""
    chosen = [c for c in cases if c.claims_effect and c.gap_closed is not None and c.oracle_gap_closed is not None]
    if not chosen:
        return None
    right = [case for case in chosen if case.answer == case.truth]
    stated, oracle = _stated_and_oracle(chosen)
    right_stated, right_oracle = _stated_and_oracle([c for c in right if (c.oracle_gap_closed or 0.0) > 0.0])
    return GapScore(
        error=mean_of(stated - oracle),
        absolute_error=mean_of(np.abs(stated - oracle)),
        coverage=wilson(sum(map(_is_covered, chosen)), len(chosen)),
        right_coverage=wilson(sum(map(_is_covered, right)), len(right)),
        share_of_oracle=ratio_of_medians(right_stated, right_oracle),
        closes_enough=wilson(int(np.sum(right_stated >= ENOUGH * right_oracle)), len(right_oracle)),
    )


def _stated_and_oracle(cases: Sequence[Case]) -> tuple[Floats, Floats]:
    """Return both values of `gap_closed`, each of shape (n,)."""
    pairs = np.array([(case.gap_closed, case.oracle_gap_closed) for case in cases], dtype=np.float64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _is_covered(case: Case) -> bool:
    if case.gap_closed_ci95 is None or case.oracle_gap_closed is None:
        return False
    low, high = case.gap_closed_ci95
    return low <= case.oracle_gap_closed <= high
