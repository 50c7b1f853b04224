"""Values under the pointer for drawings of bars, cells and marks: an invisible area with its words over each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SVG_DPI: Final = 72.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Spot:
    """An area of a drawing and what it says.

    Attributes
    ----------
    axes : matplotlib.axes.Axes
    x, y : (float, float)
        Edges in the numbers of the axes, in any order.
    text : str
        What the area shows, with value and unit.
    """

    axes: Axes
    x: tuple[float, float]
    y: tuple[float, float]
    text: str


def spots_svg(figure: Figure, spots: Iterable[Spot]) -> str:
    """SVG of the areas, to append to the drawing of a figure that was drawn once.

    A browser shows the title of an area under the pointer; the script of a page shows it at once.
    """
    areas = []
    for spot in spots:
        corners = spot.axes.transData.transform([(spot.x[0], spot.y[0]), (spot.x[1], spot.y[1])])
        (left, bottom), (right, top) = (
            corners.min(axis=0) * _SVG_DPI / figure.dpi,
            corners.max(axis=0) * _SVG_DPI / figure.dpi,
        )
        above = float(figure.get_figheight()) * _SVG_DPI - top
        areas.append(
            f'<rect x="{left:.2f}" y="{above:.2f}" width="{right - left:.2f}" height="{top - bottom:.2f}">'
            f"<title>{escape(spot.text)}</title></rect>"
        )
    return f'<g class="spots" fill="none" pointer-events="all">{"".join(areas)}</g>' if areas else ""
