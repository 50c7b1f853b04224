"""The learned term of a gap report: its sentences, and its curves with their 95 % band."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.learned import LearnedTerm
from sawbench.modeling.state import TWO_PI
from sawbench.reporting.cause_words import withheld_words
from sawbench.reporting.figures import SERIES_COLOURS, SERIES_DASHES, WIDTH_IN, figure_style
from sawbench.reporting.html import Picture, figure_to_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_N_POINTS: Final = 200
# Where in its range the second and the third quantity are held.
_HELD: Final = (0.1, 0.5, 0.9)
_AXIS_NAMES: Final = {"rad": ("°", 180.0 / np.pi)}


def learned_sentences(learned: Mapping[str, Any]) -> list[str]:
    """Say what was learned, how far it closes the gap and where it holds."""
    low, high = learned["gap_closed_ci95"]
    ranges = [_range(q) for q in learned["quantities"] if q["name"] != "crank_angle_rad"]
    said = [
        f"A term was learned from the residuals:  {learned['words']}.",
        f"It explains {round(100 * learned['gap_closed'])} % ({round(100 * low)} to {round(100 * high)} %) of the"
        f" remaining error {withheld_words(learned)}.",
    ]
    if ranges:
        said.append(f"Valid range: {' and '.join(ranges)}. It must not be used outside.")
    return said


def _range(quantity: Mapping[str, Any]) -> str:
    low, high = quantity["range"]
    return f"{quantity['words']} from {low:.3g} to {high:.3g} {quantity['unit']}"


def learned_picture(learned: Mapping[str, Any]) -> Picture:
    """Draw the term over the quantity that moves it most, the others held at three places of their range.

    Parameters
    ----------
    learned : mapping
        `learned_term` of the report.
    """
    from matplotlib.figure import Figure

    table, quantities = learned["table"], learned["quantities"]
    term, low, high = (_term(learned, key) for key in ("values", "low", "high"))
    order = sorted(range(len(quantities)), key=lambda axis: -_moves(term, axis))
    main, others = order[0], order[1:]
    levels = [_levels(quantities[axis]["range"]) for axis in others]
    panels = levels[1] if len(levels) > 1 else [None]
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, 3.4), layout="constrained")
        grid = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for axes, panel in zip(grid, panels, strict=True):
            for number, level in enumerate(levels[0] if levels else [None]):
                held = {axis: value for axis, value in zip(others, (level, panel), strict=False) if value is not None}
                label = None if level is None else f"{level:.3g} {quantities[others[0]]['unit']}"
                _curve(axes, (term, low, high), main, held, number=number, label=label)
            if panel is not None:
                axes.set_title(_held_words(quantities[others[1]], panel), fontsize=9.0)
            unit, factor = _AXIS_NAMES.get(quantities[main]["unit"], (quantities[main]["unit"], 1.0))
            axes.set_xlabel(f"{_short(quantities[main]['words'])} / {unit}")
            axes.set_xlim(*(factor * end for end in quantities[main]["range"]))
        grid[0].set_ylabel(f"learned term / {table['unit']}")
        if levels:
            title = _short(quantities[others[0]]["words"])
            grid[-1].legend(title=title, fontsize=8.5, title_fontsize=8.5)
        svg = figure_to_svg(figure, name="learned", title="The learned term", description=learned["words"] + ".")
    beside = "; ".join(_short(quantities[axis]["words"]) for axis in others)
    return Picture(
        svg=svg,
        caption="Term missing in the model, learned from the residuals, with its 95 % band"
        + (f"; curves at three values of: {beside}" if others else "")
        + ". The band includes the correlation with parameters, gains and zeros, for example a common level. It is wide"
        " where there is no trial.",
    )


def _term(learned: Mapping[str, Any], key: str) -> LearnedTerm:
    values = np.array(learned["table"][key])
    return LearnedTerm(
        site=learned["stands_in"],
        quantities=tuple(q["name"] for q in learned["quantities"]),
        nodes=tuple(tuple(nodes) for nodes in learned["table"]["nodes"]),
        values=values,
        stds=np.zeros_like(values),
    )


def _moves(term: LearnedTerm, axis: int) -> float:
    """How far the term moves along one quantity, root mean square."""
    return float(np.sqrt(np.mean(term.values.std(axis=axis) ** 2)))


def _levels(ends: list[float]) -> list[float]:
    return [ends[0] + share * (ends[1] - ends[0]) for share in _HELD]


def _curve(
    axes: Axes, terms: tuple[LearnedTerm, LearnedTerm, LearnedTerm], main: int, held: Mapping[int, float], *,
    number: int, label: str | None,
) -> None:  # fmt: skip
    first, last = terms[0].range[terms[0].quantities[main]]
    place = np.linspace(first, last, _N_POINTS)
    factor = _AXIS_NAMES["rad"][1] if last == TWO_PI else 1.0
    measured: list[Floats] = [
        place if axis == main else np.full(_N_POINTS, held[axis]) for axis in range(len(terms[0].quantities))
    ]
    middle, low, high = (term.at(measured) for term in terms)
    colour = SERIES_COLOURS[number]
    axes.fill_between(factor * place, low, high, color=colour, alpha=0.15, linewidth=0.0)
    axes.plot(factor * place, middle, color=colour, linestyle=SERIES_DASHES[number], label=label)


def _held_words(quantity: Mapping[str, Any], value: float) -> str:
    return f"{_short(quantity['words'])} {value:.3g} {quantity['unit']}"


def _short(words: str) -> str:
    return words.split(" (", 1)[0]
