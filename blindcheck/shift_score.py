"""The score of each kind of bench by itself: right on one says little about another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sawbench.blindcheck.score_rows import Row, score_rows
from sawbench.blindcheck.score_statistics import calibration_error
from sawbench.blindcheck.scored_case import Case

_LEAST_FOR_CALIBRATION = 20


@dataclass(frozen=True, kw_only=True, slots=True)
class ShiftScore:
    """All rows over the cases of one kind of bench.

    Attributes
    ----------
    shift, value : str
        For example "noise" and "1.5 to 4".
    n_cases : int
    rows : tuple of Row
    calibration_error : float or None
        None of fewer than 20 cases with an answer.
    """

    shift: str
    value: str
    n_cases: int
    rows: tuple[Row, ...]
    calibration_error: float | None


def shift_scores(cases: Sequence[Case]) -> tuple[ShiftScore, ...]:
    """Score every kind of bench by itself, where the cases are of more than one."""
    found = []
    for shift in dict.fromkeys(name for case in cases for name in case.shifts):
        values = sorted({case.shifts[shift] for case in cases if shift in case.shifts}, key=_in_order)
        if len(values) > 1:
            found += [_scored(shift, value, [c for c in cases if c.shifts.get(shift) == value]) for value in values]
    return tuple(found)


def _in_order(value: str) -> tuple[float, str]:
    """Bins by their lower edge, words by the alphabet."""
    first = value.split(maxsplit=1)[0]
    return (float(first), value) if first.replace(".", "").isdigit() else (0.0, value)


def _scored(shift: str, value: str, cases: Sequence[Case]) -> ShiftScore:
    given = [case for case in cases if not case.is_failed]
    error = None
    if len(given) >= _LEAST_FOR_CALIBRATION:
        stated = np.array([case.probabilities[case.top] for case in given])
        right = np.array([float(case.top == case.truth) for case in given])
        error = calibration_error(stated, right, min(len(given) // 10, 10))
    return ShiftScore(shift=shift, value=value, n_cases=len(cases), rows=score_rows(cases), calibration_error=error)
