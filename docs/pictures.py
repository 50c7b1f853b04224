"""Write the picture of the README: `python docs/pictures.py`, from the root of the repository."""

from __future__ import annotations

import sys
from pathlib import Path

import sawbench
from sawbench.reporting.html import still_svg
from sawbench.reporting.trial_figures import cycle_picture

ROOT = Path(__file__).parents[1]


def write(folder: Path) -> Path:
    """Draw the strokes of a sample trial over one turn of the crank, with the fitted model."""
    trial = sawbench.process(ROOT / "recordings" / "oak-01.mcap")
    picture = cycle_picture(trial.processed, sawbench.fit(trial).model_cycle())
    assert picture is not None
    path = folder / "stroke.svg"
    # A file of its own needs the name space; on a dark page the drawing needs a ground.
    head = '<svg xmlns="http://www.w3.org/2000/svg" style="background:white" '
    path.write_text(still_svg(picture).replace("<svg ", head, 1) + "\n", encoding="utf-8")
    return path


if __name__ == "__main__":
    target = ROOT / "docs" / "pictures"
    target.mkdir(exist_ok=True)
    sys.stdout.write(f"wrote {write(target)}\n")
