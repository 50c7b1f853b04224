"""Sections as Markdown with small drawings."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.measuring import Goal, Plot, Section

if TYPE_CHECKING:
    from matplotlib.axis import Axis

COLOURS = ("#00507f", "#b23a48", "#5a8f29", "#c98a00", "#6b4fa0", "#555555")


def goal_row(goal: Goal) -> str:
    """One row of the table of goals."""
    bound = f"{'≥' if goal.at_least else '≤'} {goal.bound:g}{' ' if goal.unit else ''}{goal.unit}"
    if goal.value is None:
        return f"| {goal.what} | {bound} | not measured here | |"
    value = f"{goal.value:.3g}{' ' if goal.unit else ''}{goal.unit}"
    return f"| {goal.what} | {bound} | {value} | {'met' if goal.is_met else '**not met**'} |"


def goals_text(goals: list[Goal]) -> str:
    """All goals as a table."""
    return "\n".join([GOALS_HEAD, *map(goal_row, goals)])


GOALS_HEAD = "| goal | bound | measured | |\n|---|---|---|---|"
# Stands behind all sections that are measured.
PLAN = "A plan for a million recordings"


def updated(page: str, sections: list[Section], pictures: dict[str, str], note: str) -> str:
    """Put sections that were measured apart into a page, in place of those of the same title.

    Parameters
    ----------
    page : str
        Markdown that `python -m benchmarks --out` wrote.
    sections : list of Section
    pictures : dict of str to str
        Path of each plot.
    note : str
        Says when and how these sections were measured; stands first in each of them.
    """
    head, *parts = page.rstrip("\n").split("\n\n## ")
    texts = {part.partition("\n")[0]: f"## {part}" for part in parts}
    plan = texts.pop(PLAN, None)
    for section in sections:
        texts[section.title] = section_text(replace(section, words=[note, *section.words]), pictures)
    before, _, after = head.partition(GOALS_HEAD)
    table, *behind = after.lstrip("\n").split("\n\n")
    rows = {row.split("|")[1].strip(): row for row in table.splitlines()}
    for goal in (goal for section in sections for goal in section.goals):
        rows[goal.what] = goal_row(goal)
    n_met = sum(row.endswith("| met |") for row in rows.values())
    before = re.sub(r"\d+ of \d+ goals are met", f"{n_met} of {len(rows)} goals are met", before)
    goals = "\n".join([GOALS_HEAD, *rows.values()])
    return "\n\n".join([before.rstrip("\n"), goals, *behind, *texts.values(), *([plan] if plan else [])]) + "\n"


def section_text(section: Section, pictures: dict[str, str] | None = None) -> str:
    """One section; `pictures` gives the path of each plot, without it plots are left out."""
    parts = [f"## {section.title}", *section.words]
    for table in section.tables:
        rows = [table.head, tuple("---" for _ in table.head), *table.rows]
        lines = ["| " + " | ".join(row) + " |" for row in rows]
        parts += [f"### {table.title}"] if table.title else []
        parts.append("\n".join(lines))
    if section.goals and pictures is None:
        parts.append(goals_text(section.goals))
    parts += [f"![{plot.title}]({pictures[plot.name]})" for plot in section.plots if pictures]
    return "\n\n".join(parts)


def logarithmic(axis: Axis, values: Iterable[float]) -> None:
    """Make an axis logarithmic with plain numbers, unless a value is 0."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    low, high = min(values := list(values)), max(values)
    if low <= 0:
        return
    getattr(axis.axes, f"set_{axis.axis_name}scale")("log")
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 100 * low else (1.0,)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def draw(plot: Plot, path: Path) -> None:
    """Write one plot as SVG: the same numbers give the same bytes."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    style = {
        "svg.hashsalt": plot.name, "svg.fonttype": "none", "font.size": 9, "font.family": "sans-serif",
        "axes.spines.top": False, "axes.spines.right": False, "path.simplify": True,
    }  # fmt: skip
    with mpl.rc_context(style):
        figure = Figure(figsize=(6.2, 0.9 + 0.24 * len(plot.bars) if plot.bars else 3.0), layout="constrained")
        axes = figure.subplots()
        if plot.bars:
            names = list(plot.bars)[::-1]
            colours = [COLOURS[0] if name.startswith("sawbench") else "#a9b4bd" for name in names]
            axes.barh(names, [plot.bars[name] for name in names], color=colours, height=0.65)
            logarithmic(axes.xaxis, plot.bars.values())
            for row, name in enumerate(names):
                axes.annotate(
                    f"{float(f'{plot.bars[name]:.3g}'):g}", (plot.bars[name], row), xytext=(3, 0),
                    textcoords="offset points", va="center", fontsize=8,
                )  # fmt: skip
            axes.margins(x=0.12)
        for (label, (x, y)), colour in zip(plot.lines.items(), COLOURS, strict=False):
            axes.plot(x, y, "o-", color=colour, label=label, markersize=3.5, linewidth=1.4)
        if plot.lines:
            for axis, k in ((axes.xaxis, 0), (axes.yaxis, 1)):
                logarithmic(axis, [value for line in plot.lines.values() for value in line[k]])
            axes.grid(True, which="major", color="#e3e6e8")
            axes.legend(frameon=False, fontsize=8)
        axes.set_title(plot.title, fontsize=10, loc="left")
        axes.set_xlabel(plot.x_label)
        axes.set_ylabel(plot.y_label)
        figure.savefig(path, format="svg", metadata={"Date": None, "Creator": None}, facecolor="white")
