"""`sawbench process`: stroke period, folded cycle, quality."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
from sawbench.archive.files import result_path
from sawbench.commands.batch import Batch, batch_options, named_config
from sawbench.commands.failures import Failures
from sawbench.commands.options import (
    PLACE,
    config_option,
    force_option,
    json_option,
    places_argument,
    refuse_same_result,
    refuse_unwritable_folder,
)
from sawbench.commands.terminal import emit, table
from sawbench.inputs import find_files
from sawbench.plain import plain

if TYPE_CHECKING:
    from sawbench.bench.processed import ProcessedTrial
    from sawbench.storage.places import FoundFile, Place

SUMMARY_NAME = "summary.csv"


@click.command(name="process", epilog="Example: sawbench process recordings/*.mcap --out processed")
@places_argument
@config_option
@click.option("--out", "out_dir", type=PLACE, help="Folder for one HDF5 file per recording and summary.csv.")
@batch_options()
@force_option
@json_option
def command(
    paths: tuple[Place, ...], config_path: Path | None, out_dir: Place | None, batch: Batch, force: bool, as_json: bool
) -> int:
    """Find the stroke period, fold every channel onto one turn of the crank, judge the channels."""
    from sawbench.storage.results import summary_row

    if out_dir is not None and batch.archive is not None:
        raise click.UsageError("--archive stores the results in its own table: leave out --out")
    files = find_files(paths)
    failures = Failures(len(files))
    if batch.archive is None:
        _refuse_targets(files, out_dir)
        results = _process(files, config_path, out_dir, batch, failures, force=force)
    else:
        results = [trial.processed for trial in batch.kept(files, named_config(config_path), failures, "processing")]
    rows = [summary_row(processed) for processed in results]
    shown = [{**row, "warnings": list(r.warnings), "rivals": plain(r.period.rivals if r.period else ()),
              "offsets": plain(r.offsets)}
             for row, r in zip(rows, results, strict=True)]  # fmt: skip
    text = describe(results)
    if out_dir is not None and results:
        text += f"\nwritten to {out_dir}: {len(results)} HDF5 files, {SUMMARY_NAME}"
    emit(shown, text, as_json=as_json)
    return failures.exit_code(is_trusted=all(is_trusted(processed) for processed in results))


def _refuse_targets(files: Sequence[FoundFile], out_dir: Place | None) -> None:
    """Results that are there already are looked at one by one: those of an earlier run are kept."""
    if out_dir is None:
        return
    refuse_same_result({file.place: result_path(file.place, out_dir) for file in files})
    if isinstance(out_dir, Path):
        refuse_unwritable_folder(out_dir)


def _process(
    files: Sequence[FoundFile], config_path: Path | None, out_dir: Place | None, batch: Batch, failures: Failures, *,
    force: bool,
) -> list[ProcessedTrial]:  # fmt: skip
    """Process every file; what is finished stands in the summary also when the rest is broken off."""
    from sawbench.archive.files import process_file
    from sawbench.storage.results import append_summary_rows

    work = partial(process_file, config=named_config(config_path), out_dir=out_dir, overwrite=force)
    found: dict[int, ProcessedTrial] = {}
    try:
        for index, processed in batch.each([file.place for file in files], work, failures, "processing"):
            found[index] = processed
    finally:
        results = [found[index] for index in sorted(found)]
        if out_dir is not None:
            append_summary_rows(results, out_dir / SUMMARY_NAME)
    return results


def is_trusted(processed: ProcessedTrial) -> bool:
    """Whether the stroke was found with more than low confidence, and no doubted force gave the peak force."""
    if processed.period is None or processed.period.confidence == "low":
        return False
    return processed.peak_force_n is None or not processed.doubts("force_n")


def describe(results: list[ProcessedTrial]) -> str:
    """One row per trial, then what is to be said about each."""
    from sawbench.modeling.machines.words import words_of
    from sawbench.processing.stroke_offsets import changed_between
    from sawbench.reporting.quantities import format_quantity

    rows, remarks = [], []
    for processed in results:
        period, words = processed.period, words_of(processed.frame)
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
        remarks += [f"{processed.trial.trial_id}: {words.told(warning)}" for warning in processed.warnings]
        if period is not None and period.confidence != "high":
            remarks.append(
                f"{processed.trial.trial_id}: confidence is {period.confidence}: {words.told(period.reason)}"
            )
            remarks += [
                f"{processed.trial.trial_id}: alternative {1.0 / rival.period_s:.4g} Hz"
                f" (power {rival.relative_power:.2g}): {words.told(rival.reason)}"
                for rival in period.rivals
            ]
        if processed.removed is not None:
            removed = processed.removed
            remarks.append(
                f"{processed.trial.trial_id}: return stroke {removed.half} set to zero; removed:"
                f" {removed.rms_n:.1f} N rms, {removed.share_of_impulse:.1%} of the impulse"
            )
        # Of many trials only what contradicts the stated alignment is said; that is among the warnings.
        if len(results) == 1:
            remarks += [f"{processed.trial.trial_id}: time of {offset.words()}" for offset in processed.offsets]
    remarks += changed_between([(processed.trial.trial_id, processed.offsets) for processed in results])
    head = ["trial", "status", "period", "rate", "confidence", "strokes", "peak force"]
    return "\n".join([table(head, rows), *remarks])
