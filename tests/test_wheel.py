"""What is installed: the package and nothing beside it, and no folder of the user's gets in its way."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from sawbench import PACKAGES

ROOT = Path(__file__).parents[1]


@pytest.mark.contract
def test_folders_named_like_ours_break_nothing(tmp_path):
    for name in ("commands", "reporting", "bench"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text('raise SystemExit("the wrong folder was imported")\n')
    done = subprocess.run(
        [sys.executable, "-m", "sawbench.commands.main", "machines"], cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path)}, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert "paper_jigsaw" in done.stdout


@pytest.mark.slow
@pytest.mark.contract
def test_a_wheel_holds_the_package_and_nothing_else(tmp_path):
    pytest.importorskip("setuptools", minversion="77")  # as pyproject.toml asks for to build
    source = tmp_path / "source"
    ignored = shutil.ignore_patterns(
        ".*", "build", "*.egg-info", "__pycache__", "tests", "docs", "recordings", "benchmarks"
    )
    shutil.copytree(ROOT, source, ignore=ignored)
    command = [sys.executable, "-c", "from setuptools import build_meta; build_meta.build_wheel('.')"]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    (wheel,) = source.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"sawbench"}
    inside = {name.split("/")[1] for name in names if name.startswith("sawbench/") and name.count("/") > 1}
    assert inside == {*PACKAGES, *(path.parent.name for path in (ROOT / "api").glob("*/__init__.py"))}
    ends = {Path(name).suffix for name in names if name.startswith("sawbench/")}
    assert ends == {".py", ".pyi", ".proto", ".dbc", ".toml", ".j2", ".css", ".js", ".LICENSE"}
