"""The data of a figure for the script of the pages: what was drawn, no more and no less."""

from __future__ import annotations

import html
import json
import re

import numpy as np
import pytest
from matplotlib.figure import Figure
from sawbench.reporting.charts import chart_data, coded
from sawbench.reporting.html import Picture, figure_to_svg, still_svg
from sawbench.reporting.spots import Spot

pytestmark = pytest.mark.unit


def decoded(given):
    """As the script does it: a running sum of whole steps."""
    total, found = 0, []
    for step in given["steps"]:
        total += step or 0
        found.append(np.nan if step is None else total / given["per_unit"])
    return np.array(found)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 3e7])
@pytest.mark.parametrize("offset", [0.0, 1e4])
def test_numbers_survive_their_way_into_the_page(scale, offset):
    values = scale * (offset + np.random.default_rng(1).normal(size=500).cumsum())
    values[[3, 77, 78]] = np.nan
    found = decoded(json.loads(json.dumps(coded(values, n_steps=2e4))))
    np.testing.assert_array_equal(np.isnan(found), np.isnan(values))
    assert np.nanmax(np.abs(found - values)) <= np.ptp(values[np.isfinite(values)]) / 2e4


def test_lines_bands_guides_and_texts_are_told_as_they_were_drawn():
    figure = Figure()
    upper, lower = figure.subplots(2, 1, sharex=True)
    angle = np.linspace(0.0, 360.0, 50)
    upper.plot(angle, np.sin(angle), color="#112233", label="measured")
    upper.fill_between(angle, np.sin(angle) - 1, np.sin(angle) + 1, color="#112233", alpha=0.2)
    upper.axvline(90.0, color="#445566")
    upper.axvspan(10.0, 20.0, color="#eeeeee")
    upper.text(180.0, 0.0, "turning point")
    upper.text(1.0, 1.02, "0.2 → 0.1 N", transform=upper.transAxes)
    lower.plot(angle, angle**2, color="#112233")
    lower.set_xlabel("crank angle / °")
    figure.draw_without_rendering()
    found = chart_data(figure)
    first, second = found["panels"]
    assert found["n_columns"] == 1
    assert first["group"] == second["group"]
    assert [one["label"] for one in first["series"] + second["series"]] == ["measured", "measured"]
    np.testing.assert_allclose(decoded(first["series"][0]["y"]), np.sin(angle), atol=1e-4)
    band, span = first["shapes"]
    assert (band["label"], band["is_span"], span["is_span"]) == ("measured", False, True)
    height = decoded(band["paths"][0][1])
    assert (height.min(), height.max()) == pytest.approx((np.sin(angle).min() - 1, np.sin(angle).max() + 1), abs=1e-3)
    assert [(one["axis"], one["at"]) for one in first["guides"]] == [("x", 90.0)]
    assert first["texts"][0]["text"] == "turning point"
    assert first["texts"][0]["x"] == pytest.approx(180.0, abs=2.0)
    assert (first["note"], second["note"]) == ("0.2 → 0.1 N", "")
    assert (second["x"]["name"], second["x"]["unit"], second["x"]["is_angle"]) == ("crank angle", " °", True)


def test_bars_cells_and_places_on_words_stay_drawings():
    bars, cells, words, loop = (Figure() for _ in range(4))
    bars.subplots().bar([1, 2], [3, 4])
    cells.subplots().pcolormesh(np.eye(3))
    axes = words.subplots()
    axes.plot([1.0, 2.0], [0, 1], "o")
    axes.set_yticks([0, 1], ["oak", "pine"])
    loop.subplots().plot([0.0, 1.0, 0.5], [0.0, 1.0, 2.0])
    assert [chart_data(figure) for figure in (bars, cells, words, loop)] == [None] * 4


def test_finer_points_reach_the_page_and_a_still_drawing_has_none():
    figure = Figure()
    (line,) = figure.subplots().plot([0.0, 1.0], [0.0, 1.0], label="it's <b> & more")
    fine = np.linspace(0.0, 1.0, 101)
    svg = figure_to_svg(figure, name="a", title="A title", description="What it shows", finer={line: (fine, fine**2)})
    (data,) = re.findall(r"data-chart='([^']*)'", svg)
    (series,) = json.loads(html.unescape(data))["panels"][0]["series"]
    np.testing.assert_allclose(decoded(series["y"]), fine**2, atol=1e-4)
    assert series["label"] == "it's <b> & more"
    still = still_svg(Picture(svg=svg, caption=""))
    assert "data-chart" not in still
    assert len(still) == len(svg) - len(f" data-chart='{data}'")


def test_a_bar_says_its_value_where_it_was_drawn():
    figure = Figure(figsize=(2.0, 1.0))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.barh([0, 1], [4.0, 8.0])
    axes.set(xlim=(0.0, 10.0), ylim=(1.5, -0.5))
    spot = Spot(axes=axes, x=(0.0, 4.0), y=(-0.5, 0.5), text="force < 4 N")
    svg = str(figure_to_svg(figure, name="b", title="t", description="d", spots=[spot]))
    # Two by one inch is 144 by 72 points; four tenths of the width, and the upper half, counted from the top.
    assert '<rect x="0.00" y="0.00" width="57.60" height="36.00"><title>force &lt; 4 N</title></rect></g></svg>' in svg
    assert "data-chart" not in svg
    assert "spots" not in figure_to_svg(figure, name="b", title="t", description="d")


def test_error_bars_carry_the_name_of_their_line():
    figure = Figure()
    axes = figure.subplots()
    axes.errorbar([0, 1], [0, 1], yerr=[0.1, 0.1], capsize=2, label="blade B1")
    axes.plot([0, 1], [1, 0], label="other")
    figure.canvas.draw()
    (panel,) = chart_data(figure)["panels"]
    assert [one["label"] for one in panel["series"]] == ["blade B1", "other"]
