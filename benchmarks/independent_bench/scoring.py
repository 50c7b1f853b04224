"""Scores the answers of a set: what was hidden beside what the gap reports declare, as a Markdown page."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

ANSWERS: Final = "answers"
REPORT: Final = "gap_report.json"
# Verdicts that declare effects; a report that only narrows the cause down to a group may say the last one.
_GROUP_VERDICT: Final = "indistinguishable"
_CLAIMS: Final = frozenset({"effect", "effects", _GROUP_VERDICT})
_NO_ANSWER: Final = "no answer"
# A stated number holds the true one within so many of its standard uncertainties.
_WITHIN_STD: Final = 2.0
_N_SHOWN = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Answered:
    """Truth and answer of one case.

    Attributes
    ----------
    name, kind : str
    hidden : mapping of str to float
        Severity of every hidden effect; of mis-set parameters, the error in standard deviations.
    numbers : mapping of str to mapping
        By effect: name and true value of the number that a report states.
    verdict : str
        Of the report; "no answer" where there is none.
    declared : frozenset of str
        Effects of the first cause, where one is declared.
    group : frozenset of str
        The same with those said to be indistinguishable.
    probability : float
        Of what is declared; 0 where nothing is.
    stated : mapping of str to mapping
        By name of the number: `value` and `std`, as the first cause states them.
    ranked : tuple of (str, float)
        Causes and verdicts with their probabilities, most probable first.
    shows : mapping, optional
        How far the hidden effects show: `channel` and `times_noise`.
    """

    name: str
    kind: str
    hidden: Mapping[str, float]
    verdict: str = _NO_ANSWER
    numbers: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    declared: frozenset[str] = frozenset()
    group: frozenset[str] = frozenset()
    probability: float = 0.0
    stated: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    ranked: tuple[tuple[str, float], ...] = ()
    shows: Mapping[str, Any] | None = None

    @property
    def claims(self) -> bool:
        """Whether an effect, or several, is declared."""
        return self.verdict in _CLAIMS

    @property
    def is_exact(self) -> bool:
        """Whether the hidden effects, and no other, are declared; a verdict that only names a group is not exact."""
        return self.claims and self.verdict != _GROUP_VERDICT and self.declared == set(self.hidden)

    @property
    def is_within(self) -> bool:
        """Whether the declared effects, and those said to be indistinguishable, hold all hidden ones."""
        return self.claims and set(self.hidden) <= self.group

    def magnitudes(self) -> list[bool]:
        """Of every hidden effect that is declared with a number of plain meaning: whether this holds the true one.

        Left out where two of the declared effects would state a number of the same name.
        """
        found = []
        for effect in self.declared & set(self.numbers):
            others = [self.numbers.get(other, {}) for other in self.declared - {effect}]
            for name, true in self.numbers[effect].items():
                if name in self.stated and not any(name in other for other in others):
                    stated = self.stated[name]
                    found.append(abs(stated["value"] - true) <= _WITHIN_STD * stated["std"])
        return found


def answered(name: str, entry: Mapping[str, Any], report: Mapping[str, Any] | None) -> Answered:
    """Put an entry of the key and a gap report together.

    Parameters
    ----------
    name : str
    entry : mapping
    report : mapping or None
        Contents of `gap_report.json`; None where the command left none.
    """
    truth: dict[str, Any] = {
        "name": name, "kind": entry["kind"], "hidden": entry["effects"], "numbers": entry["numbers"],
        "shows": entry.get("shows"),
    }  # fmt: skip
    if report is None:
        return Answered(**truth)
    ranked = [(" + ".join(sorted(cause["effects"])), cause["probability"]) for cause in report["causes"]]
    ranked += list(report["probabilities"].items())
    answer: dict[str, Any] = {
        "verdict": report["verdict"], "ranked": tuple(sorted(ranked, key=lambda row: -row[1])[:_N_SHOWN])
    }  # fmt: skip
    if report["verdict"] in _CLAIMS:
        cause = report["causes"][0]
        answer |= {
            "declared": frozenset(cause["effects"]),
            "group": frozenset(cause["effects"]) | frozenset(cause["indistinguishable_from"]),
            "probability": cause["probability"],
            "stated": cause["parameters"],
        }
    return Answered(**truth, **answer)


def read_answers(folder: Path, key: Path) -> list[Answered]:
    """Read the key and the answers of a set, in the order of the key."""
    entries = json.loads(key.read_text(encoding="utf-8"))["cases"]
    found = []
    for name, entry in entries.items():
        path = folder / ANSWERS / name / REPORT
        report = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
        found.append(answered(name, entry, report))
    return found


def score_page(cases: Sequence[Answered]) -> str:
    """Two tables, Markdown: the counts, and a line for every case."""
    lines = ["| of | what | count |", "|---|---|---|"]
    lines += [f"| {of} | {what} | {count} |" for of, what, count in score_rows(cases)]
    lines += ["", "| case | kind | hidden | shows | verdict | most probable |", "|---|---|---|---|---|---|"]
    lines += [_case_line(case) for case in cases]
    return "\n".join(lines)


def score_rows(cases: Sequence[Answered]) -> list[tuple[str, str, str]]:
    """Count: of which cases, what, and how many of how many.

    Parameters
    ----------
    cases : sequence of Answered

    Returns
    -------
    list of tuple
    """

    def of(kind: str) -> list[Answered]:
        return [case for case in cases if case.kind == kind]

    singles, pairs = of("single"), of("pair")
    hiding = [*singles, *pairs]
    claims = [case for case in cases if case.claims]
    held = [is_held for case in hiding for is_held in case.magnitudes()]
    return [
        ("single effects", "exact", _count(singles, lambda case: case.is_exact)),
        (
            "single effects that are declared", "exact",
            _count([case for case in singles if case.claims], lambda case: case.is_exact),
        ),
        ("pairs", "both named", _count(pairs, lambda case: case.claims and set(case.hidden) <= case.declared)),
        ("single effects and pairs", "hidden effects within the claim", _count(hiding, lambda case: case.is_within)),
        ("intact benches", "accused", _count(of("intact"), lambda case: case.claims)),
        ("mis-set parameters", "accused", _count(of("parameters"), lambda case: case.claims)),
        ("effects that no catalogue lists", "called unknown", _count(of("unknown"), lambda c: c.verdict == "unknown")),
        ("all claims", "exact", _count(claims, lambda case: case.is_exact)),
        ("all claims", "mean stated probability", _mean([case.probability for case in claims])),
        ("declared magnitudes with a plain true value", "true within 2 std", f"{sum(held)} of {len(held)}"),
        ("all cases", "without an answer", _count(cases, lambda case: case.verdict == _NO_ANSWER)),
    ]  # fmt: skip


def _count(cases: Sequence[Answered], is_so: Callable[[Answered], bool]) -> str:
    return f"{sum(is_so(case) for case in cases)} of {len(cases)}"


def _mean(values: Sequence[float]) -> str:
    return f"{sum(values) / len(values):.0%}" if values else "none"


def _case_line(case: Answered) -> str:
    hidden = ", ".join(f"{name} {size:g}" for name, size in case.hidden.items()) or "nothing"
    shows = "" if case.shows is None else f"{case.shows['channel']}, {case.shows['times_noise']:.1f} times its noise"
    most = ", ".join(f"{name} {probability:.1%}" for name, probability in case.ranked)
    return f"| {case.name} | {case.kind} | {hidden} | {shows} | {case.verdict} | {most} |"
