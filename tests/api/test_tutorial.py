"""The tutorial notebook runs as it stands, and is stored without outputs."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest

pytestmark = pytest.mark.pipeline

NOTEBOOK = Path(__file__).parents[2] / "docs" / "tutorial.ipynb"
# Cells that end in a result, and what its table must name.
SHOWN = {
    "opened": "motor_current_a",
    "trial": "missing samples",
    "fitted": "N·s/m",
    "lasts": "mean battery current",
    "comparison": "black_locust",
    "gap": "unknown",
}


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_the_tutorial_runs():
    from nbclient import NotebookClient

    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert not any(cell.outputs or cell.execution_count for cell in notebook.cells if cell.cell_type == "code")
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(NOTEBOOK.parent)}}).execute()
    html = {
        cell.source.splitlines()[-1]: output.data["text/html"]
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
        if output.output_type == "execute_result"
    }
    for name, words in SHOWN.items():
        assert words in html[name], f"the cell that shows {name!r} does not name {words!r}"
