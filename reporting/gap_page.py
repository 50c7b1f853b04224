"""The page of the sim-to-real gap: `gap_report.json`, readable in a minute."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from sawbench.bench.second_core import on_two_cores
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.reporting.cause_words import (
    equations_of,
    improved_command,
    in_words_of,
    interval_words,
    is_undetermined,
    limit_words,
    magnitude_words,
    name_of,
    strength_words,
    what_happens,
    what_to_do,
    withheld_words,
)
from sawbench.reporting.closing import closing_picture, closing_rows, closing_sentences
from sawbench.reporting.gap_figures import (
    CHANNEL_WORDS,
    EQUATION_WORDS,
    alike_rows,
    in_channel_words,
    ladder_picture,
    map_picture,
    point_words,
    strokes_picture,
)
from sawbench.reporting.html import render, software_version
from sawbench.reporting.learned_figure import learned_picture, learned_sentences
from sawbench.reporting.quantities import format_duration, format_number, format_quantity, format_share, format_to
from sawbench.reporting.standing_out_figure import standing_out_picture, standing_out_sentence, stands_out
from sawbench.reporting.trial_plan import PLAN_COLUMNS, plan_rows, plan_sentences
from sawbench.storage.output import write_whole

_SURE: Final = 0.8
_MOST_ALIKE: Final = 5
# Stated standard uncertainties from which a re-tuned parameter is named.
_LARGE_SHIFT: Final = 2.0
# Of the error as configured: re-tuning that leaves less of it would pass for a cure.
_HIDES: Final = 0.9
_ALIKE_ODDS: Final = f"{SETTINGS.report.odds:g}"
_RAD_TO_DEG: Final = 57.29577951308232
_PLACES: Final = {
    "electrical": "on the motor's electrical side",
    "mechanical": "on the mechanical side of motor and drive",
    "cutting": "where the blade cuts",
    "supply": "in battery and converter",
    "sensing": "in the sensors",
}
_OF_PLACE: Final = {"supply": ("supply", "converter"), "sensing": ("cutting", "electrical")}


def write_gap_page(path: str | Path, report: Mapping[str, Any], *, overwrite: bool = False) -> Path:
    """Write the gap report as a page.

    Parameters
    ----------
    path : str or Path
    report : mapping
        The content of `gap_report.json`; without its "detail" the page has neither strokes nor map.
    overwrite : bool

    Raises
    ------
    InputError
        If the file exists and `overwrite` is not set.
    """
    detail = report.get("detail", {})
    contradicted = _contradiction(report)
    after, after_words = (
        ("with_effect", "model with the cause") if _has_cause(report) else ("retuned", "model, re-tuned")
    )
    context = {
        **_pictures(report, detail, after, after_words),
        "title": "Sim-to-real gap",
        "is_simulated": report["provenance"].get("is_simulated", False),
        "heading": _heading(report),
        "sentence": verdict_sentence(report),
        "level": "bad" if contradicted else {"no_gap": "good", "unknown": "bad"}.get(report["verdict"], "warn"),
        "meaning": _meaning(report),
        "to_do": _to_do(report),
        "tiles": _tiles(report),
        "gap_rungs": rungs_of(report["verdict"]),
        "closing_rows": closing_rows(report["until_closed"]) if "until_closed" in report else [],
        "closing_sentences": closing_sentences(report["until_closed"]) if "until_closed" in report else [],
        "plan_columns": PLAN_COLUMNS,
        "plan_rows": plan_rows(report["plan"]) if "plan" in report else [],
        "plan_sentences": plan_sentences(report["plan"], report["next_trial"]) if "plan" in report else [],
        "where": [_spot(spot, detail.get("standing_out")) for spot in report["where"]],
        "standing_out_words": _standing_out_words(report, detail),
        "causes": [_cause(report, number) for number in range(len(report["causes"]))],
        "others": [
            (words, format_share(report["probabilities"][name]))
            for name, words in (
                ("no_gap", "no gap"),
                ("parameters", "re-tuned parameters alone"),
                ("unknown", "cause outside the catalogue"),
            )
        ],
        "wide": f"{SETTINGS.noise.wide:g}",
        "shifts": [_shift_row(name, p) for name, p in report["parameter_shifts"].items()],
        "ladder_rows": _ladder_rows(report),
        "log_evidence": [
            (name_of(n), format_to(value, 1), format_share(detail.get("probabilities", {}).get(n, 0.0)))
            for n, value in detail.get("log_evidence", {}).items()
        ],
        "limits": [(name_of(effect), limit_words(one)) for effect, one in detail.get("detection_limits", {}).items()],
        "limit_log_odds": format_to(detail.get("detection_limit_log_odds", 0.0), 1),
        "alike_odds": _ALIKE_ODDS,
        "alike": alike_rows(detail["alike"]) if detail.get("alike") else [],
        "signals": [(CHANNEL_WORDS.get(s["channel"], s["channel"]), s["words"]) for s in report.get("signals", [])],
        "warnings": notes_of(report),
        "report": report,
        "version": software_version(),
    }
    return write_whole(path, in_words_of(report, render("gap_page.html.j2", context)), overwrite=overwrite)


def _pictures(report: Mapping[str, Any], detail: Mapping[str, Any], after: str, after_words: str) -> dict[str, Any]:
    """Draw what there is to draw; None for a picture that the report has nothing for."""
    # In an order that shares them evenly: both processes draw an easy one and one of many cells.
    drawn: dict[str, Callable[[], Any]] = {
        "ladder": lambda: ladder_picture(report["gap"]["by_channel"], rungs_of(report["verdict"]))
    }
    if detail.get("map") and report["where"]:
        drawn["map"] = lambda: map_picture(detail["map"], _equations(report, detail))
    if detail.get("strokes"):
        drawn["strokes"] = lambda: strokes_picture(detail["strokes"], after, after_words)
    if detail.get("standing_out"):
        drawn["standing_out"] = lambda: standing_out_picture(detail["standing_out"])
    if "until_closed" in report:
        drawn["closing"] = lambda: closing_picture(report["until_closed"])
    if report.get("learned_term"):
        drawn["learned"] = lambda: learned_picture(report["learned_term"])
    nothing = dict.fromkeys(("ladder", "strokes", "map", "standing_out", "closing", "learned"))
    return nothing | dict(zip(drawn, on_two_cores(lambda draw: draw(), list(drawn.values())), strict=True))


def verdict_sentence(report: Mapping[str, Any]) -> str:
    """The verdict in a sentence.

    Examples
    --------
    >>> report = {"verdict": "no_gap", "causes": [], "probabilities": {"no_gap": 0.9}, "parameter_shifts": {}}
    >>> verdict_sentence(report)
    'No gap: the model explains the measurements within their noise and its own uncertainty (90 %).'
    """
    contradicted = _contradiction(report)
    if contradicted:
        return f"No answer: {contradicted}."
    verdict, probability = report["verdict"], report["probabilities"]
    if verdict == "no_gap":
        subject = "with re-tuned parameters the model" if _shifted(report) else "the model"
        share = format_share(probability["no_gap"])
        return f"No gap: {subject} explains the measurements within their noise and its own uncertainty ({share})."
    if verdict == "parameters":
        return (
            "The model form is right, but some parameters differ from their stated values by more than their"
            " uncertainty"
            f" ({format_share(probability['parameters'])})."
        )
    if verdict == "unknown":
        return f"There is a gap, and no known cause explains it ({format_share(probability['unknown'])})."
    cause = report["causes"][0]
    names = f"{' and '.join(name_of(name) for name in cause['effects'])} ({format_share(cause['probability'])})"
    start = "Most probable cause" if cause["probability"] >= _SURE else "Most probable cause, not certain"
    magnitudes = [magnitude_words(name, p) for name, p in cause["parameters"].items()] + cause.get("form", [])
    return in_words_of(
        report, f"{start}: {', '.join([names, *magnitudes])}. {_explained(cause, withheld_words(report))}"
    )


def _contradiction(report: Mapping[str, Any]) -> str:
    """Why recordings and configuration cannot be of the same machine; empty where they can."""
    return report.get("detail", {}).get("contradiction", "")


def _has_cause(report: Mapping[str, Any]) -> bool:
    return report["verdict"] in {"effect", "effects"}


def _heading(report: Mapping[str, Any]) -> str:
    fixed = {
        "no_gap": "No gap",
        "parameters": "Parameters outside their stated uncertainty",
        "unknown": "Gap of unknown cause",
    }
    if _contradiction(report):
        return "Recordings and configuration do not fit together"
    if report["verdict"] in fixed:
        return fixed[report["verdict"]]
    return "Gap: " + " and ".join(name_of(name) for name in report["causes"][0]["effects"])


def closest_description(report: Mapping[str, Any]) -> list[str]:
    """Say what a gap of unknown cause looks most like: one sentence, or none.

    Parameters
    ----------
    report : mapping
        `gap_report.json`.
    """
    resembles = in_channel_words(resembled(report))
    return [f"Closest description: {resembles}."] if resembles else []


def notes_of(report: Mapping[str, Any]) -> list[str]:
    """Limits of an answer, less what its verdict says already, with channels by their plain names.

    Parameters
    ----------
    report : mapping
        `gap_report.json`.
    """
    said = (resembled(report), _contradiction(report))
    return [in_channel_words(text) for text in report["warnings"] if text not in said]


def known_effects(report: Mapping[str, Any]) -> list[str]:
    """Say which effects the model as configured has: one sentence, or none.

    Parameters
    ----------
    report : mapping
        `gap_report.json`.
    """
    found = report.get("detail", {}).get("known_effects", {})
    known = [magnitude_words(name, one) for name, one in found.items()]
    return [f"In the model as configured: {'; '.join(known)}."] if known else []


def resembled(report: Mapping[str, Any]) -> str:
    """Name what a gap of unknown cause looks most like; empty for another verdict, or a gap of no particular form.

    Parameters
    ----------
    report : mapping
        `gap_report.json`.
    """
    return report["detail"].get("resembles", "") if report["verdict"] == "unknown" else ""


def _meaning(report: Mapping[str, Any]) -> list[str]:
    verdict, shifted, said = report["verdict"], _shifted(report), []
    if _contradiction(report):
        return ["Probabilities and magnitudes below rest on channels or numbers that cannot be right."]
    if verdict in ("no_gap", "parameters"):
        if verdict == "no_gap":
            of = "model" if shifted else "model and its parameters"
            said.append(f"No unmodelled effect: the residual is within noise and the stated uncertainty of the {of}.")
        said += [f"Largest shifts: {shifted}."] if shifted else []
    elif verdict == "unknown":
        said += closest_description(report)
        said += [_place_sentence(spot) for spot in _of_the_strokes(report)[:2]]
        said += learned_sentences(report["learned_term"]) if report.get("learned_term") else []
        if report["gap"]["retuned"] < _HIDES * report["gap"]["nominal"]:
            said.append("Re-tuning the parameters would hide the gap, not explain it.")
    else:
        cause = report["causes"][0]
        said += [f"{words[0].upper()}{words[1:]}." for words in map(what_happens, cause["effects"])]
        if cause["indistinguishable_from"]:
            names = ", ".join(name_of(n) for n in cause["indistinguishable_from"])
            said.append(f"In this campaign it is indistinguishable from: {names} (same evidence within its scatter).")
        said += _where_it_acts(report, cause)
    return [*said, *_runtime_sentence(report), *known_effects(report)]


def _where_it_acts(report: Mapping[str, Any], cause: Mapping[str, Any]) -> list[str]:
    """The place at which the cause acts, and the largest one where that is another."""
    spots, acts_in = _of_the_strokes(report), equations_of(cause["effects"])
    own = next((spot for spot in spots if spot["equation"] in acts_in), None)
    if own is None or own is spots[0]:
        return [_place_sentence(spot) for spot in spots[:1]]
    return [
        f"{_place_sentence(own)} This is where the cause acts.",
        f"{_place_sentence(spots[0])} This is a consequence of the cause.",
    ]


def _explained(cause: Mapping[str, Any], withheld: str) -> str:
    ends = cause["gap_closed_ci95"]
    if is_undetermined(ends) and cause["gap_closed"] == 0.0:
        return "With re-tuned parameters the remaining error is too small to tell how much of it the cause explains."
    closed = f"Adding it explains {round(100 * cause['gap_closed'])} %"
    if is_undetermined(ends):
        return (
            f"{closed} of the remaining error where it acts; its 95 % interval is not determined: that error is"
            " too near to the noise, or too few trials could be withheld."
        )
    return f"{closed} ({interval_words(ends)}) of the remaining error where it acts, {withheld}."


def _runtime_sentence(report: Mapping[str, Any]) -> list[str]:
    runtime = report["gap"].get("runtime_s")
    if not runtime:
        return []
    where = report.get("detail", {}).get("runtime_of", "")
    key, words = ("with_effect", "with the cause") if _has_cause(report) else ("retuned", "re-tuned")
    after = f", {words} {format_duration(runtime[key])}" if key in runtime else ""
    return [
        f"Runtime of a full battery: measured {format_duration(runtime['measured'])}; model as configured"
        f" {format_duration(runtime['nominal'])}{after}{f' ({point_words(where)})' if where else ''}."
    ]


def _of_the_strokes(report: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Places without the lines that are asynchronous with the stroke."""
    return [spot for spot in report["where"] if not _is_line(spot)]


