"""`sawbench compare`: the material-comparison report."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from bench.errors import InputError, SawbenchError
from commands.options import config_option, find_recordings, force_option, json_option, refuse_unwritable
from commands.terminal import emit, progress, table

if TYPE_CHECKING:
    from commands.analysis import AnalysedTrial
    from reporting.compared import ComparedTrial, Comparison

# Short enough for one line of a terminal.
_SHORT: Final = {
    "stroke_rate_hz": "rate",
    "peak_force_n": "peak",
    "rms_motor_current_a": "motor RMS",
    "mean_battery_current_a": "battery",
    "runtime_s": "runtime",
}


@click.command(name="compare", epilog="Example: sawbench compare recordings --out report.html")
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--out", "out_path", required=True, type=click.Path(path_type=Path, dir_okay=False), help="HTML page.")
@click.option("--csv", "csv_path", type=click.Path(path_type=Path, dir_okay=False), help="The table as CSV too.")
@config_option
@force_option
@json_option
def command(
    directory: Path,
    out_path: Path,
    csv_path: Path | None,
    config_path: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Process, fit and compare every recording of DIR, one series per material and setting."""
    from commands.analysis import load_and_process
    from reporting.compared import LeftOut, compare, comparison_json, comparison_table
    from reporting.comparison_page import write_comparison_page

    if not directory.exists():
        raise InputError("no such directory", where=directory)
    for path in (out_path, csv_path):
        if path is not None:
            refuse_unwritable(path, force=force)
    files = find_recordings([directory])
    rows: list[ComparedTrial] = []
    left_out: list[LeftOut] = []
    seen: dict[tuple[str, datetime], Path] = {}
    for path in progress(files, "comparing"):
        try:
            trial = load_and_process(path, config_path)
            refuse_twin(trial, seen)
            rows.append(compared(trial))
        except SawbenchError as error:
            left_out.append(LeftOut(name=path.name, reason=error.what))
    if not rows:
        reasons = "; ".join(f"{item.name}: {item.reason}" for item in left_out)
        raise InputError(f"none of {len(files)} recordings can be compared: {reasons}", where=directory)
    write_comparison_page(out_path, rows, left_out=left_out, overwrite=force)
    if csv_path is not None:
        comparison_table(rows).to_csv(csv_path, index=False)
    text = [describe(compare(rows, left_out)), str(out_path)]
    emit(comparison_json(rows, left_out), "\n".join(text), as_json=as_json)
    return 1 if left_out else 0


def describe(found: Comparison) -> str:
    """One row a series, then the trials without a place in one."""
    from reporting.compared import QUANTITIES
    from reporting.quantities import format_quantity

    shown = [q for q in QUANTITIES if any(q.key in one.means for one in found.series)]
    rows = []
    for one in found.series:
        means = [one.means.get(q.key) for q in shown]
        cells = ["-" if mean is None else format_quantity(mean.mean, mean.std) for mean in means]
        rows.append([one.label, str(len(one.trials)), *cells])
    headers = ["series", "n", *(f"{_SHORT.get(q.key, q.label)} / {q.unit}" for q in shown)]
    lines = [table(headers, rows), "(mean of n repetitions ± its standard uncertainty)"] if rows else []
    lines += [f"idle: {row.name}" for row in found.idle]
    lines += [f"left out: {item.name}: {item.reason}" for item in found.left_out]
    return "\n".join(lines)


def refuse_twin(trial: AnalysedTrial, seen: dict[tuple[str, datetime], Path]) -> None:
    """Refuse a second file of the same trial, as `recover` leaves it: it is no second repetition.

    Raises
    ------
    InputError
    """
    own = trial.recording.trial
    if own.started_at is None:
        return
    path = Path(trial.recording.path)
    first = seen.setdefault((own.trial_id, own.started_at), path)
    if first != path:
        raise InputError(f"is the same trial as {first.name} ({own.trial_id}, {own.started_at.isoformat()})")


def compared(trial: AnalysedTrial) -> ComparedTrial:
    """Fit and predict as far as the trial allows; what it does not allow is said in the note."""
    from commands.analysis import fit_trial, runtime_of
    from reporting.compared import ComparedTrial

    if trial.processed.status != "cutting":
        return ComparedTrial(processed=trial.processed)
    try:
        fit, estimates = fit_trial(trial)
    except SawbenchError as error:
        return ComparedTrial(processed=trial.processed, note=error.what)
    if fit.status != "ok":
        return ComparedTrial(processed=trial.processed, fit=fit)
    try:
        runtime = runtime_of(trial, fit, estimates)
    except SawbenchError as error:
        return ComparedTrial(processed=trial.processed, fit=fit, note=error.what)
    return ComparedTrial(processed=trial.processed, fit=fit, runtime=runtime)
