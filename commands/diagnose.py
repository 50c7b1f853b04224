"""`sawbench diagnose`: the sim-to-real gap of a campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from sawbench.commands.options import config_option, force_option, json_option, refuse_unwritable
from sawbench.commands.terminal import emit, stepper, table
from sawbench.inputs import find_recordings

# Share of the progress bar, of 100, at which everything is read and at which the page is drawn.
_OPENED, _DRAWING = 10, 95


@click.command(
    name="diagnose",
    epilog="Example: sawbench diagnose recordings/campaign --config bench_config.toml --out gap",
)
@click.argument("paths", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@config_option
@click.option("--out", "out_dir", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder.")
@click.option(
    "--until-closed", is_flag=True,
    help="Add cause after cause to the model until nothing more closes at withheld operating points.",
)  # fmt: skip
@click.option(
    "--plan", "n_planned", metavar="N", type=click.IntRange(1, 20), default=None,
    help="Propose N trials, those that tell most for the time they take: OUT/plan.csv, a table for `series run`.",
)  # fmt: skip
@force_option
@json_option
def command(
    paths: tuple[Path, ...], config_path: Path | None, out_dir: Path, until_closed: bool, n_planned: int | None,
    force: bool, as_json: bool,
) -> int:  # fmt: skip
    """Say where the model misses the measurement, which unmodelled effect causes it, and how far it closes."""
    from sawbench.analysis import open_trial
    from sawbench.gap import diagnose_trials
    from sawbench.results import GapReport

    json_path, html_path = out_dir / "gap_report.json", out_dir / "gap_report.html"
    improved_path, plan_path = out_dir / "improved_model.toml", out_dir / "plan.csv"
    for path in (json_path, html_path, improved_path, plan_path):
        refuse_unwritable(path, force=force, makes_folder=True)
    files = find_recordings(paths)
    with stepper("diagnosing:") as step:
        trials = []
        for number, path in enumerate(files):
            trials.append(open_trial(path, config_path))
            step(_OPENED * (number + 1) // len(files), 100, f"opening {path.name}")
        report = diagnose_trials(
            trials,
            until_closed=until_closed,
            plan=n_planned or 0,
            on_step=lambda done, total, what: step(_OPENED + (_DRAWING - _OPENED) * done // total, 100, what),
        )
        step(_DRAWING, 100, "drawing the page")
        GapReport(report=report).save(out_dir, overwrite=True)
    lines = [_as_text(report), "", str(json_path), str(html_path)]
    if report.get("improved_model"):
        lines.append(f"{improved_path}: use it as in `sawbench runtime RECORDING --config {improved_path}`")
    if plan_path.exists():
        lines.append(f"{plan_path}: run it as in `sawbench series run {plan_path}`")
    emit(report, "\n".join(lines), as_json=as_json)
    return 0


def _as_text(report: dict[str, Any]) -> str:
    from sawbench.reporting.gap_page import verdict_sentence

    gap = report["gap"]
    lines = [verdict_sentence(report), "", table(("cause", "probability", "gap closed", "95 %"), _cause_rows(report))]
    if "until_closed" in report:
        lines += ["", *_closing_lines(report["until_closed"])]
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
    lines.append(f"next trial: {report['next_trial']}")
    return "\n".join([*lines, *(["", *_plan_lines(report["plan"])] if "plan" in report else [])])


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


def _closing_lines(closing: dict[str, Any]) -> list[str]:
    """Lay out the ladder of causes, from the model as configured to the noise."""
    from sawbench.reporting.closing import closing_rows, closing_sentences

    keys = ("model", "probability", "magnitude", "rms", "closed", "interval")
    head = ("cause after cause, over noise", "probability", "magnitude", "rms", "closed so far", "95 %")
    return [table(head, [[row[key] for key in keys] for row in closing_rows(closing)]), *closing_sentences(closing)]


def _plan_lines(plan: dict[str, Any]) -> list[str]:
    """Lay out the proposed trials, in their order."""
    from sawbench.reporting.trial_plan import PLAN_COLUMNS, plan_rows, plan_sentences

    rows = [[row[key] for key, _ in PLAN_COLUMNS] for row in plan_rows(plan)]
    return [*([table([words for _, words in PLAN_COLUMNS], rows)] if rows else []), *plan_sentences(plan)]
