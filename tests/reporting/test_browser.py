"""The pages in a browser: zoom, values and toggles, every width, light, dark and paper, and an accessibility check."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.reporting.blind_page import write_blind_page
from sawbench.reporting.compared import LeftOut
from sawbench.reporting.comparison_page import write_comparison_page
from sawbench.reporting.gap_page import write_gap_page
from sawbench.reporting.trial_page import write_trial_page

from tests.reporting.test_gap_page import CAUSE, REPORT
from tests.reporting.test_pages import full_report, make_rows
from tests.rigs.browser import CHROMIUM, Browser

pytestmark = [pytest.mark.pipeline, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")]

ROOT = Path(__file__).parents[2]
AXE = Path(__file__).parent / "axe.min.js"
NAMES = ("trial", "comparison", "gap", "blind")
MAX_PAGE_BYTES = 6_000_000


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Each kind of page."""
    folder = tmp_path_factory.mktemp("pages")
    duty = LeftOut(
        name="black_locust-02", reason="k_Fc not used: a channel or the configuration contradicts the model",
        cause="wrong duty entered: 0.4375 is stated, the currents (battery over motor) show 0.5",
        remedy="`sawbench amend recordings/black_locust-02.mcap --duty 0.5`, which does not change the recording",
    )  # fmt: skip
    likely = [*CAUSE["indistinguishable_from"], *(name for name in EFFECT_BY_NAME if name != "windage_drag")]
    gap = {**REPORT, "causes": [{**CAUSE, "indistinguishable_from": likely}]}
    blind = json.loads((ROOT / "docs" / "blind_result.json").read_text(encoding="utf-8"))
    return {
        "trial": write_trial_page(folder / "trial.html", full_report()),
        "comparison": write_comparison_page(folder / "comparison.html", make_rows(), left_out=[duty]),
        "gap": write_gap_page(folder / "gap.html", gap),
        "blind": write_blind_page(folder / "blind.html", blind),
    }


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    found = Browser(tmp_path_factory.mktemp("profile"))
    yield found
    found.close()


def test_the_browser_reports_complaints_and_requests(browser, tmp_path):
    page = tmp_path / "control.html"
    page.write_text("<script>console.error('control')</script><img src='missing.png'>")
    browser.open(page)
    assert any("control" in one for one in browser.complaints)
    assert browser.requests == [(tmp_path / "missing.png").as_uri()]


@pytest.mark.parametrize("name", NAMES)
def test_a_page_is_accessible_at_every_width_and_asks_for_nothing(browser, pages, name):
    assert pages[name].stat().st_size < MAX_PAGE_BYTES
    for width, is_dark in ((1280, False), (390, True)):
        browser.open(pages[name], width=width, is_dark=is_dark)
        assert (browser.complaints, browser.requests) == ([], [])
        assert browser.run("document.documentElement.scrollWidth") <= width
        browser.run(AXE.read_text(encoding="utf-8"))
        found = browser.run("axe.run().then(r => r.violations.map(v => [v.id, v.impact, v.nodes.map(n => n.html)]))")
        assert [one for one in found if one[1] in {"serious", "critical"}] == []


def place_of(browser, selector):
    return browser.run(
        f"(() => {{ const e = document.querySelector('{selector}'); e.scrollIntoView({{block: 'center'}});"
        " const r = e.getBoundingClientRect(); return [r.left, r.top, r.width, r.height]; })()"
    )


def seen(browser, *selectors):
    return [
        browser.run(f"getComputedStyle(document.querySelector('{selector}')).display !== 'none'")
        for selector in selectors
    ]


def test_a_plot_is_read_off_zoomed_and_reset(browser, pages):
    browser.open(pages["trial"])
    at_s = "document.querySelector('.chart-at').textContent"
    left, top, width, height = place_of(browser, ".chart .u-over")
    middle = top + height / 2
    browser.mouse("mouseMoved", left + 0.25 * width, middle)
    start_s = float(browser.run(at_s).split()[1])
    browser.mouse("mousePressed", left + 0.25 * width, middle)
    browser.mouse("mouseMoved", left + 0.5 * width, middle, buttons=1)
    end_s = float(browser.run(at_s).split()[1])
    browser.mouse("mouseReleased", left + 0.5 * width, middle)
    browser.mouse("mouseMoved", left + 0.5 * width, middle)
    assert float(browser.run(at_s).split()[1]) == pytest.approx(0.5 * (start_s + end_s), abs=2e-3)
    # The signal is sin(80 t), and the panel below it follows.
    value = browser.run("document.querySelector('.chart-value').textContent").split()
    at_all = browser.run(
        "[...document.querySelectorAll('.chart')[0].querySelectorAll('.chart-at')].map(e => e.textContent)"
    )
    assert len(set(at_all)) == 1
    assert value[1] == "N"
    assert float(value[0]) == pytest.approx(math.sin(80.0 * float(at_all[0].split()[1])), abs=0.05)
    browser.run("[...document.querySelectorAll('.chart-tools button')].find(b => b.textContent === 'Show all').click()")
    browser.mouse("mouseMoved", left + 0.25 * width + 1, middle)
    browser.mouse("mouseMoved", left + 0.25 * width, middle)
    assert float(browser.run(at_s).split()[1]) == pytest.approx(start_s, abs=2e-3)


