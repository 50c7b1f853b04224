"""`sawbench import`: tables, campaigns and CAN logs to MCAP."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.bench.recording import Trial
from sawbench.commands.batch import Batch, batch_options
from sawbench.commands.can_import import CanLog
from sawbench.commands.failures import Failures
from sawbench.commands.options import force_option, json_option, refuse_unwritable_folder, setting_options
from sawbench.commands.terminal import emit, stepper
from sawbench.plain import plain
from sawbench.storage.digest import sha256_of

if TYPE_CHECKING:
    from sawbench.archive.journal import Piece
    from sawbench.bench.config import LoadedConfig
    from sawbench.storage.importers import ImportReport, TableMap


@click.command(
    name="import", epilog="Example: sawbench import run7.csv --map map.toml --material oak --duty 0.44 --out recordings"
)
@click.argument("paths", metavar="PATH...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out", "out_dir", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder for recordings."
)  # fmt: skip
@click.option(
    "--map", "map_path", type=click.Path(path_type=Path, dir_okay=False),
    help="TOML that assigns columns to channels, with unit and sign (docs/tables.md).",
)  # fmt: skip
@click.option(
    "--dbc", type=click.Path(path_type=Path, dir_okay=False), help="DBC file that describes the frames of a CAN log."
)
@click.option(
    "--signal", "signals", multiple=True, metavar="CHANNEL=MESSAGE.SIGNAL",
    help="Signal of the CAN log to import, may be repeated; default: the signals of the configuration's [devices.*], "
    "without --config all numeric ones.",
)  # fmt: skip
@click.option(
    "--config", "config_path", type=click.Path(path_type=Path, dir_okay=False),
    help="Bench configuration, stored in the recording; its [devices.*] describe the signals of a CAN log.",
)  # fmt: skip
@click.option("--material", help="Workpiece material; 'none' for an idle run.")
@setting_options
@batch_options(has_archive=False)
@force_option
@json_option
def command(
    paths: tuple[Path, ...],
    out_dir: Path,
    map_path: Path | None,
    dbc: Path | None,
    signals: tuple[str, ...],
    config_path: Path | None,
    batch: Batch,
    force: bool,
    as_json: bool,
    **settings: Any,
) -> int:
    """Turn campaign.toml (every trial) or the folder it lies in, one table or one CAN log into one recording per trial.

    Tables: text (CSV and what instruments write), HDF5, MATLAB, JSON, MF4. CAN logs (candump .log, .asc, .blf, MF4
    frames) need a DBC: --dbc, or that of --config.

    Of several PATHs each campaign gets a folder of its own under --out, named after the one it lies in. Each is
    imported once: --out holds a journal, and a call that was broken off goes on.
    """
    from sawbench.bench.config import load_config
    from sawbench.storage.importers import load_map

    refuse_unwritable_folder(out_dir)
    paths = tuple(path / "campaign.toml" if path.is_dir() else path for path in paths)
    request = ImportRequest(
        path=paths[0],
        out_dir=out_dir,
        dbc=dbc,
        signals=signals,
        config=None if config_path is None else load_config(config_path),
        table_map=None if map_path is None else load_map(map_path),
        settings=settings,
        overwrite=force,
    )
    for path in paths:
        _refuse_misplaced(path, config_path, settings, signals, dbc)
    if len(paths) > 1:
        return _import_all([replace(request, path=path) for path in paths], batch, force=force, as_json=as_json)
    if batch != Batch():
        raise click.UsageError("--jobs, --scheduler and --retry are for several PATHs")
    with stepper("importing") as step:
        report = imported(request, step)
    emit(report, _as_text(report), as_json=as_json)
    return 0


@dataclass(frozen=True, kw_only=True, slots=True)
class ImportRequest:
    """One table, log or campaign, and what the user said about it.

    Attributes
    ----------
    path, out_dir : Path
    dbc : Path or None
    signals : tuple of str
    config : LoadedConfig or None
    table_map : TableMap or None
    settings : mapping
        Of the trial, by the names of `Trial`.
    overwrite : bool
    """

    path: Path
    out_dir: Path
    dbc: Path | None
    signals: tuple[str, ...]
    config: LoadedConfig | None
    table_map: TableMap | None
    settings: Mapping[str, Any]
    overwrite: bool

    def __str__(self) -> str:
        return str(self.path)


def imported(request: ImportRequest, on_trial: Callable[[int, int, str], None] | None = None) -> ImportReport:
    """Import one table, log or campaign.

    Raises
    ------
    InputError
        As `import_path`.
    """
    from sawbench.storage.importers import FramesNeedDbc, import_path, stem_of

    path, config = request.path, request.config
    trial = Trial(trial_id=stem_of(path), source=f"importing {path.name}", **request.settings)
    log = CanLog(
        path=path, out_dir=request.out_dir, trial=trial, config=config, table_map=request.table_map,
        signals=request.signals, overwrite=request.overwrite,
    )  # fmt: skip
    if request.dbc is not None:
        return log.imported(request.dbc)
    try:
        return import_path(
            path, request.out_dir, overwrite=request.overwrite, on_trial=on_trial, table_map=request.table_map,
            trial=trial, config_toml=config.text if config else "",
        )  # fmt: skip
    except FramesNeedDbc:
        return log.imported(log.dbc_of_config())


def _import_all(requests: Sequence[ImportRequest], batch: Batch, *, force: bool, as_json: bool) -> int:
    """Import every table and campaign that the journal of the folder does not hold yet."""
    failures, reports = Failures(len(requests)), []
    pieces = [_piece(request) for request in requests]
    for row in batch.rows(pieces, imported_row, requests[0].out_dir, "importing", overwrites=force):
        with failures.collected():
            reports.append(dict(row.checked()))
    paths = [path for report in reports for path in report["paths"]]
    warnings = [f"warning: {text}" for report in reports for text in report["warnings"]]
    n_samples = sum(report["n_samples"] for report in reports)
    text = f"{len(reports)} of {len(requests)} imported: {len(paths)} recordings, {n_samples} samples"
    emit(reports, "\n".join([*warnings, *paths, text]), as_json=as_json)
    return failures.exit_code(is_trusted=True)


def imported_row(request: ImportRequest) -> dict[str, Any]:
    """Import one table, log or campaign; return the report as plain values."""
    return plain(imported(request))


def _piece(request: ImportRequest) -> Piece:
    """The request as a piece of a batch: a campaign in a folder of its own, all under names that hold everywhere."""
    from sawbench.archive.journal import Piece
    from sawbench.storage.importers import stem_of

    path = request.path.absolute()
    is_campaign = path.suffix.lower() == ".toml"
    name = path.parent.name if is_campaign else stem_of(path)
    folder = request.out_dir.absolute() / name if is_campaign else request.out_dir.absolute()
    dbc = None if request.dbc is None else request.dbc.absolute()
    return Piece(
        name=name,
        key=_key(request),
        target=folder if is_campaign else folder / f"{name}.mcap",
        # What the journal lets through is the batch's own, or was asked for with --force.
        request=replace(request, path=path, out_dir=folder, dbc=dbc, overwrite=True),
    )


def _key(request: ImportRequest) -> str:
    """Hash of the bytes that are imported, of what was said about them, and of this software."""
    from sawbench.archive.journal import key_of
    from sawbench.bench.source_identity import analysis_identity
    from sawbench.storage.importers.campaign import load_campaign

    files = [request.path, *([] if request.dbc is None else [request.dbc])]
    config, maps = request.config, request.table_map
    try:
        if request.path.suffix.lower() == ".toml":
            campaign, config = load_campaign(request.path)
            named = [name for entry in campaign.trial for name in (entry.file, entry.map) if name]
            files += [request.path.parent / name for name in (*named, *([campaign.map] if campaign.map else []))]
        hashes = [sha256_of(file) for file in files]
    except SawbenchError:
        hashes = []  # the import will say what is wrong with it
    return key_of(
        analysis_identity(), hashes, request.signals, dict(request.settings), config and config.sha256,
        maps and maps.as_toml(),
    )  # fmt: skip


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
                remedy="write them into the campaign file: config at the top, the settings under [[trial]]",
            )
    if signals and dbc is None:
        raise InputError("--signal needs --dbc", remedy="give the DBC that describes the frames")


def _as_text(report: ImportReport) -> str:
    lines = [f"warning: {warning}" for warning in report.warnings]
    lines += report.notes
    lines += _taken_lines(report.taken.values())
    lines += [str(item) for item in report.paths]
    lines.append(f"{len(report.paths)} recording{'s' if len(report.paths) != 1 else ''}, {report.n_samples} samples")
    return "\n".join(lines)


def _taken_lines(taken: Iterable[Any]) -> list[str]:
    """Say which column was taken for which channel: once where all tables are alike."""
    pairs = dict.fromkeys((channel, words) for of in taken for channel, words in of.items())
    return [f"{channel} <- {words}" for channel, words in pairs]
