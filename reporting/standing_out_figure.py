"""Significant regions of the gap, for the gap page: a sentence, and a figure in which the others are grey."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from sawbench.reporting.figures import QUIET, WIDTH_IN, figure_style
from sawbench.reporting.gap_figures import EQUATION_WORDS, point_words
from sawbench.reporting.html import Picture, figure_to_svg
from sawbench.reporting.quantities import format_number
from sawbench.reporting.spots import Spot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_GREY: Final = "#d3d7da"
_PANELS: Final = {
    "crank_angle": "crank angle / °",
    "harmonic": "harmonic of the stroke, from",
    "time": "part of the trial / %",
    "start_up": "time after the first motion / ms",
    "operating_point": "operating point",
}
_LEVELS: Final = (1, 3, 10, 30, 100, 300, 1000)


def standing_out_sentence(found: Mapping[str, Any]) -> str:
    """How many regions are significant, and in which equations.

    Parameters
    ----------
    found : mapping
        `detail.standing_out` of the report.

    Examples
    --------
    >>> standing_out_sentence({"n_cells": 262, "n_found": 0, "false_discovery_rate": 0.05, "found_in": []})
    'No region is significant: 0 of 262, false discovery rate 5 %.'
    """
    rate = f"false discovery rate {100 * found['false_discovery_rate']:.0f} %"
    if not found["n_found"]:
        return f"No region is significant: 0 of {found['n_cells']}, {rate}."
    places = [str(entry["equation"]) for entry in found["found_in"]]
    names = ", ".join(dict.fromkeys(EQUATION_WORDS.get(place, place) for place in places))
    are = "region is" if found["n_found"] == 1 else "regions are"
    return f"{found['n_found']} of {found['n_cells']} {are} significant, {rate}: {names}."


def stands_out(spot: Mapping[str, Any], found: Mapping[str, Any]) -> bool:
    """Whether the equation of an entry of `where` has a significant region; a sensor's error goes by its channel."""
    return any(
        entry["channel"] == spot["channel"] and spot["equation"] in ("sensing", entry["equation"])
        for entry in found["found_in"]
    )


def standing_out_picture(found: Mapping[str, Any]) -> Picture | None:
    """Draw every region, in colour where it is significant.

    Parameters
    ----------
    found : mapping
        `detail.standing_out` of the report.

    Returns
    -------
    Picture or None
        None where there is no region.
    """
    partitions = {name: found["partitions"][name] for name in _PANELS if name in found["partitions"]}
    if not partitions:
        return None
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import BoundaryNorm
    from matplotlib.figure import Figure

    norm = BoundaryNorm(_LEVELS, 256, clip=True)
    with figure_style():
        mosaic: list[Any] = [[name, name] for name in partitions]
        if "harmonic" in partitions and "time" in partitions:
            place = list(partitions).index("harmonic")
            mosaic[place : place + 2] = [["harmonic", "time"]]
        heights = [_n_rows(row[0], partitions[row[0]]) for row in mosaic]
        figure = Figure(figsize=(WIDTH_IN, 0.75 * len(mosaic) + 0.2 * sum(heights)), layout="constrained")
        panels = figure.subplot_mosaic(mosaic, gridspec_kw={"height_ratios": [h + 2.0 for h in heights]})
        spots: list[Spot] = []
        for name, partition in partitions.items():
            _one_partition(panels[name], name, partition, norm, found["false_discovery_rate"])
            spots += _spots(panels[name], name, partition, found["false_discovery_rate"])
        scale = ScalarMappable(norm=norm, cmap="viridis_r")
        bar = figure.colorbar(scale, ax=list(panels.values()), pad=0.01, aspect=40)
        bar.ax.set_yticks(_LEVELS, [str(level) for level in _LEVELS], fontsize=8.0)
        bar.set_label("misfit relative to its expectation without a gap", fontsize=8.5)
        svg = figure_to_svg(
            figure,
            name="standing-out",
            title="Significant regions",
            description=standing_out_sentence(found),
            spots=spots,
        )
    return Picture(
        svg=svg,
        caption="Residual of each balance equation with re-tuned parameters, by region. Grey: not significant. Colour:"
        " significant, by how much. Blank: not compared. Regions overlap: the same gap is divided in several ways.",
    )


def _n_rows(name: str, partition: Mapping[str, Any]) -> int:
    return len(partition["places" if name == "operating_point" else "equations"])


def _one_partition(axes: Axes, name: str, partition: Mapping[str, Any], norm: Any, rate: float) -> None:
    equations = list(partition["equations"])
    times = np.array([partition["equations"][e]["times_expected"] for e in equations], dtype=float)
    q_values = np.array([partition["equations"][e]["q_value"] for e in equations], dtype=float)
    labels = [_short(name, place) for place in partition["places"]]
    rows, columns = equations, labels
    if name == "operating_point":
        times, q_values, rows, columns = times.T, q_values.T, labels, equations
    found = np.ma.masked_where(~(q_values < rate), times)
    grey = np.ma.masked_where(~(q_values >= rate), np.zeros_like(times))
    from matplotlib.colors import ListedColormap

    axes.pcolormesh(grey, cmap=ListedColormap([_GREY]), edgecolors="white", linewidth=0.8)
    axes.pcolormesh(found, cmap="viridis_r", norm=norm, edgecolors="white", linewidth=0.8)
    axes.set_yticks(np.arange(len(rows)) + 0.5, rows, fontsize=8.0)
    step = 3 if name == "crank_angle" else 1
    if name in ("crank_angle", "start_up"):
        axes.set_xticks(np.arange(len(columns))[::step], columns[::step], fontsize=8.0)
    else:
        # Parts of a trial overlap, so that each needs both of its ends.
        slant: dict[str, Any] = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"} if name == "time" else {}
        axes.set_xticks(np.arange(len(columns)) + 0.5, columns, fontsize=8.0, **slant)
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.tick_params(length=0)
    axes.set_title(f"by {_PANELS[name]}", fontsize=9.0, color=QUIET)


def _spots(axes: Axes, name: str, partition: Mapping[str, Any], rate: float) -> list[Spot]:
    found = []
    for row, (equation, cells) in enumerate(partition["equations"].items()):
        for column, (times, q_value) in enumerate(zip(cells["times_expected"], cells["q_value"], strict=True)):
            if q_value is None or times is None:
                continue
            place = _place_words(name, partition["places"][column])
            verdict = "significant" if q_value < rate else "not significant"
            x, y = (row, column) if name == "operating_point" else (column, row)
            found.append(
                Spot(axes=axes, x=(x, x + 1), y=(y, y + 1),
                     text=f"{EQUATION_WORDS.get(equation, equation)}, {place}: misfit {format_number(times, digits=2)} "
                     f"times its expectation, {verdict} (q = {q_value:.2g})")
            )  # fmt: skip
    return found


def _place_words(name: str, place: str) -> str:
    """Name a region in full."""
    return (
        {
            "crank_angle": f"crank angle {place}",
            "harmonic": f"harmonic {place}",
            "time": f"{place} of the trial",
            "start_up": f"{place} after the first motion",
        }.get(name, point_words(place))
        .replace("start-up of the trial", "run-up")
        .replace(" deg", "°")
    )


def _short(name: str, place: str) -> str:
    """Label of the place on its axis: where it begins, or both ends of a part of the trial."""
    if name == "time":
        return place.replace("start-up", "run-up").replace(" to ", "–").removesuffix(" %")
    return point_words(place) if name == "operating_point" else place.split(" ", 1)[0]
