"""The figures of the comparison page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from sawbench.bench.folded import FoldedCycle, pooled
from sawbench.modeling.machines.words import SAW
from sawbench.reporting.compared import QUANTITIES, Quantity, Series
from sawbench.reporting.figures import (
    INK,
    SERIES_COLOURS,
    SERIES_DASHES,
    SERIES_MARKERS,
    WIDTH_IN,
    cycle_axis,
    figure_style,
)
from sawbench.reporting.html import Picture, figure_to_svg
from sawbench.reporting.quantities import format_number
from sawbench.reporting.spots import Spot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LARGEST_OVERLAY = 4
"""More series than this get panels of their own: five bands over each other tell nothing apart."""


def cycles_picture(series: Sequence[Series], *, name: str = "cycles") -> Picture | None:
    """Draw the folded cutting force of every series with its spread.

    Parameters
    ----------
    series : sequence of Series
    name : str
        Of the figure, unique within the page.

    Returns
    -------
    Picture or None
        None where no trial has a cutting force.
    """
    from matplotlib.figure import Figure

    shown = [
        (index, one, cycles)
        for index, one in enumerate(series)
        if (cycles := [t.processed.cutting_force for t in one.trials if t.processed.cutting_force is not None])
    ]
    if not shown:
        return None
    is_overlay = len(shown) <= _LARGEST_OVERLAY
    n_columns = 1 if is_overlay else 3
    n_rows = 1 if is_overlay else -(-len(shown) // n_columns)
    with figure_style():
        height_in = 3.7 if is_overlay else 0.4 + 2.1 * n_rows
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        axes = figure.subplots(n_rows, n_columns, squeeze=False, sharex=True, sharey=True).ravel()
        for place, (index, one, cycles) in enumerate(shown):
            axis = axes[0 if is_overlay else place]
            _draw_cycle(axis, pooled(cycles), index, f"{one.label} (n = {len(cycles)})")
            if not is_overlay:
                axis.set_title(f"{one.label} (n = {len(cycles)})")
        for axis in axes[: 1 if is_overlay else len(shown)]:
            cycle_axis(axis, SAW)
            axis.margins(y=0.08)
        if is_overlay:
            axes[0].set_ylabel("cutting force / N")
            axes[0].legend(loc=_emptier_corner(shown[0][2][0]))
        else:
            figure.supylabel("cutting force / N", fontsize=9.5)
            _tidy_grid(list(axes), len(shown), n_columns)
    peaks = [f"{one.label} {format_number(float(np.nanmax(pooled(cycles).mean)))} N" for _, one, cycles in shown]
    svg = figure_to_svg(
        figure,
        name=name,
        title="Folded cutting force by material",
        description=f"Cutting force over one turn of the crank. Mean curves peak at: {', '.join(peaks)}.",
    )
    caption = (
        "Mean over all strokes of all repetitions; the band is one standard deviation between strokes, "
        "including repetitions. The return stroke is set to zero."
    )
    return Picture(svg=svg, caption=caption)


def _tidy_grid(axes: list[Axes], n_shown: int, n_columns: int) -> None:
    for place, axis in enumerate(axes):
        axis.set_xticks([0, 90, 180, 270, 360])
        if place >= n_shown:
            axis.set_visible(False)
        elif place + n_columns < n_shown:
            axis.set_xlabel("")
        else:
            axis.tick_params(labelbottom=True)


def _draw_cycle(axis: Axes, cycle: FoldedCycle, index: int, label: str) -> None:
    angle_deg, mean, std = np.degrees(cycle.angle_rad), cycle.mean, cycle.std
    colour = SERIES_COLOURS[index % len(SERIES_COLOURS)]
    dashes = SERIES_DASHES[index % len(SERIES_DASHES)]
    axis.fill_between(angle_deg, mean - std, mean + std, color=colour, alpha=0.2, linewidth=0.0)
    axis.plot(angle_deg, mean, color=colour, linestyle=dashes, linewidth=1.7, label=label)


def _emptier_corner(cycle: FoldedCycle) -> str:
    half = len(cycle.mean) // 2
    first, second = np.nansum(np.abs(cycle.mean[:half])), np.nansum(np.abs(cycle.mean[half:]))
    return "upper left" if first < second else "upper right"


def dots_picture(series: Sequence[Series], *, name: str = "dots") -> Picture | None:
    """Draw every repetition as a dot beside the mean with its 95 % interval, one panel a quantity.

    Parameters
    ----------
    series : sequence of Series
    name : str
        Of the figure, unique within the page.

    Returns
    -------
    Picture or None
        None where no series has a value.
    """
    from matplotlib.figure import Figure

    shown = [quantity for quantity in QUANTITIES if any(quantity.key in one.means for one in series)]
    if not shown:
        return None
    n_columns = min(3, len(shown))
    n_rows = -(-len(shown) // n_columns)
    with figure_style():
        height_in = n_rows * (0.7 + 0.36 * len(series))
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        figure.get_layout_engine().set(w_pad=0.12, h_pad=0.08)  # type: ignore[union-attr]
        axes = figure.subplots(n_rows, n_columns, squeeze=False, sharey=True).ravel()
        for axis, quantity in zip(axes, shown, strict=False):
            for index, one in enumerate(series):
                _draw_dots(axis, one, quantity.key, index)
            axis.set_title(f"{quantity.label.replace('k_Fc', '$k_{Fc}$')} / {quantity.unit}")
            axis.set_yticks(range(len(series)), [one.label for one in series], color=INK)
            axis.set_ylim(len(series) - 0.4, -0.6)
            axis.grid(visible=False, axis="y")
            axis.margins(x=0.12)
            axis.locator_params(axis="x", nbins=5)
        for axis in axes[len(shown) :]:
            axis.set_visible(False)
    svg = figure_to_svg(
        figure,
        name=name,
        title="Results by material with 95 % intervals",
        description=_describe_dots(series),
        spots=[
            Spot(axes=axis, x=axis.get_xlim(), y=(index - 0.5, index + 0.5), text=_dots_words(one, quantity))
            for axis, quantity in zip(axes, shown, strict=False)
            for index, one in enumerate(series)
            if quantity.key in one.means
        ],
    )
    caption = (
        "Small open marks: single repetitions. Large marks: mean with its 95 % interval. The axes do not start at zero."
    )
    return Picture(svg=svg, caption=caption)


def _draw_dots(axis: Axes, series: Series, key: str, index: int) -> None:
    mean = series.means.get(key)
    if mean is None:
        axis.annotate("no value", (0.02, index), xycoords=("axes fraction", "data"), va="center", fontsize=8.5)
        return
    colour = SERIES_COLOURS[index % len(SERIES_COLOURS)]
    marker = SERIES_MARKERS[index % len(SERIES_MARKERS)]
    above = np.full(mean.n, index - 0.2)
    axis.plot(mean.values, above, marker, markerfacecolor="white", color=colour, markersize=4.5, linestyle="none")
    if mean.low is not None and mean.high is not None:
        axis.plot([mean.low, mean.high], [index + 0.1] * 2, color=colour, linewidth=2.2, solid_capstyle="butt")
    axis.plot([mean.mean], [index + 0.1], marker, color=colour, markersize=7.5)


def _dots_words(series: Series, quantity: Quantity) -> str:
    mean = series.means[quantity.key]
    single = ", ".join(format_number(float(value)) for value in mean.values)
    return f"{series.label}, {quantity.label}: {quantity.written(mean)}; single repetitions: {single}"


def _describe_dots(series: Sequence[Series]) -> str:
    parts = []
    for one in series:
        shown = [
            f"{quantity.label} {quantity.written(one.means[quantity.key])}"
            for quantity in QUANTITIES
            if quantity.key in one.means
        ]
        parts.append(f"{one.label}: {', '.join(shown)}.")
    return " ".join(parts)
