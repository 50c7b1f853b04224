"""The data of a figure, for plots that zoom and can be read off: what `assets/charts.js` draws in a browser.

A figure of lines, bands and guides is described as it was drawn, so no page has to draw anything twice. Figures of
bars, cells and places on an axis of words stay drawings.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from sawbench.bench.recording import Floats

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

FINE_POINTS: Final = 20_000
"""Points of one line that a page may carry beyond those of its drawing."""
_Y_STEPS: Final = 2e4
_X_STEPS: Final = 1e6
_LOG_STEPS: Final = 1e9
_CSS_PX_PER_IN: Final = 96.0
_LEAST_LOG: Final = 1e-300


def chart_data(figure: Figure, finer: Mapping[Line2D, tuple[Floats, Floats]] | None = None) -> dict[str, Any] | None:
    """Describe a drawn figure for the script of the pages.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Already drawn once: its texts are where the layout put them.
    finer : mapping of Line2D to (x, y), optional
        More points of a line than were drawn, shown where somebody zooms in.

    Returns
    -------
    dict or None
        None where the figure holds something else than lines over a number, bands, guides and texts.
    """
    panels = []
    siblings: list[Any] = []
    for axes in figure.axes:
        if not axes.lines and not axes.patches and not axes.collections:
            continue
        panel = _panel(axes, finer or {})
        if panel is None:
            return None
        group = set(axes.get_shared_x_axes().get_siblings(axes))
        if group not in siblings:
            siblings.append(group)
        panels.append({**panel, "group": siblings.index(group)})
    if not panels:
        return None
    _name_by_colour(panels)
    columns = {round(float(axes.get_position().x0), 2) for axes in figure.axes}
    return {"n_columns": len(columns), "panels": panels}


def _name_by_colour(panels: list[dict[str, Any]]) -> None:
    """Name the lines of a panel without a legend as those of the same colour in the panels that have one."""
    named = {one["colour"]: one["label"] for panel in panels for one in panel["series"] if one["label"]}
    for panel in panels:
        for one in (*panel["series"], *panel["shapes"]):
            if not one.get("is_span"):
                one["label"] = one["label"] or named.get(one["colour"], "")


def _panel(axes: Axes, finer: Mapping[Line2D, tuple[Floats, Floats]]) -> dict[str, Any] | None:
    from matplotlib.container import ErrorbarContainer
    from matplotlib.ticker import LogFormatter, ScalarFormatter

    is_plain = all(isinstance(one, ErrorbarContainer) for one in axes.containers)
    formatters = (axes.xaxis.get_major_formatter(), axes.yaxis.get_major_formatter())
    if not is_plain or not all(isinstance(one, ScalarFormatter | LogFormatter) for one in formatters):
        return None
    lines, guides = [], []
    for line in axes.lines:
        in_x, in_y = line.get_transform().contains_branch_seperately(axes.transData)
        if not (in_x and in_y):
            guides.append(_guide(line, "x" if in_x else "y"))
            continue
        x, y = finer.get(line) or (line.get_xdata(), line.get_ydata())
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        if not np.isfinite(x).all() or np.any(np.diff(x) < 0):
            return None
        # The caps of error bars are lines of markers; the bars themselves say it all.
        if line.get_marker() not in {"|", "_", 2, 3}:
            lines.append((line, x, y))
    shapes = _shapes(axes)
    figure = axes.get_figure(root=True)
    if not lines or shapes is None or figure is None:
        return None
    title = _plain(axes.get_title(loc="left") or axes.get_title())
    labels = _labels(axes, [line for line, *_ in lines], shapes, title)
    x_axis, y_axis = _axis(axes, "x"), _axis(axes, "y")
    height_in = axes.get_position().height * float(figure.get_figheight())
    y_steps = _LOG_STEPS if y_axis["is_log"] else _Y_STEPS
    named = zip(lines, labels, strict=True)
    return {
        "title": title, "x": x_axis, "y": y_axis, "height": round(_CSS_PX_PER_IN * height_in) + 60,
        "series": [_series(line, label, x, coded(y, n_steps=y_steps)) for (line, x, y), label in named],
        "shapes": [_coded_shape(one) for one in shapes], "guides": guides, **_texts(axes),
    }  # fmt: skip


def _series(line: Line2D, label: str, x: Floats, y: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "label": label, "colour": _hex(line.get_color()), "alpha": line.get_alpha() or 1.0,
        "width": 0.0 if line.get_linestyle() == "None" else round(float(line.get_linewidth()), 2),
        "dash": _dash(line), "has_points": line.get_marker() not in {"None", "", None},
        "x": coded(x, n_steps=_X_STEPS), "y": y,
    }  # fmt: skip


def _guide(line: Line2D, axis: str) -> dict[str, Any]:
    value = np.asarray(line.get_xdata() if axis == "x" else line.get_ydata(), dtype=np.float64)[0]
    colour, width = _hex(line.get_color()), round(float(line.get_linewidth()), 2)
    return {"axis": axis, "at": float(value), "colour": colour, "width": width, "dash": _dash(line)}


def _shapes(axes: Axes) -> list[dict[str, Any]] | None:
    """Bands, spans and error bars; None where something else is drawn."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.colors import to_rgba
    from matplotlib.patches import Rectangle

    found: list[dict[str, Any]] = []
    for one in axes.collections:
        if not isinstance(one, PolyCollection | LineCollection):
            return None
        is_filled = isinstance(one, PolyCollection)
        paths = [np.asarray(path.vertices, dtype=np.float64) for path in one.get_paths()]
        faces, edges = np.asarray(one.get_facecolor()), np.asarray(one.get_edgecolor())
        colours = faces if is_filled else edges
        is_hatched = is_filled and (not len(colours) or bool(one.get_hatch()))
        colour = edges[0] if is_hatched else colours[0]
        alpha = 0.15 if is_hatched else float(colour[3])
        found.append(_shape(one, paths, colour, alpha=alpha, is_filled=is_filled))
    for one in axes.patches:
        if not isinstance(one, Rectangle) or one.get_transform() == one.get_patch_transform():
            return None
        in_x, in_y = one.get_transform().contains_branch_seperately(axes.transData)
        if not in_x or in_y:
            return None
        corners = np.array([[one.get_x(), 0], [one.get_x(), 1], [one.get_x() + one.get_width(), 1],
                            [one.get_x() + one.get_width(), 0]], dtype=np.float64)  # fmt: skip
        colour = one.get_facecolor()
        found.append({**_shape(one, [corners], colour, alpha=to_rgba(colour)[3]), "is_span": True})
    return found


