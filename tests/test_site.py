"""The documentation site: its made pages hold the whole program, and its menu every page."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from sawbench.commands.main import SUBCOMMANDS

pytestmark = pytest.mark.contract

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def pages():
    spec = importlib.util.spec_from_file_location("site_pages", ROOT / "docs" / "site_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_page_stands_in_the_menu_once():
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    listed = re.findall(r": (\S+\.md)$", menu, flags=re.MULTILINE)
    made = {"tutorial.md", "reference/commands.md", "reference/configuration.md", "reference/python.md"}
    written = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert sorted(listed) == sorted(made | written)


def test_the_help_of_every_command_is_there(pages):
    text = pages.commands_page()
    headings = re.findall(r"^#+ (sawbench .+)$", text, flags=re.MULTILINE)
    assert [name for name in SUBCOMMANDS if f"sawbench {name}" not in headings] == []
    assert "sawbench series plan" in headings and "sawbench blind score" in headings
    assert "Example: sawbench init workshop" in text


def test_every_key_of_the_shipped_configuration_is_explained(pages):
    text = pages.configuration_page()
    tables = tomllib.loads((ROOT / "bench_config.toml").read_text(encoding="utf-8"))
    devices = tables.pop("devices")
    keys = {key for table in tables.values() for key in table} | {key for table in devices.values() for key in table}
    assert [key for key in sorted(keys) if f"| `{key}` |" not in text] == []
    assert "| `seconds` | number | above 0 | `10.0` |" in text
    assert "| `capacity_ah` | number | above 0 | required |" in text
    assert "| `cutting_half` | `pi_to_2pi` or `zero_to_pi` |" in text
    assert "`sawbench init` writes it" in text


def test_the_tutorial_is_the_notebook(pages):
    text = pages.tutorial_page()
    assert "```python\ncomparison = sawbench.compare(RECORDINGS)" in text
    assert text.startswith("# ")


def test_named_pages_become_links(pages):
    assert (
        pages.linked("`docs/series.md`, `docs/nothing.md`", "index.md") == "[series.md](series.md), `docs/nothing.md`"
    )
    assert pages.linked("`docs/paper.md`", "decisions/0001-one-package.md") == "[paper.md](../paper.md)"


def test_the_modules_of_the_python_page_exist(pages):
    named = re.findall(r"^::: (\S+)$", pages.python_page(), flags=re.MULTILINE)
    assert named and [name for name in named if importlib.util.find_spec(name) is None] == []


def is_laid_out() -> bool:
    """Whether the packages lie below that of `sawbench`: not so in the default editable install (CONTRIBUTING.md)."""
    spec = importlib.util.find_spec("sawbench")
    return any((Path(folder) / "bench").exists() for folder in spec.submodule_search_locations)


@pytest.mark.slow
@pytest.mark.skipif(not is_laid_out(), reason="needs the strict editable install, or one that is not editable")
@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="needs the extra `docs`")
def test_the_site_builds_without_a_warning_and_asks_no_network(tmp_path):
    site = tmp_path / "site"
    call = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    loaded = re.compile(r"<(?:script|img|link)[^>]+(?:src|href)=\"(https?://[^\"]+)")
    outside = {u for p in site.rglob("*.html") for u in loaded.findall(p.read_text(encoding="utf-8"))}
    assert not outside
    shutil.rmtree(site)
