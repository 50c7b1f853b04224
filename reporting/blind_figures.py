"""The figures of the blind check's page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sawbench.reporting.figures import INK, QUIET, SERIES_COLOURS, WIDTH_IN, figure_style
from sawbench.reporting.html import Picture, figure_to_svg
from sawbench.reporting.spots import Spot

_CHARACTER_IN = 0.062
_OUTCOMES = (
    ("exact", "named exactly", "#0072b2", ""),
    ("group", "within the named group", "#7fb8d8", "//"),
    ("other_effect", "another effect named", "#c2410c", ""),
    ("not_declared", "no effect named", "#d5d9dc", ".."),
)


def confusion_picture(table: Mapping[str, Any], *, name: str, title: str, caption: str) -> Picture:
    """Draw truth (rows) against answer (columns); shade by share of the row, count in every cell.

    Parameters
    ----------
    table : mapping
        `rows`, `columns`, `counts`; rows without a case and columns without an answer are left out.
    name, title, caption : str
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    counts = np.array(table["counts"], dtype=np.int64).reshape(len(table["rows"]), len(table["columns"]))
    kept = [k for k in range(len(table["rows"])) if counts[k].any()]
    shown = [k for k, column in enumerate(table["columns"]) if counts[:, k].any() or column in _labels(table, kept)]
    rows, columns = _labels(table, kept), [table["columns"][k] for k in shown]
    counts = counts[np.ix_(kept, shown)]
    # Labels get the room that they need; no cell gets wider than a large matrix needs.
    left_in = 0.3 + _CHARACTER_IN * max(map(len, rows), default=0)
    top_in = 0.3 + 0.82 * _CHARACTER_IN * max(map(len, columns), default=0)
    slant_in = 0.57 * _CHARACTER_IN * max(map(len, columns), default=0)
    cell_in = min(0.36, (WIDTH_IN - left_in - slant_in) / max(len(columns), 1))
    width_in, height_in = cell_in * len(columns), cell_in * len(rows)
    with figure_style():
        size = (WIDTH_IN, height_in + top_in + 0.3)
        figure = Figure(figsize=size)
        axes = figure.add_axes((left_in / size[0], 0.25 / size[1], width_in / size[0], height_in / size[1]))
        axes.grid(False)
        for (i, j), count in np.ndenumerate(counts):
            if count:
                share = count / counts[i].sum()
                colour = (
                    (0.0, 0.31, 0.5, 0.12 + 0.88 * share)
                    if rows[i] == columns[j]
                    else (0.76, 0.25, 0.05, 0.1 + 0.75 * share)
                )
                axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1, 1, facecolor=colour, edgecolor="white", linewidth=0.5))
                axes.text(
                    j, i, str(count), ha="center", va="center", fontsize=7.5, color="white" if share > 0.5 else INK
                )
            elif rows[i] == columns[j]:
                axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1, 1, facecolor="none", edgecolor=QUIET, linewidth=0.5))
        axes.set(xlim=(-0.5, len(columns) - 0.5), ylim=(len(rows) - 0.5, -0.5))
        axes.xaxis.tick_top()
        axes.set_xticks(
            range(len(columns)),
            [_words(c) for c in columns],
            rotation=55,
            ha="left",
            rotation_mode="anchor",
            fontsize=8,
        )
        axes.set_yticks(range(len(rows)), [_words(r) for r in rows], fontsize=8)
        axes.tick_params(length=0)
        for side in axes.spines.values():
            side.set_visible(True)
            side.set_color("#c9ced3")
        figure.text(left_in / size[0], 0.08 / size[1], "rows: truth; columns: answer", color=QUIET, fontsize=8)
        spots = [
            Spot(axes=axes, x=(j - 0.5, j + 0.5), y=(i - 0.5, i + 0.5),
                 text=f"truth {_words(rows[i])}, answer {_words(columns[j])}: {count} of {counts[i].sum()}")
            for (i, j), count in np.ndenumerate(counts) if count
        ]  # fmt: skip
        svg = figure_to_svg(
            figure, name=name, title=title, description=_confusion_words(rows, columns, counts), spots=spots
        )
    return Picture(svg=svg, caption=caption)


def calibration_picture(calibration: Mapping[str, Any]) -> Picture:
    """Draw how often the most probable hypothesis was true against the probability stated for it."""
    from matplotlib.figure import Figure

    bins = calibration["bins"]
    stated = [one["stated"] for one in bins]
    share = [one["correct"]["share"] for one in bins]
    below = [one["correct"]["share"] - one["correct"]["low"] for one in bins]
    above = [one["correct"]["high"] - one["correct"]["share"] for one in bins]
    with figure_style():
        figure = Figure(figsize=(5.0, 4.0), layout="constrained")
        axes = figure.add_subplot()
        axes.plot([0, 1], [0, 1], color=QUIET, linestyle=(0, (4, 3)), linewidth=1.0, label="perfectly calibrated")
        axes.errorbar(
            stated, share, yerr=[below, above], fmt="o", color=SERIES_COLOURS[0], capsize=3, label="observed, 95 %"
        )
        axes.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), xlabel="stated probability", ylabel="fraction correct")
        axes.legend(loc="upper left")
        words = "; ".join(f"stated {a:.2f}, correct {b:.2f}" for a, b in zip(stated, share, strict=True))
        svg = figure_to_svg(figure, name="calibration", title="Calibration", description=words or "no answers")
    return Picture(
        svg=svg,
        caption="Stated probability of the most probable hypothesis and the fraction of cases in which it was true. "
        "Each bin has the same number of cases.",
    )