def test_a_line_is_hidden_by_its_name_and_keys_move_the_cursor(browser, pages):
    browser.open(pages["trial"])
    figure = "document.querySelector('.chart-toggle').closest('.chart')"
    painted = f"[...{figure}.querySelectorAll('canvas')].map(c => c.toDataURL())"
    pressed = f"[...{figure}.querySelectorAll('.chart-toggle')].map(b => b.ariaPressed)"
    settle = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))"
    before = browser.run(painted)
    assert set(browser.run(pressed)) == {"true"}
    browser.run("document.querySelector('.chart-toggle').click()")
    browser.run(settle)
    assert browser.run(pressed)[0] == "false"
    assert browser.run(painted) != before
    browser.run("document.querySelector('.chart-toggle').click()")
    browser.run(settle)
    assert browser.run(pressed)[0] == "true"
    assert browser.run(painted) == before
    browser.run("document.querySelector('.chart-tools button').focus()")
    for _ in range(2):
        browser.ask("Input.dispatchKeyEvent", type="keyDown", key="ArrowRight")
    assert browser.run("document.querySelector('.chart-at').textContent").startswith("time ")


def test_bars_and_cells_say_their_values_under_the_pointer(browser, pages):
    browser.open(pages["gap"])
    says = "(e => e.hidden ? null : e.textContent)(document.querySelector('.spot-tip'))"
    assert browser.run(says) is None
    left, top, width, height = place_of(browser, "#ladder-title ~ .spots rect")
    browser.mouse("mouseMoved", left + width / 2, top + height / 2)
    row = REPORT["gap"]["by_channel"]
    first = next(iter(row))
    shown = browser.run(says)
    assert shown.startswith(f"{first.rsplit('_', 1)[0].replace('_', ' ')}, as configured: ")
    assert float(shown.split(": ")[1].split()[0]) == pytest.approx(row[first]["nominal"], rel=0.01)
    browser.mouse("mouseMoved", 2, 2)
    assert browser.run(says) is None


def test_paper_and_a_page_without_script_show_the_drawing(browser, pages):
    browser.open(pages["trial"])
    assert seen(browser, ".chart", "svg.replaced") == [True, False]
    browser.open(pages["trial"], media="print")
    assert seen(browser, ".chart", "svg.replaced") == [False, True]
    browser.ask("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(pages["trial"], waits_for_drawing=False)
        root = browser.ask("DOM.getDocument", depth=1)["root"]["nodeId"]
        drawn = browser.ask("DOM.querySelectorAll", nodeId=root, selector="figure svg")["nodeIds"]
        assert len(drawn) >= 5
        assert not browser.ask("DOM.querySelectorAll", nodeId=root, selector="svg.replaced, .chart")["nodeIds"]
        assert browser.ask("DOM.getBoxModel", nodeId=drawn[0])["model"]["height"] > 100
    finally:
        browser.ask("Emulation.setScriptExecutionDisabled", value=False)


PAPER_PX = 680


def test_paper_breaks_no_number_and_opens_what_is_closed(browser, pages):
    browser.open(pages["comparison"], width=PAPER_PX, media="print")
    lines = browser.run(
        "[...document.querySelectorAll('table.facts-table td')].filter(e => e.textContent === '0.4375').map(e =>"
        " { const text = document.createRange(); text.selectNodeContents(e); return text.getClientRects().length; })"
    )
    assert lines and set(lines) == {1}
    closed = "(e => e.offsetHeight > 2 * e.querySelector('summary').offsetHeight)(document.querySelector('details'))"
    browser.open(pages["gap"])
    assert browser.run(closed) is False
    browser.open(pages["gap"], width=PAPER_PX, media="print")
    assert browser.run(closed) is True
