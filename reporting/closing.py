"""The causes found one after the other, from the model as configured down to the noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from sawbench.reporting.cause_words import interval_words, is_undetermined, magnitude_words, name_of
from sawbench.reporting.figures import INK, QUIET, WIDTH_IN, figure_style
from sawbench.reporting.html import Picture, figure_to_svg
from sawbench.reporting.quantities import format_share

MODELS: Final = (("nominal", "as configured"), ("retuned", "re-tuned"))
_CAUSE_COLOUR: Final = "#00507f"
_STOPPED: Final = {
    "no_gap": "With these causes in the model, no gap remains.",
    "parameters": "With these causes in the model, re-tuned parameters explain the remaining gap.",
    "unknown": "With these causes in the model, no effect of the catalogue explains the remaining gap.",
    "nothing_more": "No further cause reduces the error at withheld operating points.",
    "repeatability": "The remaining gap is within the repeatability of the measurements.",
    "passes": "Stopped at the maximum number of passes; there may be further causes.",
}
_STOPPED_WITHOUT: Final = {
    "no_gap": "There is no gap to close.",
    "parameters": "Re-tuned parameters explain the gap; no cause is needed.",
    "unknown": "No cause of the catalogue, nor several together, explain the gap.",
    "nothing_more": "No cause reduces the error at withheld operating points.",
}


def closing_sentences(closing: Mapping[str, Any]) -> list[str]:
    """State why no further cause was added, and which ones were dropped as redundant.

    Parameters
    ----------
    closing : mapping
        `until_closed` of the report.

    Examples
    --------
    >>> closing_sentences({"stopped": "no_gap", "rungs": [{}], "dropped": ["edge_force"]})
    ['With these causes in the model, no gap remains.', 'Redundant and dropped: edge force.']
    """
    words = _STOPPED if closing["rungs"] else _STOPPED_WITHOUT
    said = [words.get(closing["stopped"], _STOPPED[closing["stopped"]])]
    if closing["dropped"]:
        said.append(f"Redundant and dropped: {', '.join(map(name_of, closing['dropped']))}.")
    return said


def closing_rows(closing: Mapping[str, Any]) -> list[dict[str, str]]:
    """Rows of the ladder from the model as configured to the noise, in words.

    Parameters
    ----------
    closing : mapping
        `until_closed` of the report.

    Returns
    -------
    list of dict
        "model", "probability", "magnitude", "rms" (residual over noise), "closed", "interval" (so far), "added".
    """
    empty = dict.fromkeys(("probability", "magnitude", "closed", "interval", "added"), "")
    rows = [{"model": words, **empty, "rms": f"{closing[key]:.3g}"} for key, words in MODELS]
    for rung in closing["rungs"]:
        rows.append(
            {
                "model": f"+ {name_of(rung['effect'])}",
                "probability": format_share(rung["probability"]),
                "magnitude": _magnitude(rung),
                "rms": f"{rung['with_effect']:.3g}",
                "closed": f"{round(100 * rung['gap_closed'])} %",
                "interval": interval_words(rung["gap_closed_ci95"]),
                "added": "seen in single strokes" if rung["carried_by_strokes"] else f"{round(100 * rung['added'])} %",
            }
        )
    return [*rows, {"model": "noise", **empty, "rms": f"{closing['noise_floor']:.3g}"}]


def _magnitude(rung: Mapping[str, Any]) -> str:
    return ", ".join(magnitude_words(name, one) for name, one in rung["parameters"].items())


def closing_picture(closing: Mapping[str, Any]) -> Picture | None:
    """Draw the residual at withheld operating points, cause by cause, down to the noise.

    Parameters
    ----------
    closing : mapping
        `until_closed` of the report.

    Returns
    -------
    Picture or None
        None where there is no cause.
    """
    if not closing["rungs"]:
        return None
    from matplotlib.figure import Figure

    rungs, floor = closing["rungs"], closing["noise_floor"]
    values = [closing["nominal"], closing["retuned"], *(rung["with_effect"] for rung in rungs)]
    labels = [*(words for _, words in MODELS), *(_label(rung) for rung in rungs)]
    notes = ["", "", *(_note(rung) for rung in rungs)]
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 0.9 + 0.42 * len(values)), layout="constrained")
        axes = figure.subplots()
        axes.set_xscale("log")
        axes.step(values, range(len(values)), where="post", color=QUIET, linewidth=0.8)
        for place, (value, note) in enumerate(zip(values, notes, strict=True)):
            is_cause = place >= len(MODELS)
            axes.plot(value, place, "o", color=_CAUSE_COLOUR if is_cause else QUIET, markersize=7)
            low, high = _rms_interval(closing, rungs[place - len(MODELS)]) if is_cause else (value, value)
            axes.plot([low, high], [place, place], color=_CAUSE_COLOUR, linewidth=1.6, solid_capstyle="butt")
            text = f"{value:.3g}, {note}" if note else f"{value:.3g}"
            axes.annotate(
                text, (max(high, value), place), (9, 0), textcoords="offset points", va="center", fontsize=8.5
            )
        axes.axvline(floor, color=INK, linestyle=(0, (4, 2)), linewidth=1.0)
        axes.annotate(
            f"noise {floor:.3g}", (floor, -0.5), (4, 0), textcoords="offset points", va="center", fontsize=8.5,
            color=QUIET,
        )  # fmt: skip
        axes.set_xlim(0.8 * min(floor, *values), 6.0 * max(values))
        axes.set_ylim(len(values) - 0.4, -0.6)
        axes.set_yticks(range(len(values)), labels)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("RMS residual at withheld operating points / noise")
        described = "; ".join(f"{label}: {value:.3g}" for label, value in zip(labels, values, strict=True))
        svg = figure_to_svg(
            figure, name="causes", title="Causes, added one by one", description=f"{described}; noise: {floor:.3g}."
        )
    return Picture(
        svg=svg,
        caption="RMS residual at withheld operating points, logarithmic scale: model as configured, re-tuned, and with"
        " one more cause per line. Percentages: share of the gap closed by all causes so far; lines: 95 % interval.",
    )


def _label(rung: Mapping[str, Any]) -> str:
    return f"+ {name_of(rung['effect'])}"


def _note(rung: Mapping[str, Any]) -> str:
    strokes = "; seen in single strokes" if rung["carried_by_strokes"] else ""
    return f"{round(100 * rung['gap_closed'])} % closed{strokes}"


def _rms_interval(closing: Mapping[str, Any], rung: Mapping[str, Any]) -> tuple[float, float]:
    """Root mean square at the ends of the interval of what is closed so far; of its value where there is none."""
    if is_undetermined(rung["gap_closed_ci95"]):
        return rung["with_effect"], rung["with_effect"]
    floor, room = closing["noise_floor"] ** 2, closing["retuned"] ** 2 - closing["noise_floor"] ** 2
    low, high = ((floor + (1.0 - share) * max(room, 0.0)) ** 0.5 for share in reversed(rung["gap_closed_ci95"]))
    return low, high