def _shape(
    artist: Artist, paths: Iterable[Floats], colour: Any, *, alpha: float, is_filled: bool = True
) -> dict[str, Any]:
    label = str(artist.get_label())
    return {"label": "" if label.startswith("_") else _plain(label), "colour": _hex(colour), "alpha": round(alpha, 3),
            "is_filled": is_filled, "is_span": False, "paths": list(paths)}  # fmt: skip


def _coded_shape(shape: Mapping[str, Any]) -> dict[str, Any]:
    paths = [
        [coded(path[:, 0], n_steps=_X_STEPS), coded(path[:, 1], n_steps=_Y_STEPS)]
        for path in shape["paths"]
        if len(path)
    ]
    return {**shape, "paths": paths}


def _labels(axes: Axes, lines: list[Line2D], shapes: list[dict[str, Any]], title: str) -> list[str]:
    """Name every line, and let a band without a name go with the line of its colour."""
    from matplotlib.container import ErrorbarContainer

    # The line of error bars carries no name, they do.
    of_bars = {one.lines[0]: one.get_label() for one in axes.containers if isinstance(one, ErrorbarContainer)}
    said = [str(of_bars.get(line, line.get_label())) for line in lines]
    given = ["" if text.startswith("_") else _plain(text) for text in said]
    colours = [_hex(line.get_color()) for line in lines]
    of_shapes = {shape["colour"]: shape["label"] for shape in shapes if shape["label"]}
    alone = title or _plain(axes.get_ylabel())
    found = [
        label or of_shapes.get(colour, alone if len(lines) == 1 else "")
        for label, colour in zip(given, colours, strict=True)
    ]
    by_colour = {colour: label for colour, label in zip(colours, found, strict=True) if label}
    for shape in shapes:
        shape["label"] = shape["label"] or by_colour.get(shape["colour"], "")
    return found