def severity_picture(bins: Sequence[Mapping[str, Any]]) -> Picture:
    """Draw what came of cases with one effect, by its severity."""
    from matplotlib.figure import Figure

    filled = [one for one in bins if sum(one[key] for key, *_ in _OUTCOMES)]
    totals = np.array([sum(one[key] for key, *_ in _OUTCOMES) for one in filled], dtype=np.float64)
    bottom = np.zeros(len(filled))
    spots: list[Spot] = []
    with figure_style():
        figure = Figure(figsize=(5.0, 4.0), layout="constrained")
        axes = figure.add_subplot()
        axes.grid(False, axis="x")
        for key, label, colour, hatch in _OUTCOMES:
            height = np.array([one[key] for one in filled]) / totals
            axes.bar(
                range(len(filled)), height, bottom=bottom, color=colour, hatch=hatch, edgecolor="white", label=label
            )
            spots += [
                Spot(axes=axes, x=(k - 0.4, k + 0.4), y=(bottom[k], bottom[k] + height[k]),
                     text=f"severity {one['low']:g} to {one['high']:g}, {label}: {one[key]} of {totals[k]:.0f}")
                for k, one in enumerate(filled) if one[key]
            ]  # fmt: skip
            bottom += height
        for k, total in enumerate(totals):
            axes.text(k, 1.01, f"n={total:.0f}", ha="center", va="bottom", fontsize=8, color=QUIET)
        axes.set_xticks(range(len(filled)), [f"{one['low']:g}–{one['high']:g}" for one in filled], fontsize=8)
        axes.set(ylim=(0, 1.08), xlabel="severity (1 is typical)", ylabel="share of cases")
        figure.legend(loc="outside upper center", ncols=2, fontsize=8)
        words = "; ".join(
            f"severity {one['low']:g} to {one['high']:g}: "
            + ", ".join(f"{one[key]} {label}" for key, label, *_ in _OUTCOMES)
            for one in filled
        )
        svg = figure_to_svg(
            figure, name="severity", title="Outcome by severity", description=words or "no cases", spots=spots
        )
    return Picture(svg=svg, caption="Cases with one hidden effect of the catalogue, by severity.")


def time_picture(times_s: Sequence[float]) -> Picture:
    """Draw how long the answers took."""
    from matplotlib.figure import Figure

    times = np.array(times_s, dtype=np.float64)
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 2.2), layout="constrained")
        axes = figure.add_subplot()
        counts, edges, _ = axes.hist(
            times, bins=min(30, max(5, len(times) // 5)), color=SERIES_COLOURS[0], edgecolor="white"
        )
        spots = [
            Spot(axes=axes, x=(edges[k], edges[k + 1]), y=(0.0, float(count)),
                 text=f"{edges[k]:.1f} to {edges[k + 1]:.1f} s: {count:.0f} cases")
            for k, count in enumerate(np.asarray(counts)) if count
        ]  # fmt: skip
        axes.axvline(float(np.median(times)), color=INK, linestyle=(0, (4, 3)), linewidth=1.0, label="median")
        axes.margins(y=0.2)
        axes.set(xlabel="wall time of one answer / s", ylabel="cases", xlim=(0, None))
        axes.legend(loc="best")
        words = f"{len(times)} cases, {times.min():.1f} to {times.max():.1f} s, median {np.median(times):.1f} s"
        svg = figure_to_svg(figure, name="time", title="Time of an answer", description=words, spots=spots)
    return Picture(svg=svg, caption="Each answer was computed in its own process with one thread.")


def _labels(table: Mapping[str, Any], kept: Sequence[int]) -> list[str]:
    return [table["rows"][k] for k in kept]


def _words(name: str) -> str:
    return name.replace("_", " ")


def _confusion_words(rows: Sequence[str], columns: Sequence[str], counts: np.ndarray) -> str:
    right = sum(int(counts[i, columns.index(row)]) for i, row in enumerate(rows) if row in columns)
    wrong = sorted(
        (
            (int(counts[i, j]), row, column)
            for i, row in enumerate(rows)
            for j, column in enumerate(columns)
            if row != column and counts[i, j]
        ),
        reverse=True,
    )
    said = f"{right} of {int(counts.sum())} cases lie on the diagonal"
    if wrong:
        said += "; most frequent confusions: "
        said += ", ".join(f"{_words(row)} answered as {_words(column)} ({count})" for count, row, column in wrong[:8])
    return said
