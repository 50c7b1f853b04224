"""`sawbench diagnose`: the sim-to-real gap of a campaign."""

from __future__ import annotations

import json
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
from commands.terminal import emit, plain, stepper


@click.command(
    name="diagnose",
    epilog="Example: sawbench diagnose recordings/campaign --config bench_config.toml --out gap",
)
@click.argument("paths", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@config_option
@click.option(
    "--out", "out_dir", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder."
)
@force_option
@json_option
def command(
    paths: tuple[Path, ...], config_path: Path | None, out_dir: Path, force: bool, as_json: bool
) -> int:
    """Say where the model misses the measurement, which unmodelled effect causes it, and how far it closes."""
    from importlib.metadata import version

    from diagnosis.gap_report import diagnose
    from reporting.gap_page import write_gap_page
    from storage.reader import read_recording, sha256_of

    json_path, html_path = out_dir / "gap_report.json", out_dir / "gap_report.html"
    for path in (json_path, html_path):
        refuse_existing(path, force=force)
    files = find_recordings(paths)
    recordings = [read_recording(path) for path in files]
    loaded = config_for(recordings[0], config_path)
    provenance = {
        "recordings": {path.name: sha256_of(path) for path in files},
        "config_sha256": loaded.sha256,
        "software": f"sawbench {version('sawbench')}",
    }
    with stepper("reducing") as step:
        report = plain(diagnose(recordings, loaded, provenance=provenance, on_step=step))
    out_dir.mkdir(parents=True, exist_ok=True)
    json_path.write_text(json.dumps(report, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    write_gap_page(html_path, report, overwrite=True)
    emit(report, _as_text(report, json_path, html_path), as_json=as_json)
    return 0


def _as_text(report: dict[str, Any], json_path: Path, html_path: Path) -> str:
    lines = [f"verdict: {report['verdict'].replace('_', ' ')}"]
    for cause in report["causes"]:
        low, high = cause["gap_closed_ci95"]
        lines.append(
            f"{cause['probability']:6.1%}  {' + '.join(cause['effects'])}: closes {cause['gap_closed']:.0%}"
            f" of the held-out gap ({low:.0%} to {high:.0%})"
        )
    lines += [f"{p:6.1%}  {name.replace('_', ' ')}" for name, p in report["probabilities"].items()]
    lines += [f"note: {text}" for text in report["warnings"]]
    return "\n".join([*lines, f"next trial: {report['next_trial']}", str(json_path), str(html_path)])
