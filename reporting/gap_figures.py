"""Figures of the gap page: strokes before and after, the ladder by channel, the map over the crank angle."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from sawbench.reporting.figures import CHANNEL_COLOURS, INK, QUIET, WIDTH_IN, figure_style
from sawbench.reporting.html import Picture, figure_to_svg
from sawbench.reporting.quantities import format_number
from sawbench.reporting.spots import Spot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CHANNEL_WORDS: Final = {
    "force_n": "force",
    "motor_current_a": "motor current",
    "crank_speed_rad_s": "crank speed",
    "battery_voltage_v": "battery voltage",
    "battery_current_a": "battery current",
    "displacement_mm": "displacement",
}
EQUATION_WORDS: Final = {
    "electrical": "motor, electrical side",
    "mechanical": "motor and drive, mechanical side",
    "cutting": "cutting",
    "supply": "battery",
    "converter": "converter",
    "sensing": "sensors",
}
_SPEED_COLOUR: Final = "#0072b2"
_NOMINAL_COLOUR: Final = "#b23a48"
_BAR_COLOURS: Final = {"nominal": "#b9bfc5", "retuned": "#7fa8c4", "with_effect": "#00507f", "noise_floor": "#e3e6e8"}
_N_LEVELS: Final = 11
_MOST_MAPS: Final = 3


def point_words(operating_point: str) -> str:
    """Shorten the numbers of an operating point's name.

    Examples
    --------
    >>> point_words("oak, 20.0 mm, feed 1.7999999999999998 mm/s, duty 0.4375")
    'oak, 20 mm, feed 1.8 mm/s, duty 0.4375'
    """
    return re.sub(r"\d+\.\d+", lambda found: f"{float(found[0]):.4g}", operating_point)


def in_channel_words(text: str) -> str:
    """Write the channels that a sentence of the report names as the pages call them.

    Examples
    --------
    >>> in_channel_words("bursts in battery_current_a, force_n, in 18 of 18 trials")
    'bursts in battery current, force, in 18 of 18 trials'
    """
    names = "|".join(CHANNEL_WORDS)
    return re.sub(rf"(?<![\w.])({names})(?!\w)", lambda found: CHANNEL_WORDS[found[0]], text)


def strokes_picture(strokes: Sequence[Mapping[str, Any]], after: str, after_words: str) -> Picture | None:
    """Measured strokes and the model before and after the diagnosis.

    Parameters
    ----------
    strokes : sequence of mapping
        `detail.strokes` of the report.
    after : {"retuned", "with_effect"}
    after_words : str
        What the model after is, for the legend.

    Returns
    -------
    Picture or None
        None where nothing was predicted.
    """
    channels = [name for name in ("force_n", "motor_current_a", "crank_speed_rad_s") if _has(strokes, name)]
    if not channels:
        return None
    from matplotlib.figure import Figure

    said = []
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 1.1 + 1.15 * len(channels)), layout="constrained")
        grid = figure.subplots(len(channels), len(strokes), sharex=True, sharey="row", squeeze=False)
        for row, channel in zip(grid, channels, strict=True):
            unit = next(s["channels"][channel]["unit"] for s in strokes if channel in s["channels"])
            row[0].set_ylabel(f"{CHANNEL_WORDS[channel]}\n/ {unit}", fontsize=8.5)
            for axes, stroke in zip(row, strokes, strict=True):
                if channel in stroke["channels"]:
                    said.append(_one_stroke(axes, stroke, channel, after, after_words))
                else:
                    axes.text(0.5, 0.5, "not measured", transform=axes.transAxes, ha="center", color=QUIET)
        for axes, stroke in zip(grid[0], strokes, strict=True):
            axes.set_title(point_words(stroke["operating_point"]).replace(", feed", ",\nfeed"), fontsize=9.5, pad=16)
        for axes in grid[-1]:
            axes.set_xlim(0.0, 360.0)
            axes.set_xticks([0, 90, 180, 270, 360])
            axes.set_xlabel("crank angle / °")
        handles, labels = next(a for a in grid.ravel() if a.lines).get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3)
        svg = figure_to_svg(
            figure, name="strokes", title="One stroke, measured and simulated", description="; ".join(said) + "."
        )
    return Picture(
        svg=svg,
        caption="Mean stroke of a trial, measured and simulated, up to the highest harmonic that is compared. The"
        " model was fitted to other trials only; k_Fc of the workpiece was fitted to the force of this trial. RMSE in"
        " each panel: model as configured →"
        f" re-tuned{' → with the cause' if after == 'with_effect' else ''}.",
    )


def _has(strokes: Sequence[Mapping[str, Any]], channel: str) -> bool:
    return any(channel in stroke["channels"] for stroke in strokes)


def _one_stroke(axes: Axes, stroke: Mapping[str, Any], channel: str, after: str, after_words: str) -> str:
    curves = stroke["channels"][channel]
    measured = np.array(curves["measured"])
    angle = (np.arange(len(measured)) + 0.5) * 360.0 / len(measured)
    axes.plot(angle, measured, color=CHANNEL_COLOURS.get(channel, _SPEED_COLOUR), linewidth=4.5, alpha=0.4,
              solid_capstyle="butt", label="measured")  # fmt: skip
    axes.plot(angle, curves["nominal"], color=_NOMINAL_COLOUR, linestyle=(0, (4, 2)), label="model as configured")
    axes.plot(angle, curves[after], color=INK, linewidth=1.2, label=after_words)
    rungs = list(dict.fromkeys(("nominal", "retuned", after)))
    off = [float(np.sqrt(np.mean((measured - np.array(curves[rung])) ** 2))) for rung in rungs]
    text = f"RMSE {' → '.join(format_number(value, digits=2) for value in off)} {curves['unit']}"
    axes.text(1.0, 1.02, text, transform=axes.transAxes, ha="right", va="bottom", fontsize=8.5, color=QUIET)
    return f"{CHANNEL_WORDS[channel]} at {point_words(stroke['operating_point'])}: {text}"


def ladder_picture(by_channel: Mapping[str, Mapping[str, Any]], rungs: Sequence[tuple[str, str]]) -> Picture | None:
    """Bars of the gap ladder, one panel a channel.

    Parameters
    ----------
    by_channel : mapping
        `gap.by_channel` of the report.
    rungs : sequence of (key, words)
        Which rungs to show.

    Returns
    -------
    Picture or None
        None where no channel was predicted.
    """
    if not by_channel:
        return None
    from matplotlib.figure import Figure

    spots = []
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 0.75 + 0.3 * len(rungs)), layout="constrained")
        panels = figure.subplots(1, len(by_channel), sharey=True, squeeze=False)[0]
        for axes, (channel, row) in zip(panels, by_channel.items(), strict=True):
            values = [row[key] for key, _ in rungs]
            bars = axes.barh(
                [words for _, words in rungs], values, height=0.7, color=[_BAR_COLOURS[key] for key, _ in rungs],
                edgecolor=QUIET, linewidth=0.5,
            )  # fmt: skip
            axes.bar_label(bars, [format_number(value, digits=2) for value in values], padding=3, fontsize=8.5)
            axes.set_xlim(0.0, 1.45 * max(*values, 1e-9))
            axes.set_xticks([])
            axes.spines["bottom"].set_visible(False)
            axes.grid(visible=False)
            axes.set_title(f"{CHANNEL_WORDS.get(channel, channel)} / {row['unit']}", fontsize=9.0)
            spots += [
                Spot(axes=axes, x=axes.get_xlim(), y=(place - 0.35, place + 0.35),
                     text=f"{CHANNEL_WORDS.get(channel, channel)}, {words}: {format_number(value)} {row['unit']}")
                for place, ((_, words), value) in enumerate(zip(rungs, values, strict=True))
            ]  # fmt: skip
        panels[0].invert_yaxis()
        described = "; ".join(
            f"{CHANNEL_WORDS.get(name, name)}: "
            + ", ".join(f"{words} {format_number(row[key], digits=2)}" for key, words in rungs)
            + f" {row['unit']}"
            for name, row in by_channel.items()
        )
        svg = figure_to_svg(
            figure, name="ladder", title="How far the gap closes, by channel", description=described, spots=spots
        )
    return Picture(
        svg=svg,
        caption="RMSE of the simulated mean stroke. Noise: standard uncertainty of a measured mean stroke, from the"
        " scatter of single strokes within a trial or, where larger, of repeats. What is fitted to each trial follows"
        " a part of this scatter, so the RMSE can be below the noise; differences that small are not significant.",
    )


def map_picture(found: Mapping[str, Any], order: Sequence[str]) -> Picture | None:
    """Show the gap of the model as configured over crank angle and operating point, one panel an equation.

    Parameters
    ----------
    found : mapping
        `detail.map` of the report.
    order : sequence of str
        Equations, the one with the largest share first; others follow.
    """
    names = [name for name in order if name in found["equations"]][:_MOST_MAPS]
    if not names:
        return None
    from matplotlib.colors import BoundaryNorm
    from matplotlib.figure import Figure

    points = [point_words(point) for point in found["operating_points"]]
    spots: list[Spot] = []
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 0.4 + len(names) * (0.55 + 0.2 * len(points))), layout="constrained")
        panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
        for axes, name in zip(panels, names, strict=True):
            equation = found["equations"][name]
            width = max((len(row) for row in equation["values"] if row), default=1)
            rows = [[np.nan] * width if row is None else row for row in equation["values"]]
            values = np.ma.masked_invalid(np.array(rows, dtype=float))
            top = float(np.abs(values).max()) or 1.0
            edges = np.linspace(0.0, 360.0, width + 1)
            drawn = axes.pcolormesh(
                edges, np.arange(len(points) + 1), values, cmap="RdBu_r",
                norm=BoundaryNorm(np.linspace(-top, top, _N_LEVELS + 1), 256),
            )  # fmt: skip
            spots += _map_spots(axes, equation, points, edges.tolist())
            axes.set_yticks(np.arange(len(points)) + 0.5, points, fontsize=8.0)
            axes.invert_yaxis()
            axes.grid(visible=False)
            axes.set_facecolor("#e3e6e8")
            axes.set_title(f"{EQUATION_WORDS.get(name, name)}: measured minus model / {_unit(equation)}", fontsize=9.5)
            bar = figure.colorbar(drawn, ax=axes, pad=0.01, ticks=[-top, 0.0, top], aspect=12)
            bar.ax.set_yticklabels([format_number(-top, digits=2), "0", format_number(top, digits=2)], fontsize=8.0)
        panels[-1].set_xticks([0, 45, 90, 135, 180, 225, 270, 315, 360])
        panels[-1].set_xlabel("crank angle / °")
        svg = figure_to_svg(
            figure, name="map", title="Where the gap lies",
            description="Residual of " + ", ".join(EQUATION_WORDS.get(n, n) for n in names)
            + " over crank angle and operating point; the table below says the same in words.",
            spots=spots,
        )  # fmt: skip
    return Picture(
        svg=svg,
        caption="Residual of each balance equation over the crank angle, one row per operating point. Model as"
        " configured, parameters free within their stated uncertainty. Not coloured: no gap. Red: measured above the"
        " model. Blue: measured below the model.",
    )


def _unit(equation: Mapping[str, Any]) -> str:
    return str(equation["unit"]).replace("*", "·")


def _map_spots(
    axes: Axes, equation: Mapping[str, Any], points: Sequence[str], edges_deg: Sequence[float]
) -> list[Spot]:
    return [
        Spot(axes=axes, x=(edges_deg[k], edges_deg[k + 1]), y=(place, place + 1),
             text=f"{points[place]}, crank angle {edges_deg[k]:.0f}° to {edges_deg[k + 1]:.0f}°: "
             f"{format_number(value, digits=2)} {_unit(equation)}")
        for place, row in enumerate(equation["values"]) if row is not None
        for k, value in enumerate(row) if value is not None and np.isfinite(value)
    ]  # fmt: skip


def alike_rows(alike: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of the table of similarities: cosine between the signatures of two effects, percent."""
    names = alike["effects"]
    return [
        {"effect": name, "values": [round(100 * abs(value)) for value in row]}
        for name, row in zip(names, alike["cosine"], strict=True)
    ]
