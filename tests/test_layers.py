"""The layers of the house, checked by machine."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from sawbench import PACKAGES

pytestmark = pytest.mark.contract

ROOT = Path(__file__).parents[1]


def test_import_contracts_hold(tmp_path):
    # import-linter reads folders: it needs the packages where an installation has them, not where the checkout has.
    sources = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "api", tmp_path / "sawbench", ignore=sources)
    for name in PACKAGES:
        shutil.copytree(ROOT / name, tmp_path / "sawbench" / name, ignore=sources)
    result = subprocess.run(
        [
            sys.executable,
            "-c",
            "from importlinter.cli import lint_imports_command; lint_imports_command()",
            "--no-cache",
        ],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert "0 broken" in result.stdout


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from sawbench.commands.main import main; main(['--help']);"
        "heavy = {'scipy', 'numba', 'pandas', 'rerun', 'numpy', 'matplotlib', 'asammdf', 'pydantic'};"
        "heavy &= set(sys.modules);"
        "sys.exit('imported: ' + ', '.join(sorted(heavy)) if heavy else 0)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert result.returncode == 0, result.stderr
    assert "Commands:" in result.stdout


def test_recordings_hold_no_code():
    assert not list((ROOT / "recordings").rglob("*.py"))


def test_modules_stay_readable():
    too_long = [
        f"{path.relative_to(ROOT)}: {n_lines} lines"
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if not path.name.endswith("_pb2.py") and (n_lines := len(path.read_text().splitlines())) > 500
    ]
    assert not too_long


def test_the_shipped_configuration_is_the_one_at_the_top_level():
    shipped = (ROOT / "bench" / "default_config.toml").read_bytes()
    assert shipped == (ROOT / "bench_config.toml").read_bytes()


def test_every_package_is_installed():
    with (ROOT / "pyproject.toml").open("rb") as file:
        listed = set(tomllib.load(file)["tool"]["setuptools"]["packages"])
    there = {
        "sawbench." + path.parent.relative_to(ROOT).as_posix().replace("/", ".")
        for package in PACKAGES
        for path in (ROOT / package).rglob("__init__.py")
    }
    assert listed == there | {"sawbench", "sawbench.archive"}  # both in api


def test_a_folder_of_the_same_name_breaks_nothing(tmp_path):
    (tmp_path / "commands").mkdir()
    (tmp_path / "commands" / "__init__.py").write_text("raise ImportError('not this one')\n")
    result = subprocess.run(
        [sys.executable, "-m", "sawbench.commands.main", "--version"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