def _axis(axes: Axes, name: str) -> dict[str, Any]:
    axis = axes.xaxis if name == "x" else axes.yaxis
    limits = axes.get_xlim() if name == "x" else axes.get_ylim()
    own = label = _plain(axis.get_label_text())
    if not label:
        shared = axes.get_shared_x_axes() if name == "x" else axes.get_shared_y_axes()
        texts = (_plain(one.xaxis.get_label_text() if name == "x" else one.yaxis.get_label_text())
                 for one in shared.get_siblings(axes))  # fmt: skip
        label = next((text for text in texts if text), "")
    # Panels side by side become panels above one another on a narrow window: each states its quantity.
    own = label if name == "y" else own
    quantity, _, unit = label.rpartition(" / ")
    is_log = axis.get_scale() == "log"
    low, high = sorted(map(float, limits))
    return {
        "label": own, "name": quantity or ("" if unit == label and name == "y" else label),
        "unit": f" {unit}" if quantity or name == "y" else "", "is_log": is_log,
        "is_angle": "angle" in label and "°" in label, "range": [max(low, _LEAST_LOG) if is_log else low, high],
    }  # fmt: skip


def _texts(axes: Axes) -> dict[str, Any]:
    """Texts inside the panel, where the layout put them, in the numbers of the axes; those above it as a note."""
    found, above = [], []
    for text in axes.texts:
        box = text.get_window_extent()
        x, y = axes.transData.inverted().transform((box.x0, 0.5 * (box.y0 + box.y1)))
        low, high = sorted(axes.get_ylim())
        if y > high:
            above.append(_plain(text.get_text()))
        elif text.get_text() and y >= low:
            found.append({"text": _plain(text.get_text()), "x": float(f"{x:.6g}"), "y": float(f"{y:.6g}"),
                          "colour": _hex(text.get_color())})  # fmt: skip
    return {"texts": found, "note": ", ".join(filter(None, above))}


def coded(values: Floats, *, n_steps: float) -> dict[str, Any]:
    """Write numbers as whole multiples of a quantum, each as its difference from the one before.

    Parameters
    ----------
    values : ndarray, shape (n,)
        What is not finite becomes None.
    n_steps : float
        How fine: the quantum is the power of ten below the range of the values over this.

    Returns
    -------
    dict
        `per_unit`, quanta of one unit, and `steps`, list of int or None.

    Examples
    --------
    >>> coded(np.array([0.25, 0.5, np.nan, 0.75]), n_steps=100)
    {'per_unit': 1000, 'steps': [250, 250, None, 250]}
    """
    is_finite = np.isfinite(values)
    kept = np.asarray(values, dtype=np.float64)[is_finite]
    if not len(kept):
        return {"per_unit": 1, "steps": [None] * len(values)}
    extent = float(np.ptp(kept)) or float(abs(kept[0])) or 1.0
    digits = -math.floor(math.log10(extent / n_steps))
    per_unit = 10**digits if digits >= 0 else 10.0**digits
    quanta = np.round(kept * float(per_unit))
    steps = np.diff(quanta, prepend=0.0)
    row: list[int | None] = [None] * len(values)
    for place, step in zip(np.flatnonzero(is_finite), steps.tolist(), strict=True):
        row[place] = int(step)
    return {"per_unit": per_unit, "steps": row}


def _plain(text: str) -> str:
    """Take the marks of mathematical text out of a label."""
    return re.sub(r"\\mathrm|[${}]", "", text)


def _hex(colour: Any) -> str:
    from matplotlib.colors import to_hex

    return to_hex(colour)


def _dash(line: Line2D) -> list[float]:
    """CSS pixels on and off; a pattern of its own counts as dashed."""
    return {"--": [6.0, 3.0], "-.": [6.0, 3.0, 1.5, 3.0], ":": [1.5, 3.0]}.get(str(line.get_linestyle()), [])
