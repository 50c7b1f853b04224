"""`sawbench import`: tables, campaigns and CAN logs to MCAP."""

from __future__ import annotations

from pathlib import Path

import click

from bench.errors import InputError
from commands.options import force_option, json_option
from commands.terminal import emit, stepper


@click.command(name="import", epilog="Example: sawbench import campaign.toml --out recordings/campaign")
@click.argument("path", metavar="PATH", type=click.Path(path_type=Path))
@click.option(
    "--out", "out_dir", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder for recordings."
)  # fmt: skip
@click.option("--dbc", type=click.Path(path_type=Path, dir_okay=False), help="Describes the frames of a CAN log.")
@click.option(
    "--signal", "signals", multiple=True, metavar="CHANNEL=MESSAGE.SIGNAL",
    help="Signal of the CAN log to take, may be repeated; default: all numeric ones.",
)  # fmt: skip
@force_option
@json_option
def command(path: Path, out_dir: Path, dbc: Path | None, signals: tuple[str, ...], force: bool, as_json: bool) -> None:
    """Turn campaign.toml (every trial), or one CSV, HDF5, MF4 or CAN log, into one recording per trial.

    CAN logs (candump .log, .asc, .blf, MF4 frames) need --dbc.
    """
    from storage.importers import FramesNeedDbc, import_path

    if dbc is not None:
        written, warnings, n_samples = _import_can_log(path, out_dir, dbc, signals, force)
    else:
        if signals:
            raise InputError("--signal goes with --dbc", remedy="name the DBC that describes the frames")
        try:
            with stepper("importing") as step:
                report = import_path(path, out_dir, overwrite=force, on_trial=step)
        except FramesNeedDbc as error:
            raise InputError(
                "holds CAN frames, which only a DBC can turn into signals",
                where=path,
                remedy="add --dbc FILE.dbc (and --signal CHANNEL=MESSAGE.SIGNAL)",
            ) from error
        written, warnings, n_samples = list(report.paths), list(report.warnings), report.n_samples
    lines = [f"warning: {warning}" for warning in warnings]
    lines += [str(item) for item in written]
    lines.append(f"{len(written)} recording{'s' if len(written) != 1 else ''}, {n_samples} samples")
    emit({"paths": written, "warnings": warnings, "n_samples": n_samples}, "\n".join(lines), as_json=as_json)


def _import_can_log(
    path: Path, out_dir: Path, dbc: Path, signals: tuple[str, ...], force: bool
) -> tuple[list[Path], list[str], int]:
    from acquisition.can_logs import decode_can_log
    from storage.reader import write_recording

    wanted = {}
    for text in signals:
        channel, equals, signal = text.partition("=")
        if not equals or "." not in signal:
            raise InputError(f"--signal is {text!r}, expected CHANNEL=MESSAGE.SIGNAL")
        wanted[channel] = signal
    recording = decode_can_log(path, dbc, wanted or None)
    out = out_dir / f"{path.name.removesuffix('.gz').rsplit('.', 1)[0]}.mcap"
    out_dir.mkdir(parents=True, exist_ok=True)
    written = write_recording(recording, out, overwrite=force)
    warnings = [event.text for event in recording.events if event.kind == "warning"]
    return [written], warnings, sum(len(signal.values) for signal in recording.signals.values())
