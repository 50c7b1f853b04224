"""`sawbench diagnose`: the sim-to-real gap of a campaign."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import click

from commands.options import (
    config_for,
    config_option,
    find_recordings,
    force_option,
    json_option,
    refuse_existing,
)
from commands.terminal import emit, plain, stepper, table

# Share of the progress bar, of 100, at which everything is read and at which the page is drawn.
_OPENED, _DRAWING = 10, 95


@click.command(
    name="diagnose",
    epilog="Example: sawbench diagnose recordings/campaign --config bench_config.toml --out gap",
)
@click.argument("paths", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@config_option
@click.option("--out", "out_dir", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder.")
@force_option
@json_option
def command(paths: tuple[Path, ...], config_path: Path | None, out_dir: Path, force: bool, as_json: bool) -> int:
    """Say where the model misses the measurement, which unmodelled effect causes it, and how far it closes."""
    # The products of matrices here are small: threads of the linear algebra would cost more than they save.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from importlib.metadata import version

    from diagnosis.gap_report import diagnose
    from reporting.gap_page import write_gap_page
    from storage.reader import read_recording, sha256_of

    json_path, html_path = out_dir / "gap_report.json", out_dir / "gap_report.html"
    for path in (json_path, html_path):
        refuse_existing(path, force=force)
    files = find_recordings(paths)
    with stepper("diagnosing:") as step:
        recordings, digests = [], {}
        for number, path in enumerate(files):
            recordings.append(read_recording(path))
            digests[path.name] = sha256_of(path)
            step(_OPENED * (number + 1) // len(files), 100, f"opening {path.name}")
        loaded = config_for(recordings[0], config_path)
        provenance = {
            "recordings": digests,
            "config_sha256": loaded.sha256,
            "software": f"sawbench {version('sawbench')}",
        }
        report = plain(
            diagnose(
                recordings, loaded, provenance=provenance,
                on_step=lambda done, total, what: step(_OPENED + (_DRAWING - _OPENED) * done // total, 100, what),
            )
        )  # fmt: skip
        step(_DRAWING, 100, "drawing the page")
        out_dir.mkdir(parents=True, exist_ok=True)
        write_gap_page(html_path, report, overwrite=True)
    json_path.write_text(_compact(json.dumps(report, indent=2, allow_nan=False)) + "\n", encoding="utf-8")
    emit(report, _as_text(report, json_path, html_path), as_json=as_json)
    return 0


def _compact(text: str) -> str:
    """Write lists of numbers on one line; the rest stays one value a line."""
    return re.sub(r"\[[\s\d.,eE+-]*\]", lambda found: re.sub(r"\s+", " ", found[0]), text)


def _as_text(report: dict[str, Any], json_path: Path, html_path: Path) -> str:
    from reporting.gap_page import verdict_sentence

    gap = report["gap"]
    lines = [verdict_sentence(report), "", table(("cause", "probability", "gap closed", "95 %"), _cause_rows(report))]
    rungs = ("nominal", "retuned", "with_effect", "noise_floor")
    rows = [
        (f"{name} / {row['unit']}", *(f"{row[key]:.3g}" for key in rungs)) for name, row in gap["by_channel"].items()
    ]
    rows.append(("all, over noise", *(f"{gap[key]:.3g}" for key in rungs)))
    lines += ["", "gap at held-out operating points, rms", table(("", *(r.replace("_", " ") for r in rungs)), rows)]
    if "runtime_s" in gap:
        times = ", ".join(f"{name.replace('_', ' ')} {seconds:.0f} s" for name, seconds in gap["runtime_s"].items())
        lines += ["", f"battery runtime: {times}"]
    lines += ["", *(f"note: {text}" for text in report["warnings"])]
    return "\n".join([*lines, f"next trial: {report['next_trial']}", "", str(json_path), str(html_path)])


def _cause_rows(report: dict[str, Any]) -> list[tuple[str, ...]]:
    rows = []
    for cause in report["causes"]:
        low, high = (round(100 * end) for end in cause["gap_closed_ci95"])
        rows.append(
            (" + ".join(cause["effects"]), f"{cause['probability']:.1%}", f"{round(100 * cause['gap_closed'])} %",
             f"{low} to {high} %")
        )  # fmt: skip
    others = sorted(report["probabilities"].items(), key=lambda item: -item[1])
    return [*rows, *((name.replace("_", " "), f"{p:.1%}", "", "") for name, p in others)]
