"""`sawbench report`: the page of a trial."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click
from sawbench.commands.failures import Failures
from sawbench.commands.options import (
    config_option,
    force_option,
    json_option,
    recordings_argument,
    refuse_same_result,
    refuse_unwritable,
)
from sawbench.commands.terminal import emit, stepper
from sawbench.inputs import find_recordings

_STEPS: Final = ("finding the strokes", "fitting k_Fc and predicting the runtime", "simulating the fitted model",
                 "writing the page")  # fmt: skip


@click.command(name="report", epilog="Example: sawbench report recordings/oak-01.mcap --out reports")
@recordings_argument
@click.option(
    "--out", "out_dir", type=click.Path(path_type=Path, file_okay=False), default=Path("reports"), show_default=True,
    help="Folder for one page per recording; created if missing.",
)  # fmt: skip
@config_option
@force_option
@json_option
def command(paths: tuple[Path, ...], out_dir: Path, config_path: Path | None, force: bool, as_json: bool) -> int:
    """Write the page of each trial: signals, stroke, fit, model against measurement, battery runtime.

    Idle, lossy and imported recordings get a page too, which says what could not be found and why. The exit code is 1
    where a page says that not every result can be relied on.
    """
    files = find_recordings(paths)
    pages = {path: out_dir / f"{path.stem}.html" for path in files}
    refuse_same_result(pages)
    for page in pages.values():
        refuse_unwritable(page, force=force, makes_folder=True)
    out_dir.mkdir(parents=True, exist_ok=True)
    failures = Failures(len(files))
    rows: list[dict[str, Any]] = []
    with stepper("evaluating") as step:
        for number, path in enumerate(files):

            def say(k: int, number: int = number, path: Path = path) -> None:
                step(len(_STEPS) * number + k, len(_STEPS) * len(files), f"{path.stem}: {_STEPS[k]}")

            with failures.collected():
                rows.append(_written(path, config_path, pages[path], say, force=force))
    emit(rows, "\n".join(_as_text(row) for row in rows), as_json=as_json)
    return failures.exit_code(is_trusted=all(row["trust"] != "bad" for row in rows))


def _written(
    path: Path, config_path: Path | None, page: Path, say: Callable[[int], None], *, force: bool
) -> dict[str, Any]:
    """Write the page of one trial and return its row; `say` is told each of the steps as it begins."""
    from sawbench.analysis import evaluate, load_and_process
    from sawbench.reporting.trial_page import trust_in, verdict, write_trial_page
    from sawbench.trial_report import trial_report

    say(0)
    trial = load_and_process(path, config_path)
    say(1)
    found = evaluate(trial)
    say(2)
    report = trial_report(trial, found)
    say(3)
    write_trial_page(page, report, files={"Recording": path}, overwrite=force)
    trust = trust_in(report)
    return {
        "trial": report.processed.trial.trial_id,
        "page": str(page),
        "verdict": verdict(report.processed, report.fit, report.runtime),
        "trust": trust.level,
        "reasons": list(trust.reasons),
    }


def _as_text(row: dict[str, Any]) -> str:
    return "\n".join(
        [f"{row['trial']}: {row['verdict']}", *(f"  {text}" for text in row["reasons"]), f"  {row['page']}"]
    )
