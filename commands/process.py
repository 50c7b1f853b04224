"""`sawbench process`: stroke period, folded cycle, quality."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from sawbench.commands.failures import Failures
from sawbench.commands.options import config_option, force_option, json_option, recordings_argument, refuse_unwritable
from sawbench.commands.terminal import emit, progress, table
from sawbench.inputs import find_recordings
from sawbench.plain import plain

if TYPE_CHECKING:
    from sawbench.bench.processed import ProcessedTrial

SUMMARY_NAME = "summary.csv"


@click.command(name="process", epilog="Example: sawbench process recordings/*.mcap --out processed")
@recordings_argument
@config_option
@click.option(
    "--out", "out_dir", type=click.Path(path_type=Path, file_okay=False),
    help="Folder for one HDF5 file per recording and summary.csv.",
)  # fmt: skip
@force_option
@json_option
def command(paths: tuple[Path, ...], config_path: Path | None, out_dir: Path | None, force: bool, as_json: bool) -> int:
    """Find the stroke period, fold every channel onto one turn of the crank, judge the channels."""
    from sawbench.analysis import load_and_process
    from sawbench.storage.results import append_summary_row, summary_row, write_processed

    files = find_recordings(paths)
    targets = {path: None if out_dir is None else out_dir / f"{path.stem}.h5" for path in files}
    if len(set(targets.values())) < len(files) and out_dir is not None:
        raise click.UsageError("two recordings have the same name; process them into different folders")
    for target in targets.values():
        if target is not None:
            refuse_unwritable(target, force=force, makes_folder=True)
    results: list[ProcessedTrial] = []
    failures = Failures(len(files))
    for path in progress(files, "processing"):
        with failures.collected():
            processed = load_and_process(path, config_path).processed
            results.append(processed)
            target = targets[path]
            if target is not None:
                target.parent.mkdir(parents=True, exist_ok=True)
                write_processed(processed, target, overwrite=force)
                append_summary_row(processed, target.parent / SUMMARY_NAME)
    rows = [summary_row(processed) for processed in results]
    shown = [{**row, "warnings": list(r.warnings), "rivals": plain(r.period.rivals if r.period else ())}
             for row, r in zip(rows, results, strict=True)]  # fmt: skip
    text = describe(results)
    if out_dir is not None:
        text += f"\nwritten to {out_dir}: {len(results)} HDF5 files, {SUMMARY_NAME}"
    emit(shown, text, as_json=as_json)
    return failures.exit_code(is_trusted=all(is_trusted(processed) for processed in results))


def is_trusted(processed: ProcessedTrial) -> bool:
    """Whether the stroke was found with more than low confidence, and no doubted force gave the peak force."""
    if processed.period is None or processed.period.confidence == "low":
        return False
    return processed.peak_force_n is None or not processed.doubts("force_n")


def describe(results: list[ProcessedTrial]) -> str:
    """One row a trial, then what is to be said about each."""
    from sawbench.reporting.quantities import format_quantity

    rows, remarks = [], []
    for processed in results:
        period = processed.period
        peak, peak_std = processed.peak_force_n, processed.peak_force_std_n
        rows.append(
            [
                processed.trial.trial_id,
                processed.status,
                "-" if period is None else format_quantity(1e3 * period.period_s, 1e3 * period.period_std_s, "ms"),
                "-" if period is None else f"{period.rate_hz:.3f} Hz",
                "-" if period is None else period.confidence,
                "-" if period is None else str(period.n_cycles),
                "-" if peak is None else format_quantity(peak, peak_std, "N"),
            ]
        )
        remarks += [f"{processed.trial.trial_id}: {warning}" for warning in processed.warnings]
        if period is not None and period.confidence != "high":
            remarks.append(f"{processed.trial.trial_id}: confidence is {period.confidence}: {period.reason}")
            remarks += [
                f"{processed.trial.trial_id}: rival {1.0 / rival.period_s:.4g} Hz"
                f" (power {rival.relative_power:.2g}): {rival.reason}"
                for rival in period.rivals
            ]
        if processed.removed is not None:
            removed = processed.removed
            remarks.append(
                f"{processed.trial.trial_id}: return stroke {removed.half} set to zero; it held"
                f" {removed.rms_n:.1f} N rms, {removed.share_of_impulse:.1%} of the impulse"
            )
    head = ["trial", "status", "period", "rate", "confidence", "strokes", "peak force"]
    return "\n".join([table(head, rows), *remarks])