def _is_line(spot: Mapping[str, Any]) -> bool:
    """A line that does not follow the stroke has no crank angle."""
    return bool(spot["frequency_hz"]) and not spot["crank_angle_rad"]


def _place_sentence(spot: Mapping[str, Any]) -> str:
    place = _PLACES.get(spot["equation"], f"in the {spot['equation']} equation")
    grows = f"; it grows with {' and '.join(spot['grows_with'])}" if spot["grows_with"] else ""
    share = format_share(spot["share"])
    return f"{share[0].upper()}{share[1:]} of the gap lies {place}, {_angles(spot['crank_angle_rad'])}{grows}."


def _angles(ranges: Sequence[Sequence[float]]) -> str:
    if not ranges or (len(ranges) == 1 and ranges[0][1] - ranges[0][0] > 6.2):
        return "at all crank angles"
    return "at crank angles " + ", ".join(f"{a * _RAD_TO_DEG:.0f} to {b * _RAD_TO_DEG:.0f}°" for a, b in ranges)


def _shifted(report: Mapping[str, Any]) -> str:
    shifts = sorted(report["parameter_shifts"].items(), key=lambda item: -abs(item[1]["sigmas"]))[:3]
    return "; ".join(
        f"{name}, {format_number(p['nominal'])} stated, {format_quantity(p['value'], p['std'])} found"
        f" ({format_to(abs(p['sigmas']), 1)} times its uncertainty)"
        for name, p in shifts
        if abs(p["sigmas"]) > _LARGE_SHIFT
    )


