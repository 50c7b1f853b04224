"""The page of the sim-to-real gap: `gap_report.json`, readable in a minute."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from reporting.figures import figure_style
from reporting.html import Picture, figure_to_svg, render, software_version, write_page

_RUNGS = (
    ("nominal", "nominal parameters"),
    ("retuned", "re-tuned parameters"),
    ("with_effect", "with the cause"),
    ("noise_floor", "noise"),
)


def write_gap_page(path: str | Path, report: Mapping[str, Any], *, overwrite: bool = False) -> Path:
    """Write the gap report as a page.

    Parameters
    ----------
    path : str or Path
    report : mapping
        The content of `gap_report.json`.
    overwrite : bool

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the file exists and `overwrite` is not set.
    """
    context = {
        "title": "Sim-to-real gap",
        "sentence": verdict_sentence(report),
        "report": report,
        "ladder": _ladder(report),
        "version": software_version(),
    }
    return write_page(path, render("gap_page.html.j2", context), overwrite=overwrite)


def verdict_sentence(report: Mapping[str, Any]) -> str:
    """The verdict in a sentence.

    Examples
    --------
    >>> verdict_sentence({"verdict": "no_gap", "causes": [], "probabilities": {"no_gap": 0.9}})
    'The model explains the measurement: no gap beyond noise and the stated uncertainty of its parameters (90 %).'
    """
    verdict, probability = report["verdict"], report["probabilities"]
    if verdict == "no_gap":
        return (
            "The model explains the measurement: no gap beyond noise and the stated uncertainty of its parameters"
            f" ({100 * probability['no_gap']:.0f} %)."
        )
    if verdict == "parameters":
        return (
            "The model's form is right, but its parameters are off by more than their stated uncertainty"
            f" ({100 * probability['parameters']:.0f} %)."
        )
    if verdict == "unknown":
        return (
            "There is a gap that nothing in the catalogue explains"
            f" ({100 * probability['unknown']:.0f} %); where it lies is shown below."
        )
    cause = report["causes"][0]
    names = " and ".join(name.replace("_", " ") for name in cause["effects"])
    return (
        f"The gap is caused by {names} ({100 * cause['probability']:.0f} %); adding it closes"
        f" {100 * cause['gap_closed']:.0f} % of the gap that re-tuned parameters leave on held-out operating points."
    )


def _ladder(report: Mapping[str, Any]) -> Picture:
    from matplotlib.figure import Figure

    gap = report["gap"]
    values = [gap[key] for key, _ in _RUNGS]
    with figure_style():
        figure = Figure(figsize=(8.0, 2.2), layout="constrained")
        axes = figure.add_subplot()
        bars = axes.barh(
            [label for _, label in _RUNGS], values, color=["#6b7280", "#0072b2", "#009e73", "#d1d5db"]
        )
        axes.bar_label(bars, [f"{value:.3g}" for value in values], padding=4)
        axes.invert_yaxis()
        axes.set_xscale("log")
        axes.set_xlim(right=3.0 * max(*values, 1e-3))
        axes.set_xlabel("residual over noise, rms")
        description = ", ".join(
            f"{label} {value:.3g}" for (_, label), value in zip(_RUNGS, values, strict=True)
        )
        svg = figure_to_svg(figure, name="ladder", title="Gap ladder", description=description)
    return Picture(svg=svg, caption="Held-out residual on the four rungs; logarithmic scale.")
