"""The panel as an operator uses it, in a headless Chromium: from the check to the diagnosis."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from sawbench.storage.amendments import read_amendments
from sawbench.storage.reader import read_recording

from tests.panel.operator_page import OperatorPage
from tests.rigs.browser import CHROMIUM

pytest.importorskip("starlette", reason="the panel needs sawbench[panel]")
pytest.importorskip("uvicorn", reason="the panel needs sawbench[panel]")
pytestmark = [pytest.mark.pipeline, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")]

ROOT = Path(__file__).parents[2]


@pytest.fixture
def bench(tmp_path):
    """A folder with a configuration and sample recordings, and the panel that serves it."""
    (tmp_path / "recordings").mkdir()
    for name in ("none-01", "oak-01", "oak-02", "nylon-01", "nylon-02"):
        shutil.copy(ROOT / "recordings" / f"{name}.mcap", tmp_path / "recordings")
    shutil.copy(ROOT / "bench_config.toml", tmp_path)
    call = [sys.executable, "-m", "sawbench.commands.main", "panel", "--simulated", "--port", "0", "--no-browser"]
    panel = subprocess.Popen(call, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    try:
        assert panel.stdout is not None
        said = panel.stdout.readline()
        yield tmp_path, said.split("operator panel: ")[1].strip().rstrip("/"), panel
    finally:
        panel.terminate()
        panel.communicate(timeout=60)


@pytest.fixture
def page(bench, tmp_path_factory):
    found = OperatorPage(tmp_path_factory.mktemp("profile"))
    yield found
    found.close()


def fill(page: OperatorPage, **fields: str) -> None:
    page.run(f"for (const [name, value] of Object.entries({json.dumps(fields)}))"
               " document.querySelector(`main [name=\"${name}\"]`).value = value; 0")  # fmt: skip


def go(page: OperatorPage) -> str:
    """Press the main button of the page by its access key, and wait for the page of the job."""
    before = page.run("location.href")
    page.access_key("g")
    page.wait_for(f"location.href !== {json.dumps(before)} && document.readyState === 'complete'")
    return page.run("location.pathname")


def ended(page: OperatorPage) -> str:
    page.wait_for("document.readyState === 'complete' && document.querySelector('#step .state') !== null"
                  " && document.querySelector('#step .state').textContent !== 'running'")  # fmt: skip
    return page.run("document.querySelector('#step .state').textContent")


def looked_at(page: OperatorPage) -> None:
    """No page may have a serious finding of axe, or be wider than the window."""
    page.size(390)
    assert page.run("document.documentElement.scrollWidth") <= 390
    page.size(1280)
    assert page.run("document.documentElement.scrollWidth") <= 1280
    assert page.axe() == []


def quiet(page: OperatorPage, address: str) -> None:
    assert page.all_complaints == []
    assert [asked for asked in page.all_requests if not asked.startswith((f"{address}/", "data:", "about:"))] == []


def test_every_page_is_quiet_and_accessible(bench, page):
    folder, address, _ = bench
    for path in ("/", "/record", "/series", "/recordings", "/recordings?q=oak", "/recording?file=oak-01.mcap", "/jobs"):
        page.open(address + path)
        looked_at(page)
    quiet(page, address)
    # A correction: kept beside the recording, which is as it was, and shown.
    page.open(f"{address}/recording?file=oak-01.mcap")
    fill(page, duty="0.5", by="Kim", because="mistyped")
    page.run("document.querySelector('form[action=\"/amend\"] button').click(); 0")
    page.wait_for("document.body.innerText.includes('duty 0.5 instead of 0.4375 (Kim, ')")
    (made,) = read_amendments(folder / "recordings" / "oak-01.mcap")
    assert (made.by, made.because, made.new) == ("Kim", "mistyped", {"duty": 0.5})
    page.open(f"{address}/recordings?q=corrected")
    assert page.run("document.querySelectorAll('tbody tr').length") == 1
    quiet(page, address)


@pytest.mark.slow
def test_from_the_tare_to_the_diagnosis(bench, page):
    folder, address, _ = bench
    # Check and tare.
    page.open(address)
    go(page)
    assert ended(page) == "done"
    assert "No faults" in page.run("document.body.innerText")
    page.open(address)
    fill(page, operator="Kim", seconds="2")
    page.run("document.querySelector('form[action=\"/tare\"] button').click(); 0")
    page.wait_for("location.pathname.endsWith('-tare')")
    assert ended(page) == "done"
    page.open(address)
    assert "force_n: tare of" in page.run("document.body.innerText")
    # A series: its plan, its questions, keep.
    page.open(f"{address}/series")
    fill(page, name="wood", materials="oak", repetitions="1", seconds="4", operator="Kim")
    assert go(page) == "/series/wood.toml"
    looked_at(page)
    go(page)
    asked = []
    while True:
        page.wait_for("document.querySelector('#step [name=number]') || document.querySelector('#step .state')"
                      ".textContent !== 'running'")  # fmt: skip
        number = page.run("document.querySelector('#step [name=number]')?.value")
        if number is None:
            break
        asked.append(page.run("document.querySelector('.question legend, .question label').textContent"))
        page.access_key("g")
        page.wait_for(f"document.querySelector('#step [name=number]')?.value !== {json.dumps(number)}")
    assert [text.split(";")[0].split(":")[0] for text in asked] == [
        "Mount a new blade", "Insert a full battery", "Everything ready?", "Keep this trial, or repeat it?",
    ]  # fmt: skip
    assert ended(page) == "done"
    said = page.run("document.getElementById('log').textContent")
    assert "Answer: keep" in said and "Enter" not in said and "Ctrl-C" not in said
    # The form that repeats a kept trial has words for screen readers alone: they may not widen the page.
    page.open(f"{address}/series/wood.toml")
    assert "Repeat" in page.run("document.querySelector('td button').textContent")
    looked_at(page)
    (recorded,) = (folder / "recordings" / "wood").glob("*.mcap")
    assert read_recording(recorded).trial.operator == "Kim"
    # A trial: live numbers, a note, stop; its result; the panel does not know the next page.
    page.open(f"{address}/record")
    fill(page, material="nylon", seconds="60", operator="Kim")
    go(page)
    page.wait_for("parseFloat(document.getElementById('clock')?.textContent) > 4")
    assert page.run("document.querySelector('#plot canvas') !== null")
    assert page.run("['OK', 'LOOK', 'STOP'].includes(document.getElementById('light').textContent)")
    page.access_key("n")
    page.type("clamp checked")
    page.press("Enter", code=13, text="\r")
    page.wait_for("document.querySelector('.said').textContent === 'Note stored: clamp checked'")
    looked_at(page)
    page.access_key("x")
    assert ended(page) == "done"
    page.wait_for("document.querySelector('#step .lead') !== null")
    assert "nylon" in page.run("document.querySelector('#step .lead').textContent")
    looked_at(page)
    recording = read_recording(folder / "recordings" / "nylon-03.mcap")
    assert recording.is_complete
    assert [event.text for event in recording.events if event.kind == "note"] == ["clamp checked"]
    assert max(signal.time_s[-1] for signal in recording.signals.values()) < 50.0
    # Compare and diagnose.
    for button, result in (
        ('form[action="/compare"] button', "comparison.html"),
        ('button[formaction="/diagnose"]', "gap/gap_report.html"),
    ):
        page.open(f"{address}/recordings")
        page.run("for (const name of ['none-01', 'oak-01', 'oak-02', 'nylon-01', 'nylon-02'])"
                   " document.querySelector(`input[value=\"${name}.mcap\"]`).checked = true; 0")  # fmt: skip
        page.run(f"document.querySelector('{button}').click(); 0")
        page.wait_for("location.pathname.startsWith('/jobs/')")
        assert ended(page) == "done"
        looked_at(page)
        href = page.run(f"document.querySelector('#step a[href$=\"{result}\"]').href")
        page.open(href)
        assert re.search("oak|cause|model", page.run("document.body.innerText"))
    quiet(page, address)


@pytest.mark.slow
def test_a_recording_goes_on_when_the_panel_is_killed(bench, page):
    folder, address, panel = bench
    page.open(f"{address}/record")
    fill(page, material="oak", seconds="8", trial="kept")
    job = go(page).rsplit("/", 1)[1]
    page.wait_for("parseFloat(document.getElementById('clock')?.textContent) > 1")
    panel.kill()
    until_s = time.monotonic() + 120.0
    while not (folder / "recordings" / "panel" / job / "exit.json").exists():
        assert time.monotonic() < until_s
        time.sleep(0.1)
    recording = read_recording(folder / "recordings" / "kept.mcap")
    assert recording.is_complete
    assert max(signal.time_s[-1] for signal in recording.signals.values()) > 7.9
