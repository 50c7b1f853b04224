"""The trials that a diagnosis proposes next, as a table and in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.reporting.cause_words import name_of
from sawbench.reporting.quantities import format_to

# Key of a row -> head of its column.
PLAN_COLUMNS: Final = (
    ("id", "trial"), ("material", "material"), ("duty", "duty"), ("feed", "feed / mm/s"),
    ("thickness", "thickness / mm"), ("length", "length / s"), ("rest", "rest before / s"), ("between", "tells apart"),
    ("log_odds", "log odds"), ("probability", "probability of the right answer"),
)  # fmt: skip
_ANSWERS: Final = {"no_gap": "no gap", "parameters": "re-tuned parameters"}
_AND: Final = " + "
_BESIDE_THE_PLAN: Final = (
    "A plan counts only what tells hypotheses apart, with the duties, feeds and workpieces of this campaign;"
    " the next trial named above may add a setting that the campaign lacks, show more of an unexplained residual, or"
    " make the magnitude of a cause more precise."
)


def plan_rows(plan: Mapping[str, Any]) -> list[dict[str, str]]:
    """Rows of the proposed trials, in words.

    Parameters
    ----------
    plan : mapping
        `plan` of the report.

    Returns
    -------
    list of dict
        With the keys of `PLAN_COLUMNS`.
    """
    return [
        {
            "id": row["id"],
            "material": "in air" if row["material"] == "none" else row["material"],
            "duty": f"{row['duty']:.4g}",
            "feed": _number(row["feed_mm_s"]),
            "thickness": _number(row["thickness_mm"]),
            "length": _number(row["seconds"]),
            "rest": _number(row["rest_s"]),
            "between": " or ".join(map(_answer, row["between"])),
            "log_odds": format_to(row["log_odds"], 1),
            "probability": _percent(row["expected_probability"]),
        }
        for row in plan["trials"]
    ]


def plan_sentences(plan: Mapping[str, Any], next_trial: str = "none") -> list[str]:
    """State the expected benefit of the proposed trials, and which causes none of them tells apart.

    Parameters
    ----------
    plan : mapping
        `plan` of the report.
    next_trial : str
        Of the report, which names one for other reasons too.

    Examples
    --------
    >>> plan_sentences({"trials": [], "reason": "there is no displacement"})
    ['No trial is proposed: there is no displacement.']
    """
    rows, said = plan["trials"], []
    if not rows:
        said.append(f"No trial is proposed: {plan['reason']}.")
    else:
        minutes = sum(row["minutes"] for row in rows)
        now, then = _percent(plan["expected_probability"]), _percent(rows[-1]["expected_probability"])
        number = "this trial" if len(rows) == 1 else f"these {len(rows)} trials"
        said.append(
            f"With {number} ({minutes:.0f} minutes) the expected probability of the right answer, among the known"
            f" causes, changes from {now} to {then}."
        )
        if any(row["is_new"] for row in rows):
            said.append("Combinations of duty, feed and workpiece that were not yet run are predicted by the model.")
    if not next_trial.startswith("none"):
        said.append(_BESIDE_THE_PLAN)
    for pair in plan.get("inseparable", []):
        one, other = pair["causes"]
        said.append(
            f"No trial of this bench tells {_answer(one)} from {_answer(other)}: the best adds log odds of"
            f" {format_to(pair['log_odds'], 1)}.{_instead(one, other)}"
        )
    return said


def _instead(one: str, other: str) -> str:
    """What to measure at the machine, of the effects that two causes do not share."""
    ids = set(one.split(_AND)) ^ set(other.split(_AND))
    words = [e.words.measure for name in sorted(ids) if (e := EFFECT_BY_NAME.get(name)) and e.words]
    return f" Measure instead {'; or '.join(words)}." if words else ""


def _answer(name: str) -> str:
    return _ANSWERS.get(name, " and ".join(map(name_of, name.split(_AND))))


def _number(value: float | None) -> str:
    return "" if not value else f"{value:.4g}"


def _percent(share: float) -> str:
    return "over 99.9 %" if share > 0.9995 else f"{100 * share:.1f} %"
