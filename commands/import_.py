"""`sawbench import`: tables, campaigns and CAN logs to MCAP."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Trial
from sawbench.commands.can_import import CanLog
from sawbench.commands.options import force_option, json_option, refuse_unwritable_folder
from sawbench.commands.terminal import emit, stepper

if TYPE_CHECKING:
    from sawbench.storage.importers import ImportReport


@click.command(
    name="import", epilog="Example: sawbench import run7.csv --map map.toml --material oak --duty 0.44 --out recordings"
)
@click.argument("path", metavar="PATH", type=click.Path(path_type=Path))
@click.option(
    "--out", "out_dir", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder for recordings."
)  # fmt: skip
@click.option(
    "--map", "map_path", type=click.Path(path_type=Path, dir_okay=False),
    help="TOML that says which column is which channel, in what unit and with what sign (docs/tables.md).",
)  # fmt: skip
@click.option("--dbc", type=click.Path(path_type=Path, dir_okay=False), help="Describes the frames of a CAN log.")
@click.option(
    "--signal", "signals", multiple=True, metavar="CHANNEL=MESSAGE.SIGNAL",
    help="Signal of the CAN log to take, may be repeated; default: those of the configuration's [devices.*], "
    "without --config all numeric ones.",
)  # fmt: skip
@click.option(
    "--config", "config_path", type=click.Path(path_type=Path, dir_okay=False),
    help="Bench configuration that is kept with the recording; its [devices.*] say what a CAN log holds.",
)  # fmt: skip
@click.option("--material", help="Workpiece; 'none' when the blade runs in air.")
@click.option("--duty", type=click.FloatRange(0, 1, min_open=True), help="Commanded PWM duty, 0..1.")
@click.option("--thickness", "thickness_mm", type=click.FloatRange(0, min_open=True), help="mm")
@click.option("--feed", "feed_mm_s", type=click.FloatRange(0), help="mm/s")
@click.option("--blade", help="Identity of the blade: its wear carries over.")
@click.option("--battery", help="Identity of the battery: its charge carries over.")
@force_option
@json_option
def command(
    path: Path,
    out_dir: Path,
    map_path: Path | None,
    dbc: Path | None,
    signals: tuple[str, ...],
    config_path: Path | None,
    force: bool,
    as_json: bool,
    **settings: Any,
) -> None:
    """Turn campaign.toml (every trial), or one table or CAN log, into one recording per trial.

    Tables: text (CSV and what instruments write), HDF5, MATLAB, JSON, MF4. CAN logs (candump .log, .asc, .blf, MF4
    frames) need a DBC: --dbc, or that of --config.
    """
    from sawbench.bench.config import load_config
    from sawbench.storage.importers import FramesNeedDbc, import_path, load_map, stem_of

    refuse_unwritable_folder(out_dir)
    table_map = None if map_path is None else load_map(map_path)
    config = None if config_path is None else load_config(config_path)
    _refuse_misplaced(path, config_path, settings, signals, dbc)
    trial = Trial(trial_id=stem_of(path), source=f"import of {path.name}", **settings)
    log = CanLog(
        path=path, out_dir=out_dir, trial=trial, config=config, table_map=table_map, signals=signals, overwrite=force
    )
    if dbc is not None:
        _show(log.imported(dbc), as_json)
        return
    try:
        with stepper("importing") as step:
            report = import_path(
                path, out_dir, overwrite=force, on_trial=step, table_map=table_map, trial=trial,
                config_toml=config.text if config else "",
            )  # fmt: skip
    except FramesNeedDbc:
        report = log.imported(log.dbc_of_config())
    _show(report, as_json)


def _refuse_misplaced(
    path: Path, config_path: Path | None, settings: dict[str, Any], signals: tuple[str, ...], dbc: Path | None
) -> None:
    """Refuse options that would be ignored."""
    if path.suffix.lower() == ".toml":
        given = [f"--{name.split('_')[0]}" for name, value in settings.items() if value is not None]
        given += ["--config"] if config_path is not None else []
        if given:
            raise InputError(
                f"{', '.join(given)} cannot be given for a whole campaign",
                where=path,
                remedy="write it into the campaign file: config at its top, the settings under [[trial]]",
            )
    if signals and dbc is None:
        raise InputError("--signal goes with --dbc", remedy="name the DBC that describes the frames")


def _show(report: ImportReport, as_json: bool) -> None:
    lines = [f"warning: {warning}" for warning in report.warnings]
    lines += report.notes
    lines += _taken_lines(report.taken.values())
    lines += [str(item) for item in report.paths]
    lines.append(f"{len(report.paths)} recording{'s' if len(report.paths) != 1 else ''}, {report.n_samples} samples")
    emit(report, "\n".join(lines), as_json=as_json)


def _taken_lines(taken: Iterable[Any]) -> list[str]:
    """Say which column was taken for which channel: once where all tables are alike."""
    pairs = dict.fromkeys((channel, words) for of in taken for channel, words in of.items())
    return [f"{channel} <- {words}" for channel, words in pairs]
