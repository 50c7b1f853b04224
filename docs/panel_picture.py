"""Take the picture of docs/panel.md: `python -m docs.panel_picture` in the repository; needs Chromium."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from tests.panel.operator_page import OperatorPage

ROOT = Path(__file__).parents[1]
FORM = {"material": "oak", "thickness": "20", "feed": "4", "operator": "Kim", "seconds": "60"}


def take(path: Path) -> None:
    """Record a trial of the simulated bench from the panel and take the page while it runs."""
    call = [sys.executable, "-m", "sawbench.commands.main", "panel", "--simulated", "--port", "0", "--no-browser"]
    with tempfile.TemporaryDirectory() as folder:
        panel = subprocess.Popen(call, cwd=folder, stdout=subprocess.PIPE, text=True)
        try:
            assert panel.stdout is not None
            address = panel.stdout.readline().split("operator panel: ")[1].strip()
            page = OperatorPage(Path(folder) / "profile")
            try:
                page.open(f"{address}record", width=1024)
                for name, value in FORM.items():
                    page.run(f"document.getElementById('{name}').value = '{value}'; 0")
                page.access_key("g")
                page.wait_for("parseFloat(document.getElementById('clock')?.textContent) > 5")
                page.screenshot(path)
                page.access_key("x")
                page.wait_for("document.querySelector('#step .state').textContent !== 'running'")
            finally:
                page.close()
        finally:
            panel.terminate()
            panel.communicate(timeout=60)


if __name__ == "__main__":
    take(ROOT / "docs" / "pictures" / "panel.png")
