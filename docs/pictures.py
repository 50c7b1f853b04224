"""Write the picture of the README: `python docs/pictures.py`, from the root of the repository.

The picture is that of the gap page, reduced to two channels, for a campaign of the blind check with guide friction.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from sawbench.bench.config import load_config
from sawbench.blindcheck.campaign import make_campaign
from sawbench.diagnosis.answer.gap_report import diagnose
from sawbench.reporting.gap_figures import strokes_picture
from sawbench.reporting.gap_page import verdict_sentence
from sawbench.reporting.html import still_svg
from sawbench.storage.importers import import_path
from sawbench.storage.reader import read_recording
from threadpoolctl import threadpool_limits

ROOT = Path(__file__).parents[1]
SEED = 811  # a development seed
CHANNELS = ("motor_current_a", "crank_speed_rad_s")


def write(folder: Path) -> str:
    """Draw strokes before and after the cause was added to the model; returns the result in words."""
    with tempfile.TemporaryDirectory() as place:
        campaign = Path(place) / "campaign"
        make_campaign(SEED, campaign, effects={"guide_friction": 1.0}, length=0.25)
        paths = import_path(campaign / "campaign.toml", campaign / "imported").paths
        with threadpool_limits(limits=1, user_api="blas"):
            report = diagnose(
                [read_recording(path) for path in paths], load_config(campaign / "bench_config.toml"), provenance={}
            )
    strokes = [
        {**stroke, "channels": {name: stroke["channels"][name] for name in CHANNELS}}
        for stroke in report["detail"]["strokes"]
    ]
    picture = strokes_picture(strokes, "with_effect", "model with the cause found")
    assert picture is not None
    # A file of its own needs the name space; on a dark page the drawing needs a ground.
    head = '<svg xmlns="http://www.w3.org/2000/svg" style="background:white" '
    (folder / "gap.svg").write_text(still_svg(picture).replace("<svg ", head, 1) + "\n", encoding="utf-8")
    runtime = report["gap"]["runtime_s"]
    return (
        f"{verdict_sentence(report)}\nRuntime: measured {runtime['measured']:.0f} s, model as configured "
        f"{runtime['nominal']:.0f} s, with the cause {runtime['with_effect']:.0f} s."
    )


if __name__ == "__main__":
    target = ROOT / "docs" / "pictures"
    target.mkdir(exist_ok=True)
    sys.stdout.write(f"{write(target)}\nwrote {target / 'gap.svg'}\n")
