"""The ladder of causes in words and as a figure."""

from __future__ import annotations

import re

import pytest
from sawbench.reporting.closing import closing_picture, closing_rows, closing_sentences

from tests.reporting.test_gap_page import REPORT, page

pytestmark = pytest.mark.unit

FRICTION = {
    "effect": "guide_friction", "pass": 1, "probability": 0.97, "with_effect": 1.0, "gap_closed": 0.75,
    "gap_closed_ci95": [0.6, 0.85], "added": 0.75, "added_ci95": [0.6, 0.85], "carried_by_strokes": False,
    "parameters": {"force_n": {"value": 8.3, "std": 0.4, "unit": "N"}},
}  # fmt: skip
GRAIN = {
    **FRICTION, "effect": "grain_variation", "pass": 2, "added": 0.0, "carried_by_strokes": True,
    "parameters": {"depth": {"value": 0.12, "std": 0.03, "unit": "1"}},
}  # fmt: skip
CLOSING = {
    "stopped": "no_gap", "n_passes": 3, "dropped": [], "nominal": 4.0, "retuned": 2.0, "noise_floor": 0.5,
    "rungs": [FRICTION, GRAIN],
}  # fmt: skip


def test_rows_go_from_the_configured_model_to_the_noise():
    rows = closing_rows(CLOSING)
    assert [row["model"] for row in rows] == [
        "as configured", "re-tuned", "+ guide friction", "+ grain variation", "noise",
    ]  # fmt: skip
    assert [row["rms"] for row in rows] == ["4", "2", "1", "1", "0.5"]
    assert rows[2]["magnitude"] == "force 8.30\xa0±\xa00.40\xa0N"
    assert (rows[2]["closed"], rows[2]["interval"], rows[2]["added"]) == ("75 %", "60 to 85 %", "75 %")
    assert rows[2]["probability"] == "97 %"
    assert rows[3]["added"] == "seen in single strokes"


def test_the_words_say_why_it_ended():
    assert closing_sentences(CLOSING) == ["With these causes in the model, no gap remains."]
    unknown = CLOSING | {"stopped": "unknown", "dropped": ["edge_force"]}
    assert "no effect of the catalogue explains" in closing_sentences(unknown)[0]
    assert closing_sentences(unknown)[1].endswith("dropped: edge force.")
    assert closing_sentences(CLOSING | {"rungs": []}) == ["There is no gap to close."]


def test_the_figure_names_every_model_and_its_residual():
    picture = closing_picture(CLOSING)
    assert picture is not None
    for text in ("as configured: 4", "re-tuned: 2", "+ guide friction: 1", "noise: 0.5"):
        assert text in picture.svg
    assert closing_picture(CLOSING | {"rungs": []}) is None


def test_an_interval_that_nobody_knows_is_neither_drawn_nor_given():
    unknown = CLOSING | {"rungs": [FRICTION | {"gap_closed_ci95": [-1.0, 1.0]}]}
    assert closing_rows(unknown)[2]["interval"] == "not determined"
    known = closing_picture(CLOSING | {"rungs": [FRICTION]})
    drawn = closing_picture(unknown)
    assert known is not None
    assert drawn is not None
    # Lines in the colour of causes, one a row: that of a cause is as long as its interval.
    assert [len(set(ends)) for ends in lines(known.svg)] == [1, 1, 2]
    assert [len(set(ends)) for ends in lines(drawn.svg)] == [1, 1, 1]


def lines(svg: str) -> list[tuple[str, ...]]:
    """Abscissas of both ends of every line in the colour of causes."""
    return re.findall(r'<path d="M ([\d.]+) [\d.]+ \nL ([\d.]+) [\d.]+ \n"[^>]*stroke: #00507f', svg)


def test_the_page_has_the_ladder_only_where_it_was_asked_for(tmp_path):
    folders = [tmp_path / name for name in ("plain", "closed")]
    for folder in folders:
        folder.mkdir()
    plain, text = page(folders[0]), page(folders[1], until_closed=CLOSING)
    assert "Causes, added one by one" not in plain
    assert "<h2>Causes, added one by one</h2>" in text
    assert text.index("Causes, added one by one") < text.index("<h2>Causes</h2>")
    assert text.count("<svg role") == plain.count("<svg role") + 1
    assert "until_closed" not in REPORT
    shown = re.sub(r"<(style|script|svg).*?</\1>|<[^>]*>", "", text, flags=re.DOTALL)
    assert re.search(r"\d %", shown) and not re.search(r"\d%", shown)