def _to_do(report: Mapping[str, Any]) -> list[str]:
    verdict, start = report["verdict"], "Until then use the improved model in the folder of this page"
    steps = []
    if _contradiction(report):
        steps.append("Correct channels, units or configuration and diagnose again.")
    elif verdict == "no_gap" and _shifted(report):
        steps.append("Check the stated values of the shifted parameters.")
    elif verdict == "no_gap":
        steps.append("Use the model as it is.")
        start = "Optional: the same model with parameters re-tuned within their uncertainty, in the folder of this page"
    elif verdict == "parameters":
        steps.append("Check the re-tuned parameters (table below) on a new trial.")
    elif verdict == "unknown":
        lines = [_spot_angles(spot) for spot in report["where"] if _is_line(spot)]
        steps += [f"Look for a part that rotates, slips or switches {line}." for line in lines]
        if _of_the_strokes(report):
            steps.append("See the map below for the crank angles and operating points at which the gap appears.")
    else:
        steps += [
            f"{words[0].upper()}{words[1:]}." for words in map(what_to_do, report["causes"][0]["effects"]) if words
        ]
    if report.get("improved_model"):
        steps.append(
            f"{start}, for example `{improved_command(report, 'improved_model.toml')}`; every command for this machine"
            " accepts it."
        )
    return [*steps, f"Next trial: {report['next_trial']}."]


