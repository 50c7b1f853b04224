"""The layers of the house, checked by machine."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_import_contracts_hold():
    result = subprocess.run(
        [
            sys.executable,
            "-c",
            "from importlinter.cli import lint_imports_command; lint_imports_command()",
            "--no-cache",
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert "0 broken" in result.stdout


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from commands.main import main; main(['--help']);"
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
    packages = ["bench", "storage", "acquisition", "processing", "modeling", "diagnosis", "blindcheck"]
    packages += ["reporting", "visualization", "commands"]
    too_long = [
        f"{path.relative_to(ROOT)}: {n_lines} lines"
        for package in packages
        for path in (ROOT / package).rglob("*.py")
        if not path.name.endswith("_pb2.py") and (n_lines := len(path.read_text().splitlines())) > 500
    ]
    assert not too_long


def test_the_shipped_configuration_is_the_one_at_the_top_level():
    shipped = (ROOT / "bench" / "default_config.toml").read_bytes()
    assert shipped == (ROOT / "bench_config.toml").read_bytes()
