"""The score of a set of answers, from this repository's diagnosis or from any other method."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from sawbench.blindcheck.claims import RuntimeScore, runtime_score
from sawbench.blindcheck.effects.table import CATALOGUE, OUTSIDE
from sawbench.blindcheck.gap_score import GapScore, gap_score
from sawbench.blindcheck.parameter_score import ParameterScore, parameter_score
from sawbench.blindcheck.score_rows import Row, in_group, is_exact, is_typical, score_rows
from sawbench.blindcheck.score_statistics import Calibration, Estimate, Proportion, calibration_of, mean_of, wilson
from sawbench.blindcheck.scored_case import FAILED, UNKNOWN, VERDICTS, Case, Hypothesis, name_of
from sawbench.blindcheck.shift_score import ShiftScore, shift_scores

SEVERITY_EDGES = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0)
PAIR_COLUMN = "two effects"
_N_WORST = 10
_N_SHOWN = 5


@dataclass(frozen=True, kw_only=True, slots=True)
class Confusion:
    """Cases by truth (rows) and answer (columns).

    Attributes
    ----------
    rows, columns : tuple of str
    counts : tuple of tuple of int
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class SeverityBin:
    """Cases with one effect of about the same severity, by what came of them."""

    low: float
    high: float
    exact: int
    group: int
    other_effect: int
    not_declared: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Miss:
    """A case whose truth was given little probability."""

    name: str
    kind: str
    truth: str
    answer: str
    log_loss: float
    truth_probability: float
    probabilities: tuple[tuple[str, float], ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Score:
    """All that is said about a set of answers.

    Attributes
    ----------
    n_cases, n_failed : int
    n_by_kind : dict of str to int
    rows : tuple of Row
    chance_exact : float or None
        The share "exact" that the same answers, assigned at random among the typical single effects, would have.
    group_size : Estimate
        Number of effects in the answered groups.
    brier : Estimate
        Over all hypotheses, 0..2.
    log_loss : Estimate
        Nats; probabilities below `PROBABILITY_FLOOR` count as that.
    calibration : Calibration
        Of the most probable hypothesis; failed answers left out.
    calibration_of_claims : Calibration
        The same where an effect is claimed: an effect that a campaign cannot show is rightly answered "no gap", at a
        probability that depends on how often the set hides such ones.
    confusion, families : Confusion
        By effect; by the part of the bench that the effect sits in.
    severity : tuple of SeverityBin
    outside : dict of str to Proportion
        How often each effect outside the catalogue was called unknown.
    gap : GapScore or None
        None where no oracle was asked.
    parameters : ParameterScore
        Of correct claims.
    runtime : RuntimeScore
        Of correct claims.
    by_shift : tuple of ShiftScore
        The rows of each kind of bench; empty where the cases are of one kind.
    time_median_s, time_p95_s : float or None
    times_s : tuple of float
    worst : tuple of Miss
        Greatest log-loss first; those without an answer left out.
    failed : tuple of str
        Cases without an answer.
    """

    n_cases: int
    n_failed: int
    n_by_kind: dict[str, int]
    rows: tuple[Row, ...]
    chance_exact: float | None
    group_size: Estimate
    brier: Estimate
    log_loss: Estimate
    calibration: Calibration
    calibration_of_claims: Calibration
    confusion: Confusion
    families: Confusion
    severity: tuple[SeverityBin, ...]
    outside: dict[str, Proportion]
    gap: GapScore | None
    parameters: ParameterScore
    runtime: RuntimeScore
    by_shift: tuple[ShiftScore, ...]
    time_median_s: float | None
    time_p95_s: float | None
    times_s: tuple[float, ...]
    worst: tuple[Miss, ...]
    failed: tuple[str, ...]

    def row(self, key: str) -> Proportion:
        """Return the value of one row."""
        return next(row.value for row in self.rows if row.key == key)


def score(cases: Sequence[Case]) -> Score:
    """Score answers.

    Examples
    --------
    >>> told = {"kind": "effect", "effects": {"edge_force": 1.0}}
    >>> right = Case(name="a", **told, probabilities={"edge_force": 0.9, "no_gap": 0.1})
    >>> wrong = Case(name="b", **told, probabilities={"blade_wear": 1.0})
    >>> score([right, wrong]).row("exact").share
    0.5
    """
    given = [case for case in cases if not case.is_failed]
    times = np.array([case.time_s for case in cases if case.time_s is not None])
    outside = [(next(iter(case.effects), ""), case.answer == UNKNOWN) for case in cases if case.kind == "outside"]
    return Score(
        n_cases=len(cases),
        n_failed=len(cases) - len(given),
        n_by_kind=dict(sorted(Counter(case.kind for case in cases).items())),
        rows=score_rows(cases),
        chance_exact=_chance([case for case in cases if is_typical(case)]),
        group_size=mean_of(np.array([float(len(case.group)) for case in cases if case.claims_effect])),
        brier=mean_of(np.array([case.brier for case in cases])),
        log_loss=mean_of(np.array([case.log_loss for case in cases])),
        calibration=_calibration(given),
        calibration_of_claims=_calibration([case for case in given if case.claims_effect]),
        confusion=_confusion(cases, _effect_label, _hidden_effects(cases)),
        families=_confusion(cases, _family_label, tuple(dict.fromkeys(map(family_of, CATALOGUE)))),
        severity=_by_severity([case for case in cases if case.kind == "effect"]),
        outside={
            name: wilson(sum(found for other, found in outside if other == name), count)
            for name, count in sorted(Counter(name for name, _ in outside).items())
        },
        gap=gap_score(cases),
        parameters=parameter_score([one for case in cases if is_exact(case) for one in case.parameters]),
        runtime=runtime_score([case.runtime_misses for case in cases if is_exact(case) and case.claims_effect]),
        by_shift=shift_scores(cases),
        time_median_s=float(np.median(times)) if len(times) else None,
        time_p95_s=float(np.quantile(times, 0.95)) if len(times) else None,
        times_s=tuple(map(float, times)),
        worst=_worst(given),
        failed=tuple(case.name for case in cases if case.is_failed),
    )


def _calibration(cases: Sequence[Case]) -> Calibration:
    return calibration_of(
        np.array([case.probabilities[case.top] for case in cases]),
        np.array([case.top == case.truth for case in cases], dtype=np.bool_),
    )


def family_of(effect: str) -> str:
    """Return the part of the bench that an effect sits in."""
    known = {**CATALOGUE, **OUTSIDE}
    return known[effect].__module__.rpartition(".")[2] if effect in known else "other"


def _hidden_effects(cases: Sequence[Case]) -> tuple[str, ...]:
    """Effects of the first catalogue, and those that a later one lists and a case hides."""
    return tuple(dict.fromkeys([*CATALOGUE, *sorted(e for c in cases if c.kind == "effect" for e in c.effects)]))


def _chance(cases: Sequence[Case]) -> float | None:
    if not cases:
        return None
    truths, answers = (Counter(getattr(case, side) for case in cases) for side in ("truth", "answer"))
    return sum(n * answers[truth] for truth, n in truths.items()) / len(cases) ** 2


def _confusion(cases: Sequence[Case], label: Callable[[Hypothesis], str], effects: tuple[str, ...]) -> Confusion:
    verdicts = tuple(map(name_of, VERDICTS))
    rows = (*effects, PAIR_COLUMN, *verdicts)
    counts = Counter((label(case.truth), label(case.answer)) for case in cases)
    extra = tuple(sorted({answer for _, answer in counts} - set(rows)))
    return Confusion(
        rows=rows,
        columns=rows + extra,
        counts=tuple(tuple(counts[row, column] for column in rows + extra) for row in rows),
    )


def _effect_label(hypothesis: Hypothesis) -> str:
    return PAIR_COLUMN if len(hypothesis) > 1 else name_of(hypothesis)


def _family_label(hypothesis: Hypothesis) -> str:
    if len(hypothesis) > 1:
        return PAIR_COLUMN
    return name_of(hypothesis) if hypothesis in (*VERDICTS, FAILED) else family_of(name_of(hypothesis))


def _by_severity(singles: Sequence[Case]) -> tuple[SeverityBin, ...]:
    bins = []
    for low, high in pairwise(SEVERITY_EDGES):
        top = np.nextafter(high, np.inf) if high == SEVERITY_EDGES[-1] else high
        chosen = [case for case in singles if low <= max(case.effects.values()) < top]
        exact = sum(map(is_exact, chosen))
        group = sum(in_group(case) and not is_exact(case) for case in chosen)
        declared = sum(case.claims_effect for case in chosen)
        bins.append(
            SeverityBin(
                low=low, high=high, exact=exact, group=group, other_effect=declared - exact - group,
                not_declared=len(chosen) - declared,
            )
        )  # fmt: skip
    return tuple(bins)


def _worst(cases: Sequence[Case]) -> tuple[Miss, ...]:
    wrong = [case for case in cases if not is_exact(case) or case.top != case.truth]
    ordered = sorted(wrong, key=lambda case: (-case.log_loss, case.probability_of(case.truth), case.name))
    return tuple(
        Miss(
            name=case.name,
            kind=case.kind,
            truth=describe_truth(case.kind, case.effects),
            answer=name_of(case.answer),
            log_loss=case.log_loss,
            truth_probability=case.probability_of(case.truth),
            probabilities=tuple((name_of(h), case.probabilities[h]) for h in case.ranked(_N_SHOWN)),
        )
        for case in ordered[:_N_WORST]
    )


def describe_truth(kind: str, effects: Mapping[str, float]) -> str:
    """Say what a case hides.

    Examples
    --------
    >>> describe_truth("pair", {"edge_force": 1.25, "blade_wear": 0.5})
    'edge_force (severity 1.25) + blade_wear (severity 0.50)'
    """
    if not effects:
        return "nothing" if kind == "none" else "parameters"
    return " + ".join(f"{name} (severity {severity:.2f})" for name, severity in effects.items())
