"""One case as the score sees it: the truth, and probabilities over hypotheses, from whoever answered."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from sawbench.bench.errors import InputError
from sawbench.blindcheck.claims import is_coherent, is_detectable, place_of, runtime_misses
from sawbench.blindcheck.effects.table import CATALOGUE
from sawbench.blindcheck.nuisances import SENSOR_FAULTS
from sawbench.blindcheck.parameter_score import StatedParameter, stated_parameters
from sawbench.blindcheck.shifts import shifts_of

Hypothesis = frozenset[str]
Name = str | tuple[str, ...] | frozenset[str]
NO_GAP: Hypothesis = frozenset({"no_gap"})
PARAMETERS: Hypothesis = frozenset({"parameters"})
UNKNOWN: Hypothesis = frozenset({"unknown"})
FAILED: Hypothesis = frozenset({"failed"})
VERDICTS: tuple[Hypothesis, ...] = (NO_GAP, PARAMETERS, UNKNOWN)
PROBABILITY_FLOOR = 1e-4
_SUM_TOLERANCE = 0.01
_TRUTH = MappingProxyType({"none": NO_GAP, "parameters": PARAMETERS, "outside": UNKNOWN})


def hypothesis_of(name: Name) -> Hypothesis:
    """Return the set of ids that a name stands for.

    Examples
    --------
    >>> hypothesis_of("a + b") == hypothesis_of(("b", "a"))
    True
    """
    return frozenset(name.split(" + ")) if isinstance(name, str) else frozenset(name)


def name_of(hypothesis: Hypothesis) -> str:
    """Return the ids in alphabetical order, joined by " + "."""
    return " + ".join(sorted(hypothesis))


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """Truth and answer of one case.

    Attributes
    ----------
    name : str
    kind : {"none", "parameters", "effect", "pair", "several", "outside"}
    effects : mapping of str to float
        True severity by effect id.
    probabilities : mapping of str, tuple or frozenset to float
        By effect id, "no_gap", "parameters", "unknown", or the ids of a pair (a tuple, a frozenset, or "a + b").
        They may sum to less than 1: the rest is spread evenly over what is not listed.
    verdict : str, tuple or frozenset, optional
        The one hypothesis that is declared; the most probable unless given.
    indistinguishable_from : collection of str
        Effects that the answer says it cannot tell from the declared one.
    gap_closed, oracle_gap_closed : float, optional
        Share of the withheld gap that the declared and the true effect close.
    gap_closed_ci95 : tuple of float, optional
    closable : float, optional
        Share of the withheld gap that is gone in a twin simulated without the hidden effects.
    parameters : tuple of StatedParameter
        Numbers that the answer states of the declared effects that are hidden, beside the true ones.
    place : str, optional
        Equation with the largest share of the gap, as the answer says.
    says_where : bool
        Whether the answer can say so at all: another method may have no such place.
    is_coherent : bool, optional
        Whether what is claimed agrees with itself; None where nothing is claimed, or no size is told.
    is_detectable : bool, optional
        Whether each of the hidden effects lies above the detection limit that the answer states of it; None where there
        is none, or no limit is stated of one.
    runtime_misses : mapping of str to float
        Of `claims.runtime_misses`.
    shifts : mapping of str to str
        Kind of bench, of `shifts.shifts_of`.
    has_faulty_sensors : bool
    n_effects : int
        Effects that the answer chooses among.
    time_s : float, optional
        Wall time of the answer.
    largest_shift_sigmas : float, optional
        Of the true plant constants, in their stated standard deviations.
    is_failed : bool
        There is no answer; scored as wrong everywhere.

    Raises
    ------
    InputError
        If a probability is not a number in 0..1, or they sum to more than 1.
    """

    name: str
    kind: str
    effects: Mapping[str, float]
    probabilities: Mapping[Any, float]
    verdict: Name | None = None
    indistinguishable_from: Collection[str] = ()
    gap_closed: float | None = None
    gap_closed_ci95: tuple[float, float] | None = None
    oracle_gap_closed: float | None = None
    closable: float | None = None
    parameters: tuple[StatedParameter, ...] = ()
    place: str | None = None
    says_where: bool = False
    is_coherent: bool | None = None
    is_detectable: bool | None = None
    runtime_misses: Mapping[str, float] = field(default_factory=dict)
    shifts: Mapping[str, str] = field(default_factory=dict)
    has_faulty_sensors: bool = False
    n_effects: int = len(CATALOGUE)
    time_s: float | None = None
    largest_shift_sigmas: float | None = None
    is_failed: bool = False

    def __post_init__(self) -> None:
        merged: dict[Hypothesis, float] = {}
        for key, value in self.probabilities.items():
            if not (math.isfinite(value) and -1e-9 <= value <= 1.0 + _SUM_TOLERANCE):
                raise InputError(f"probability of {key!r} is {value!r}, allowed is 0 to 1", where=self.name)
            merged[hypothesis_of(key)] = merged.get(hypothesis_of(key), 0.0) + max(float(value), 0.0)
        total = sum(merged.values())
        if total > 1.0 + _SUM_TOLERANCE:
            raise InputError(f"probabilities sum to {total:.4g}, allowed is at most 1", where=self.name)
        if not merged and not self.is_failed:
            raise InputError("has no probabilities", where=self.name)
        scale = 1.0 / max(total, 1.0)
        object.__setattr__(self, "probabilities", MappingProxyType({h: p * scale for h, p in merged.items()}))
        object.__setattr__(self, "indistinguishable_from", frozenset(self.indistinguishable_from))

    @property
    def n_hypotheses(self) -> int:
        """Single effects, pairs of them, and the three other verdicts."""
        return self.n_effects * (self.n_effects + 1) // 2 + len(VERDICTS)

    @property
    def truth(self) -> Hypothesis:
        """What the answer should have been."""
        return _TRUTH.get(self.kind, frozenset(self.effects))

    @property
    def top(self) -> Hypothesis:
        """The most probable hypothesis; the first in the order of the names among equals."""
        if self.is_failed:
            return FAILED
        return min(self.probabilities, key=lambda h: (-self.probabilities[h], name_of(h)))

    @property
    def answer(self) -> Hypothesis:
        """What was declared."""
        if self.is_failed:
            return FAILED
        return self.top if self.verdict is None else hypothesis_of(self.verdict)

    @property
    def claims_effect(self) -> bool:
        """Whether an effect of the catalogue, or several, was declared."""
        return self.answer != FAILED and self.answer not in VERDICTS

    @property
    def group(self) -> frozenset[str]:
        """Declared effects and what the answer cannot tell from them; empty where none was declared."""
        return self.answer | frozenset(self.indistinguishable_from) if self.claims_effect else frozenset()

    def ranked(self, n: int) -> list[Hypothesis]:
        """Return the `n` most probable hypotheses."""
        return sorted(self.probabilities, key=lambda h: (-self.probabilities[h], name_of(h)))[:n]

    def probability_of(self, hypothesis: Hypothesis) -> float:
        """Return the probability given to a hypothesis, listed or not; 0 where there is no answer."""
        return 0.0 if self.is_failed else self.probabilities.get(hypothesis, self._share_of_rest())

    @property
    def log_loss(self) -> float:
        """-ln of the truth's probability, at least `PROBABILITY_FLOOR`, nats."""
        return -math.log(max(self.probability_of(self.truth), PROBABILITY_FLOOR)) + 0.0

    @property
    def brier(self) -> float:
        """Sum of squared errors over all hypotheses, 0..2; 2 where there is no answer."""
        if self.is_failed:
            return 2.0
        rest = self._share_of_rest()
        total = sum((p - (h == self.truth)) ** 2 for h, p in self.probabilities.items())
        total += (self.n_hypotheses - len(self.probabilities)) * rest**2
        return total if self.truth in self.probabilities else total + (rest - 1.0) ** 2 - rest**2

    def _share_of_rest(self) -> float:
        n_unlisted = self.n_hypotheses - len(self.probabilities)
        return max(0.0, 1.0 - sum(self.probabilities.values())) / n_unlisted if n_unlisted > 0 else 0.0


