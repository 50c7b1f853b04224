"""What the pages say about the repository is true, and in plain words."""

from __future__ import annotations

import re
import tomllib
from datetime import date
from pathlib import Path

import pytest
from sawbench import PACKAGES

pytestmark = pytest.mark.contract

ROOT = Path(__file__).parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
DECISIONS = sorted((ROOT / "docs" / "decisions").glob("*.md"))
# Pages of the site that docs/site_pages.py makes.
MADE = {"tutorial.md", "reference/commands.md", "reference/configuration.md", "reference/python.md"}
FOLDERS = (*PACKAGES, "api", "docs", "tests", "benchmarks", "recordings")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_path_that_a_page_names_exists(page):
    named = re.findall(rf"`((?:{'|'.join(FOLDERS)})/[\w./-]*)", page.read_text(encoding="utf-8"))
    missing = [path for path in named if not (ROOT / path.rstrip(".")).exists() and not (ROOT / f"{path}.py").exists()]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_to_a_file_leads_somewhere(page):
    links = re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8"))
    assert not [link for link in links if link not in MADE and not (page.parent / link).exists()]


def test_decisions_are_numbered_without_a_hole():
    assert [path.name[:4] for path in DECISIONS] == [f"{number:04}" for number in range(1, len(DECISIONS) + 1)]


@pytest.mark.parametrize("path", DECISIONS, ids=lambda path: path.stem)
def test_a_decision_states_number_date_and_status(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith(f"# {path.name[:4]}: ")
    date.fromisoformat(lines[2].removeprefix("- Date: "))
    assert re.match(r"- Status: (accepted|superseded)\b", lines[3])
    for number in re.findall(r"\b0\d{3}\b", lines[3]):
        assert any(other.name.startswith(number) for other in DECISIONS), f"status names decision {number}"


def test_every_dependency_has_its_reason():
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)["project"]
    asked = project["dependencies"] + [row for rows in project["optional-dependencies"].values() for row in rows]
    names = {re.split(r"[\[><=]", row)[0] for row in asked} - {"sawbench"}
    page = (ROOT / "docs" / "decisions" / "0002-dependencies.md").read_text(encoding="utf-8")
    rows = " ".join(line.split("|")[1] for line in page.splitlines() if line.startswith("| "))
    assert not sorted(name for name in names if not re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", rows))
