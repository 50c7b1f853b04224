"""The page of the blind check: how well withheld effects were named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from sawbench.reporting.blind_figures import calibration_picture, confusion_picture, severity_picture, time_picture
from sawbench.reporting.html import render
from sawbench.storage.output import write_whole

_HEADLINES: Final = (
    ("declared_exact", "exact, of the declared effects"),
    ("declared_group", "within the stated group, of the declared effects"),
    ("declared", "declared, of typical single effects"),
    ("false_alarms", "false alarms"),
    ("unknown", "called unknown, outside the catalogue"),
    ("pair_both", "both named, of two effects"),
)
_SECTIONS: Final = (
    ("Single effects of typical severity", ("exact", "group", "top_three", "declared", "declared_detectable")),
    (
        "Cases in which an effect is declared",
        ("declared_exact", "declared_group", "declared_top_three", "claims_exact"),
    ),
    ("No hidden effect", ("false_alarms", "false_alarms_spoilt", "none", "parameters", "parameters_lenient")),
    ("Outside the catalogue", ("unknown", "typical_unknown", "unknown_formless", "unknown_wrongly")),
    ("Two effects", ("pair_both", "pair_group", "pair_one", "typical_pair_both", "detectable_pair_both")),
    ("Three or more effects", ("several_exact", "several_all", "several_but_one")),
    ("Other statements of the report", ("where", "where_stated", "coherent")),
)
# Columns of the table of kinds of benches.
_BY_SHIFT: Final = (
    ("declared", "declared"),
    ("declared_exact", "exact of these"),
    ("claims_exact", "exact, of all claims"),
    ("false_alarms", "false alarms"),
    ("unknown", "unknown"),
    ("typical_pair_both", "both of two"),
    ("where", "place right"),
    ("coherent", "consistent report"),
)


def write_blind_page(path: str | Path, record: Mapping[str, Any], *, overwrite: bool = False) -> Path:
    """Write the score of a blind check as a page.

    Parameters
    ----------
    path : str or Path
    record : mapping
        The score as plain values, with what it is a score of, as `sawbench blind score --json` prints it.
    overwrite : bool

    Raises
    ------
    InputError
        If the file exists and `overwrite` is not set, or cannot be written.
    """
    score = record["score"]
    rows = {row["key"]: row for row in score["rows"]}
    context = {
        "title": "Blind check of the diagnosis",
        "record": record,
        "score": score,
        "sentence": _sentence(record, rows),
        "headlines": [(label, share_words(rows[key]["value"])) for key, label in _HEADLINES],
        "sections": [
            (title, [(rows[key]["text"], share_words(rows[key]["value"])) for key in keys if key in rows])
            for title, keys in _SECTIONS
        ],
        "numbers": _numbers(score),
        "gap_rows": _gap_rows(score["gap"]),
        "parameter_rows": _parameter_rows(score["parameters"]),
        "shift_columns": [label for _, label in _BY_SHIFT],
        "shift_rows": _shift_rows(score["by_shift"]),
        "confusion": confusion_picture(
            score["confusion"],
            name="confusion",
            title="Answers by hidden effect",
            caption="Rows: hidden effect; columns: answer; shade: share of the row. Correct answers are blue. Effects "
            "outside the catalogue should be called unknown.",
        ),
        "families": confusion_picture(
            score["families"],
            name="families",
            title="Answers by part of the bench",
            caption="The same by the part of the bench in which the effect acts.",
        ),
        "calibration": calibration_picture(score["calibration"]),
        "severity": severity_picture(score["severity"]),
        "time": time_picture(score["times_s"]) if score["times_s"] else None,
        "outside": [(name.replace("_", " "), share_words(value)) for name, value in score["outside"].items()],
    }
    return write_whole(path, render("blind_page.html.j2", context), overwrite=overwrite)


def share_words(value: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return a share as "hits / n", per cent, and its interval.

    Examples
    --------
    >>> share_words({"hits": 8, "n": 10, "share": 0.8, "low": 0.4902, "high": 0.9433})
    ('8 / 10', '80.0 %', '49.0 to 94.3 %')
    """
    if value["share"] is None:
        return "0", "no case", ""
    interval = f"{100 * value['low']:.1f} to {100 * value['high']:.1f} %"
    return f"{value['hits']} / {value['n']}", f"{100 * value['share']:.1f} %", interval