def _tiles(report: Mapping[str, Any]) -> list[dict[str, str]]:
    """Headline numbers: what re-tuning alone does, and what the cause adds to it."""
    rungs = [(key, words) for key, words in rungs_of(report["verdict"]) if key in ("nominal", "retuned", "with_effect")]
    if not _has_cause(report):
        rungs = rungs[:2]
    steps = " → ".join(words for _, words in rungs)
    tiles = []
    by_channel = report["gap"]["by_channel"]
    for name in [n for n in ("force_n", "motor_current_a") if n in by_channel] or list(by_channel)[:1]:
        row = by_channel[name]
        tiles.append(
            {
                "label": f"RMSE of the simulated {CHANNEL_WORDS.get(name, name)}",
                "value": " → ".join(format_number(row[key], digits=2) for key, _ in rungs) + f" {row['unit']}",
                "detail": f"{steps}; noise {format_number(row['noise_floor'], digits=2)} {row['unit']}",
            }
        )
    runtime = report["gap"].get("runtime_s")
    if runtime:
        said = [f"{words} {format_duration(runtime[key])}" for key, words in rungs if key in runtime]
        tiles.append(
            {
                "label": "Runtime of a full battery",
                "value": f"{format_duration(runtime['measured'])}",
                "detail": f"measured; model {', '.join(said)}",
            }
        )
    return tiles


