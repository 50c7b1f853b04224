"""Pages that need nothing but themselves: no network, no font to fetch, and readable without their script."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from sawbench.bench.recording import Floats
from sawbench.reporting.charts import chart_data
from sawbench.reporting.spots import Spot, spots_svg

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_FOLDER = Path(__file__).parent
_ASSETS = _FOLDER / "assets"
_UPLOT_LICENCE = "uPlot, MIT licence, copyright (c) 2022 Leon Sorokin; its full text: reporting/assets/uPlot.LICENSE"
_CHART = re.compile(r" data-chart='[^']*'")


@dataclass(frozen=True, kw_only=True, slots=True)
class Picture:
    """A figure, ready for a page.

    Attributes
    ----------
    svg : Markup
        Inline SVG with a title and a description, and its data for the script of the page where it is a plot of lines.
    caption : str
        One or two sentences under the figure.
    """

    svg: Markup
    caption: str


def figure_to_svg(
    figure: Figure,
    *,
    name: str,
    title: str,
    description: str,
    finer: Mapping[Line2D, tuple[Floats, Floats]] | None = None,
    spots: Iterable[Spot] = (),
) -> Markup:
    """Turn a figure into inline SVG that a screen reader can announce and the script of a page can zoom.

    The same figure gives the same bytes: no date, and identifiers made from the content and `name`.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    name : str
        Unique within the page; letters, digits and "-".
    title, description : str
        What the figure is, and what it shows, in words.
    finer : mapping of Line2D to (x, y), optional
        More points of a line than are drawn, for whoever zooms in.
    spots : iterable of Spot, optional
        Areas that say their values under the pointer, for a drawing that is no plot of lines.
    """
    import matplotlib as mpl
    from markupsafe import Markup

    buffer = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": name, "svg.fonttype": "none", "path.simplify": True}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    body = svg[svg.index(">") + 1 :]
    view_box = re.search(r'viewBox="([^"]+)"', svg)
    assert view_box is not None, "matplotlib always writes a viewBox"
    body = re.sub(r"\s*<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = body.replace("xlink:href", "href")
    body = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', body)
    body = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', body)
    body = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", body)
    body = re.sub(r"\n\s*", "\n", body)
    chart = chart_data(figure, finer)
    # Between single quotes: the many double ones of JSON stay as they are.
    text = "" if chart is None else escape(json.dumps(chart, separators=(",", ":")), quote=False).replace("'", "&#39;")
    data = f" data-chart='{text}'" if text else ""
    head = (
        f'<svg role="img" viewBox="{view_box[1]}" aria-labelledby="{name}-title {name}-desc"{data}>'
        f'<title id="{name}-title">{escape(title)}</title><desc id="{name}-desc">{escape(description)}</desc>'
    )
    body = body.strip().removesuffix("</svg>") + spots_svg(figure, spots) + "</svg>"
    return Markup(head + body)


def still_svg(picture: Picture) -> str:
    """Return the drawing of a picture without the data for the script of a page: for a file, for a notebook."""
    return _CHART.sub("", str(picture.svg), count=1)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["set_text"] = set_text
    plots = (_ASSETS / "uPlot.min.css").read_text(encoding="utf-8")
    environment.globals["css"] = plots + "\n" + (_FOLDER / "style.css").read_text(encoding="utf-8")
    script = "".join((_ASSETS / name).read_text(encoding="utf-8") for name in ("uPlot.iife.min.js", "charts.js"))
    environment.globals["script"] = f"/* {_UPLOT_LICENCE} */\n{script}"
    digest = hashlib.sha256(environment.globals["script"].encode()).digest()
    environment.globals["script_hash"] = f"sha256-{base64.b64encode(digest).decode()}"
    environment.globals["version"] = software_version()
    return environment


def set_text(page: Markup) -> Markup:
    """Keep a percent sign with its number, and show what stands between backquotes as something to type.

    Examples
    --------
    >>> from markupsafe import Markup
    >>> print(set_text(Markup("<p title='5 %'>run `sawbench fit`</p>")))
    <p title='5 %'>run <code>sawbench fit</code></p>
    """
    from markupsafe import Markup

    def of_node(found: re.Match[str]) -> str:
        text = re.sub(r"(?<=\d) %", "\N{NO-BREAK SPACE}%", found[0])
        return re.sub(r"`([^`]+)`", r"<code>\1</code>", text)

    return Markup(re.sub(r">[^<>]+", of_node, page))


def software_version() -> str:
    """Return "sawbench X.Y.Z", or just the name where the package is not installed."""
    try:
        return f"sawbench {metadata.version('sawbench')}"
    except metadata.PackageNotFoundError:
        return "sawbench"


def render(template: str, context: Mapping[str, Any]) -> str:
    """Fill a template of this folder; every value is escaped."""
    return _environment().get_template(template).render(**context)


def link_to(target: str | Path, page: str | Path) -> tuple[str, str]:
    """Return the link from a page to a file beside it, and the text to show.

    Returns
    -------
    href, text : str
        `href` is empty where no relative link exists (another drive).
    """
    try:
        relative = os.path.relpath(Path(target).resolve(), Path(page).resolve().parent)
    except ValueError:
        return "", str(target)
    return quote(Path(relative).as_posix()), Path(relative).as_posix()
