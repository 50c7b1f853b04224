"""`sawbench compare`: the material-comparison report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from sawbench.bench.errors import InputError
from sawbench.commands.options import config_option, force_option, json_option, refuse_unwritable
from sawbench.commands.terminal import emit, progress, table
from sawbench.inputs import find_recordings

if TYPE_CHECKING:
    from sawbench.reporting.compared import Comparison

# Short enough for one line of a terminal.
_SHORT: Final = {
    "stroke_rate_hz": "rate",
    "peak_force_n": "peak",
    "rms_motor_current_a": "motor RMS",
    "mean_battery_current_a": "battery",
    "runtime_s": "runtime",
}


@click.command(name="compare", epilog="Example: sawbench compare recordings --out report.html")
@click.argument("paths", metavar="DIR...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", "out_path", required=True, type=click.Path(path_type=Path, dir_okay=False), help="HTML page.")
@click.option(
    "--csv", "csv_path", type=click.Path(path_type=Path, dir_okay=False),
    help="Table of the trials; default: beside the page, as the HDF5 file.",
)  # fmt: skip
@config_option
@force_option
@json_option
def command(
    paths: tuple[Path, ...],
    out_path: Path,
    csv_path: Path | None,
    config_path: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Process, fit and compare every recording of DIR: materials at equal settings; page, CSV and HDF5.

    Several folders, or single recordings, are compared together.
    """
    from sawbench.comparison import compare_files
    from sawbench.reporting.compared import compare, comparison_json
    from sawbench.reporting.comparison_data import comparison_table, write_comparison_hdf5
    from sawbench.reporting.comparison_page import write_comparison_page
    from sawbench.storage.output import write_whole

    csv_path, hdf5_path = csv_path or out_path.with_suffix(".csv"), out_path.with_suffix(".h5")
    if len({out_path, csv_path, hdf5_path}) < 3:
        raise InputError(
            "page, table and HDF5 would be one file", where=out_path, remedy="name a page that ends in .html"
        )
    for path in (out_path, csv_path, hdf5_path):
        refuse_unwritable(path, force=force)
    files = find_recordings(paths)
    rows, left_out = compare_files(progress(files, "comparing"), config_path)
    write_comparison_page(out_path, rows, left_out=left_out, overwrite=force)
    write_whole(csv_path, comparison_table(rows).to_csv(index=False), overwrite=force)
    found = compare(rows, left_out)
    write_comparison_hdf5(hdf5_path, rows, found, overwrite=force)
    text = [describe(found), *(str(path) for path in (out_path, csv_path, hdf5_path))]
    emit(comparison_json(rows, left_out), "\n".join(text), as_json=as_json)
    return 1 if left_out or any(row.left_out_because for row in rows) else 0


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