def _shift_row(name: str, p: Mapping[str, Any]) -> tuple[str, str, str, str]:
    sigmas = round(p["sigmas"], 1) or 0.0
    shift = ("+" if sigmas > 0.0 else "") + format_to(sigmas, 1)
    return name, format_number(p["nominal"]), format_quantity(p["value"], p["std"]), shift


def _ladder_rows(report: Mapping[str, Any]) -> list[tuple[str, list[str], str]]:
    """The gap rung by rung: all equations in units of the noise, then channel by channel."""
    gap, keys = report["gap"], [key for key, _ in rungs_of(report["verdict"])]
    rows = [("all equations", gap, "noise")]
    rows += [(str(CHANNEL_WORDS.get(name, name)), row, row["unit"]) for name, row in gap["by_channel"].items()]
    return [(name, [format_number(row[key], digits=3) for key in keys], unit) for name, row, unit in rows]


def rungs_of(verdict: str) -> list[tuple[str, str]]:
    """Models of the ladder that a verdict has, with their names on the page."""
    cause = {"effect": "with the cause", "effects": "with the causes", "unknown": "with the best known cause"}
    middle = [("with_effect", cause[verdict])] if verdict in cause else []
    return [("nominal", "as configured"), ("retuned", "re-tuned"), *middle, ("noise_floor", "noise")]


def _equations(report: Mapping[str, Any], detail: Mapping[str, Any]) -> list[str]:
    """Equations of the map, those of the report's places first."""
    order = [e for spot in report["where"] for e in _OF_PLACE.get(spot["equation"], (spot["equation"],))]
    return list(dict.fromkeys([*order, *detail["map"]["equations"]]))


def _standing_out_words(report: Mapping[str, Any], detail: Mapping[str, Any]) -> str:
    """One sentence on the significant regions; where a cause was named without any, why that is no contradiction."""
    found = detail.get("standing_out")
    if not found:
        return ""
    said = standing_out_sentence(found)
    if found["n_found"] == 0 and _has_cause(report):
        said += " The cause was identified from its pattern over all regions together."
    return said


def _spot(spot: Mapping[str, Any], found: Mapping[str, Any] | None) -> dict[str, Any]:
    return {
        "is_quiet": not _is_line(spot) and found is not None and not stands_out(spot, found),
        "equation": EQUATION_WORDS.get(spot["equation"], spot["equation"]),
        "channel": CHANNEL_WORDS.get(spot["channel"], spot["channel"]),
        "share": "asynchronous" if _is_line(spot) else format_share(spot["share"]),
        "angles": _spot_angles(spot),
        "grows_with": ", ".join(spot["grows_with"]) or "none found",
    }


def _spot_angles(spot: Mapping[str, Any]) -> str:
    if not _is_line(spot):
        return _angles(spot["crank_angle_rad"]).removeprefix("at crank angles ")
    lines = spot["frequency_hz"]
    return (
        f"at {format_number(lines[0])} Hz"
        if len(lines) == 1
        else f"at {format_number(lines[0])} to {format_number(lines[-1])} Hz, with the stroke rate"
    )


def _cause(report: Mapping[str, Any], number: int) -> dict[str, Any]:
    cause, limits = report["causes"][number], report.get("detail", {}).get("detection_limits", {})
    is_named = number == 0 and _has_cause(report)
    alike = [name_of(name) for name in cause["indistinguishable_from"]]
    n_shown = _MOST_ALIKE if len(alike) > _MOST_ALIKE + 1 else len(alike)
    return {
        "name": " and ".join(name_of(name) for name in cause["effects"]),
        "words": ", and ".join(what_happens(name) for name in cause["effects"]),
        "probability": format_share(cause["probability"]),
        "closed": f"{round(100 * cause['gap_closed'])} %".replace("-", "\N{MINUS SIGN}"),
        "interval": interval_words(cause["gap_closed_ci95"]).replace("-", "\N{MINUS SIGN}"),
        "strengths": strength_words(cause, limits, is_named=is_named) + cause.get("form", []),
        "alike": ", ".join(alike[:n_shown]) or "none",
        "more_alike": alike[n_shown:],
    }
