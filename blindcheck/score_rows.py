"""The rows of the score: shares of cases, each with its 95 % interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sawbench.blindcheck.claims import acts_in
from sawbench.blindcheck.effects.table import LOOKED_FOR_OUTSIDE
from sawbench.blindcheck.score_statistics import Proportion, wilson
from sawbench.blindcheck.scored_case import NO_GAP, PARAMETERS, UNKNOWN, Case

TYPICAL = (0.5, 2.0)
SMALL_SHIFT_SIGMAS = 3.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One line of the score.

    Attributes
    ----------
    key : str
    text : str
        What is counted over what.
    value : Proportion
    """

    key: str
    text: str
    value: Proportion


def is_typical(case: Case) -> bool:
    """Whether one effect of the catalogue, of typical severity, is hidden."""
    return case.kind == "effect" and TYPICAL[0] <= max(case.effects.values()) <= TYPICAL[1]


def is_exact(case: Case) -> bool:
    """Whether what was declared is the truth."""
    return case.answer == case.truth


def in_group(case: Case) -> bool:
    """Whether the declared effects, and those stated as indistinguishable, hold all true effects."""
    return bool(case.group) and case.truth <= case.group


def in_top_three(case: Case) -> bool:
    """Whether the truth is among the three most probable hypotheses, those without an effect included."""
    return case.truth in case.ranked(3)


def claims(case: Case) -> bool:
    """Whether an effect of the catalogue, or several, was declared."""
    return case.claims_effect


def one_named(case: Case) -> bool:
    """Whether one of the hidden effects was declared."""
    return case.claims_effect and bool(case.truth & case.answer)


def all_but(case: Case, n: int) -> bool:
    """Whether all hidden effects but at most `n` were declared, whatever else was."""
    return case.claims_effect and len(case.truth - case.answer) <= n


def is_placed(case: Case) -> bool:
    """Whether the largest share of the gap is said to lie where one of the hidden effects acts."""
    return acts_in(case.place, case.effects)


def agrees_with_itself(case: Case) -> bool:
    """Whether the size of what is claimed and what it closes tell one story."""
    return case.is_coherent is True


def is_called_unknown(case: Case) -> bool:
    """Whether the answer is "unknown"."""
    return case.answer == UNKNOWN


def is_acceptable(case: Case) -> bool:
    """Whether "parameters" was answered, or "no gap" where the constants are not far off."""
    is_small = case.largest_shift_sigmas is not None and case.largest_shift_sigmas <= SMALL_SHIFT_SIGMAS
    return case.answer == PARAMETERS or (is_small and case.answer == NO_GAP)


def _is_intact(case: Case) -> bool:
    return case.kind in {"none", "parameters"}


def _is_typical_pair(case: Case) -> bool:
    return case.kind == "pair" and min(case.effects.values()) >= TYPICAL[0]


def _is_several(case: Case) -> bool:
    return case.kind == "several"


Test = Callable[[Case], bool]
_DECLARED = "typical single effects where an effect is declared"
# What a row is called, what it says, the cases that it is counted over, and which of them are hits.
_ROWS: tuple[tuple[str, str, Test, Test], ...] = (
    ("exact", "exact effect, typical single effects", is_typical, is_exact),
    ("group", "within the named group, typical single effects", is_typical, in_group),
    ("top_three", "among the three most probable, typical single effects", is_typical, in_top_three),
    ("declared", "an effect is declared, typical single effects", is_typical, claims),
    (
        "declared_detectable",
        "an effect is declared, typical single effects above the detection limit that the report states",
        lambda c: is_typical(c) and c.is_detectable is True,
        claims,
    ),
    ("declared_exact", f"exact effect, {_DECLARED}", lambda c: is_typical(c) and claims(c), is_exact),
    ("declared_group", f"within the named group, {_DECLARED}", lambda c: is_typical(c) and claims(c), in_group),
    (
        "declared_top_three",
        f"among the three most probable, {_DECLARED}",
        lambda c: is_typical(c) and claims(c),
        in_top_three,
    ),
    ("claims_exact", "exactly right, of all claims of an effect", claims, is_exact),
    ("false_alarms", "false alarms: an effect is claimed, none or parameters only", _is_intact, claims),
    (
        "false_alarms_spoilt",
        "false alarms on benches with faulty sensors",
        lambda c: _is_intact(c) and c.has_faulty_sensors,
        claims,
    ),
    ("none", "called no gap, nothing hidden", lambda c: c.kind == "none", is_exact),
    ("parameters", "called parameters, constants beyond their uncertainty", lambda c: c.kind == "parameters", is_exact),
    (
        "parameters_lenient",
        "called parameters, or no gap where no constant is further off than "
        f"{SMALL_SHIFT_SIGMAS:g} standard deviations",
        lambda c: c.kind == "parameters",
        is_acceptable,
    ),
    ("unknown", "called unknown, effects outside the catalogue", lambda c: c.kind == "outside", is_exact),
    (
        "typical_unknown",
        "called unknown, effects outside the catalogue of typical severity or more",
        lambda c: c.kind == "outside" and max(c.effects.values()) >= TYPICAL[0],
        is_exact,
    ),
    (
        "unknown_formless",
        "called unknown, effects outside the catalogue that the diagnosis does not look for either",
        lambda c: c.kind == "outside" and not c.effects.keys() & LOOKED_FOR_OUTSIDE,
        is_exact,
    ),
    ("unknown_wrongly", "called unknown, all others", lambda c: c.kind != "outside", is_called_unknown),
    ("pair_both", "both effects named and no other, pairs", lambda c: c.kind == "pair", is_exact),
    ("pair_group", "both effects within the named group, pairs", lambda c: c.kind == "pair", in_group),
    ("pair_one", "at least one effect named, pairs", lambda c: c.kind == "pair", one_named),
    ("typical_pair_both", "both effects named and no other, pairs with both typical", _is_typical_pair, is_exact),
    (
        "detectable_pair_both",
        "both effects named and no other, pairs with both typical and above the detection limit that the report states",
        lambda c: _is_typical_pair(c) and c.is_detectable is True,
        is_exact,
    ),
    ("several_exact", "all effects named and no other, three or more hidden", _is_several, is_exact),
    ("several_all", "all effects named, three or more hidden", _is_several, lambda c: all_but(c, 0)),
    (
        "several_but_one",
        "all effects but at most one named, three or more hidden",
        _is_several,
        lambda c: all_but(c, 1),
    ),
    (
        "where",
        "largest share of `where` in an equation where a hidden effect acts, typical effects and pairs",
        lambda c: c.says_where and (is_typical(c) or _is_typical_pair(c)),
        is_placed,
    ),
    (
        "where_stated",
        "the same, of the reports that state a place: all but those that say there is no gap",
        lambda c: c.place is not None and (is_typical(c) or _is_typical_pair(c)),
        is_placed,
    ),
    (
        "coherent",
        "the claim agrees with itself: its magnitude and what it closes differ from 0, or single strokes carry it",
        lambda c: c.is_coherent is not None,
        agrees_with_itself,
    ),
)


def score_rows(cases: Sequence[Case]) -> tuple[Row, ...]:
    """Count every row; the text names the cases it is counted over."""
    found = []
    for key, text, is_counted, is_hit in _ROWS:
        chosen = [case for case in cases if is_counted(case)]
        found.append(Row(key=key, text=text, value=wilson(sum(map(is_hit, chosen)), len(chosen))))
    return tuple(found)