def _sentence(record: Mapping[str, Any], rows: Mapping[str, Any]) -> str:
    declared, all_typical = rows["declared_exact"]["value"], rows["exact"]["value"]
    if all_typical["share"] is None:
        return "The set has no single effect of typical severity."
    n, hits = all_typical["n"], all_typical["hits"]
    said = f"Named exactly: {hits} of {n} hidden effects of typical severity."
    if declared["share"] is not None:
        said += f" Where an effect was declared, it was correct in {100 * declared['share']:.0f} %"
        said += f" ({100 * declared['low']:.0f} to {100 * declared['high']:.0f} %) of the cases."
    return said


def _numbers(score: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """Rows of the table of means: label, number of cases, value, interval."""
    calibration = score["calibration"]
    rows = [
        ("Brier score over all hypotheses (0 best, 2 worst)", score["brier"]),
        ("Log-loss / nats", score["log_loss"]),
        ("Calibration error (ECE)", calibration["error"]),
        ("Effects in the answered group", score["group_size"]),
    ]
    # Scores of earlier versions do not have it.
    if "calibration_of_claims" in score:
        rows.insert(3, ("Calibration error of claimed effects", score["calibration_of_claims"]["error"]))
    gap = score["gap"]
    if gap is not None:
        rows.append(("Gap closed: stated minus oracle", gap["error"]))
        rows.append(("Gap closed: distance from the oracle", gap["absolute_error"]))
        rows.append(("Gap closed: median stated over median of the oracle, correct claims", gap["share_of_oracle"]))
        rows.append(
            ("Gap closed: median stated over median of the closable gap, correct claims", gap["share_of_closable"])
        )
    rows.append(
        ("Parameter of the effect: median relative error, correct claims", score["parameters"]["relative_error"])
    )
    rows += [
        (f"Runtime: median relative error {model}, correct claims", score["runtime"][key])
        for key, model in (
            ("nominal", "of the model as configured"),
            ("retuned", "with parameters re-tuned"),
            ("with_effect", "with the claimed effect"),
        )
    ]
    said = [(label, str(value["n"]), *_value_words(value)) for label, value in rows]
    return [*said, ("Gap closed against the oracle", "", "not computed", "")] if gap is None else said


def _gap_rows(gap: Mapping[str, Any] | None) -> list[tuple[str, tuple[str, str, str]]]:
    if gap is None:
        return []
    return [
        ("Oracle inside the stated 95 % interval of the gap closed, all claims", share_words(gap["coverage"])),
        ("At least 90 % of the closable gap is closed, correct claims", share_words(gap["closes_enough"])),
    ]


def _parameter_rows(known: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table of parameters: name, cases, share, interval, and three medians; all effects first."""
    median = known["relative_error"]["value"]
    error = "" if median is None else _percent(median)
    rows: list[tuple[str, ...]] = [("all correct claims", *share_words(known["coverage"]), error, "", "")]
    for one in known["effects"]:
        name = f"{one['effect'].replace('_', ' ')}: {one['name']}"
        sizes = (_percent(one["relative_error"]["value"]), _percent(one["stated_rel_std"]), f"{one['ratio']:.3f}")
        rows.append((name, *share_words(one["coverage"]), *sizes))
    return rows


def _shift_rows(by_shift: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Rows of the table of kinds of benches: kind, cases, shares with their counts, calibration error."""
    found = []
    for one in by_shift:
        shares = {row["key"]: row["value"] for row in one["rows"]}
        cells = [_share_and_count(shares[key]) for key, _ in _BY_SHIFT]
        error = one["calibration_error"]
        found.append(
            (f"{one['shift']}: {one['value']}", str(one["n_cases"]), *cells, "" if error is None else f"{error:.3f}")
        )
    return found


def _share_and_count(value: Mapping[str, Any]) -> str:
    return "" if value["share"] is None else f"{100 * value['share']:.0f} % ({value['hits']}/{value['n']})"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _value_words(value: Mapping[str, Any]) -> tuple[str, str]:
    if value["value"] is None:
        return "no case", ""
    low, mean, high = (f"{round(value[key], 3) + 0.0:.3f}".replace("-", "−") for key in ("low", "value", "high"))
    return mean, f"{low} to {high}"
