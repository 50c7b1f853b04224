"""`sawbench compare`: the material-comparison report."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from sawbench.bench.errors import InputError
from sawbench.commands.batch import Batch, batch_options, named_config
from sawbench.commands.options import PLACE, config_option, force_option, json_option, refuse_unwritable
from sawbench.commands.terminal import emit, table
from sawbench.inputs import find_files
from sawbench.storage.places import with_suffix

if TYPE_CHECKING:
    from sawbench.archive.batch import Outcome
    from sawbench.reporting.compared import ComparedTrial, Comparison
    from sawbench.storage.places import Place

# Short enough for one line of a terminal.
_SHORT: Final = {
    "stroke_rate_hz": "rate",
    "peak_force_n": "peak",
    "rms_motor_current_a": "motor RMS",
    "mean_battery_current_a": "battery",
    "runtime_s": "runtime",
}


@click.command(name="compare", epilog="Example: sawbench compare recordings --out report.html")
@click.argument("paths", metavar="DIR...", nargs=-1, required=True, type=PLACE)
@click.option("--out", "out_path", required=True, type=PLACE, help="HTML page; its folder is created if missing.")
@click.option(
    "--csv", "csv_path", type=PLACE, help="Table of the trials; default: next to the page, like the HDF5 file."
)
@config_option
@batch_options()
@force_option
@json_option
def command(
    paths: tuple[Place, ...],
    out_path: Place,
    csv_path: Place | None,
    config_path: Path | None,
    batch: Batch,
    force: bool,
    as_json: bool,
) -> int:
    """Process, fit and compare every recording of DIR: materials at equal settings; page, CSV and HDF5.

    Several folders, or single recordings, are compared together. DIR may also be an archive: then its results are
    compared as they are.
    """
    from sawbench.comparison import compared, save_comparison
    from sawbench.reporting.compared import compare, comparison_json

    csv_path, hdf5_path = csv_path or with_suffix(out_path, ".csv"), with_suffix(out_path, ".h5")
    targets = (out_path, csv_path, hdf5_path)
    if len(set(targets)) < 3:
        raise InputError(
            "page, table and HDF5 would have the same name",
            where=out_path,
            remedy="give a page name that ends in .html",
        )
    for path in targets:
        refuse_unwritable(path, force=force, makes_folder=True)
    rows, left_out = compared(_outcomes(paths, config_path, batch))
    for path in targets:
        if isinstance(path, Path):
            path.parent.mkdir(parents=True, exist_ok=True)
    save_comparison(rows, left_out, targets, overwrite=force)
    text = [describe(compare(rows, left_out)), *(str(path) for path in targets)]
    emit(comparison_json(rows, left_out), "\n".join(text), as_json=as_json)
    return 1 if left_out or any(row.left_out_because for row in rows) else 0


def _outcomes(
    paths: tuple[Place, ...], config_path: Path | None, batch: Batch
) -> Iterator[Outcome[Place, ComparedTrial]]:
    """What became of every recording of the folders, or what an archive holds."""
    from sawbench.archive.table import ResultTable
    from sawbench.archive.trials import kept_trials

    table = ResultTable(paths[0])
    if len(paths) > 1 or not table.exists():
        return batch.outcomes(find_files(paths), named_config(config_path), "comparing")
    if config_path is not None or batch != Batch():
        raise click.UsageError(
            "the results of an archive are compared as stored: leave out --config, --jobs, --scheduler and --archive"
        )
    return kept_trials(table)


def describe(found: Comparison) -> str:
    """One row a series, then the trials without a place in one."""
    from sawbench.reporting.compared import QUANTITIES
    from sawbench.reporting.quantities import format_quantity

    shown = [q for q in QUANTITIES if any(q.key in one.means for one in found.series)]
    rows = []
    for one in found.series:
        means = [one.means.get(q.key) for q in shown]
        cells = ["-" if mean is None else format_quantity(mean.mean, mean.std) for mean in means]
        rows.append([one.label, str(len(one.trials)), *cells])
    headers = ["series", "n", *(f"{_SHORT.get(q.key, q.label)} / {q.unit}" for q in shown)]
    lines = [table(headers, rows), "(mean of n repetitions ± its standard uncertainty)"] if rows else []
    lines += [f"idle: {row.name}" for row in found.idle]
    lines += [f"note: {text}" for text in found.remarks]
    lines += [
        f"change the blade: {one.blade}, k_Fc {one.growth:+.0%} in {one.name}" for one in found.wear if one.is_worn
    ]
    for item in found.left_out:
        lines.append(f"left out: {item.name}: {item.reason}")
        lines += [f"  likely cause: {item.cause}"] if item.cause else []
        lines += [f"  {item.remedy}"] if item.remedy else []
    return "\n".join(lines)