def case_of(
    name: str,
    label: Mapping[str, Any],
    answer: Mapping[str, Any],
    *,
    catalogue: Collection[str] = (),
    oracle_gap_closed: float | None = None,
    closable: float | None = None,
) -> Case:
    """Bring the label of a sealed case and the answer to it together.

    Parameters
    ----------
    name : str
    label : mapping
        Of `sealing.verify`.
    answer : mapping
        Of `answering.read_answers`: `report` is a gap report, or None where there is none.
    catalogue : collection of str
        Effects that the answer chose among. An effect that was drawn from outside of the catalogue and is listed there
        by now counts as one of it.
    oracle_gap_closed, closable : float, optional

    Returns
    -------
    Case
        Failed where the report lacks what is scored.
    """
    truth = label["truth"]
    is_listed = label["kind"] == "outside" and set(truth["effects"]) <= set(catalogue)
    told: dict[str, Any] = {
        "name": name,
        "kind": "effect" if is_listed else label["kind"],
        "n_effects": len(catalogue) or len(CATALOGUE),
        "shifts": shifts_of(truth),
        "has_faulty_sensors": bool(SENSOR_FAULTS & set(truth.get("nuisances", {}))),
        "says_where": True,
        "effects": dict(truth["effects"]),
        "oracle_gap_closed": oracle_gap_closed,
        "closable": closable,
        "largest_shift_sigmas": max((abs(z) for z in truth.get("shifts", {}).values()), default=None),
        "time_s": answer.get("time_s"),
    }
    report = answer.get("report")
    try:
        return Case(**told, **_answered(report, truth)) if report else Case(**told, probabilities={}, is_failed=True)
    except (InputError, KeyError, TypeError, ValueError, IndexError):
        return Case(**told, probabilities={}, is_failed=True)


def _answered(report: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, Any]:
    causes = report["causes"]
    probabilities: dict[Any, float] = {name: float(p) for name, p in report["probabilities"].items()}
    # The contract lists the likely causes; the whole table, where the report has one, is fairer to the unlikely ones.
    whole = report.get("detail", {}).get("probabilities", {})
    for name, probability in whole.items():
        probabilities[name if name in probabilities else tuple(name.split(" + "))] = float(probability)
    for cause in causes:
        probabilities[tuple(cause["effects"])] = float(cause["probability"])
    found = {
        "probabilities": probabilities,
        "place": place_of(report),
        "is_detectable": is_detectable(report, truth),
        "runtime_misses": runtime_misses(report),
    }
    if report["verdict"] not in {"effect", "effects"}:
        return found | {"verdict": report["verdict"]}
    first = causes[0]
    return found | {
        "verdict": tuple(first["effects"]),
        "indistinguishable_from": list(first["indistinguishable_from"]),
        "gap_closed": float(first["gap_closed"]),
        "gap_closed_ci95": tuple(map(float, first["gap_closed_ci95"])),
        "parameters": stated_parameters(truth, first),
        "is_coherent": is_coherent(first),
    }
