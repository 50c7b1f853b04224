"""`sawbench view`: replay a recording in Rerun."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.commands.options import config_option, force_option, json_option
from sawbench.commands.terminal import emit, has_display

if TYPE_CHECKING:
    from sawbench.analysis import AnalysedTrial
    from sawbench.bench.recording import Floats, Recording


@click.command(name="view", epilog="Example: sawbench view recordings/oak-01.mcap --rrd oak-01.rrd")
@click.argument("path", metavar="FILE", type=click.Path(path_type=Path))
@config_option
@click.option("--rrd", "rrd_path", type=click.Path(path_type=Path, dir_okay=False), help="Save the view to this file.")
@click.option("--no-view", is_flag=True, help="Do not open the viewer; with --rrd.")
@force_option
@json_option
def command(
    path: Path, config_path: Path | None, rrd_path: Path | None, no_view: bool, force: bool, as_json: bool
) -> None:
    """Show a recording as the live view does, with the crank at its angle and the fitted model over the signals."""
    from sawbench.bench.true_values import with_true_values
    from sawbench.visualization.replay import view_recording

    if no_view and rrd_path is None:
        raise click.UsageError("--no-view needs --rrd FILE")
    if not path.exists():
        raise InputError("no such file", where=path, remedy="check the path")
    shows = not no_view
    if shows and not has_display():
        if rrd_path is None:
            raise InputError(
                "there is no display for the viewer (DISPLAY and WAYLAND_DISPLAY are empty)",
                where=path,
                remedy="save the view with --no-view --rrd FILE, and open that file on a computer with a display",
            )
        click.echo("there is no display: the view is saved, the viewer is not opened", err=True)
        shows = False
    trial, model = None, None
    try:
        from sawbench.analysis import load_and_process

        trial = load_and_process(path, config_path)
        model = _fitted_stroke(trial)
    except SawbenchError as error:
        # The signals are worth seeing also where they cannot be processed.
        click.echo(f"shown without {'the folded cycle' if trial is None else 'the model'}: {error}", err=True)
    view_recording(
        _signals_of(path) if trial is None else with_true_values(trial.recording, trial.loaded.config),
        save_path=rrd_path,
        spawn=shows,
        processed=None if trial is None else trial.processed,
        model=model,
        overwrite=force,
    )
    made = [] if rrd_path is None else [rrd_path]
    emit({"files": made}, "\n".join(map(str, made)) or "viewer started", as_json=as_json)


def _signals_of(path: Path) -> Recording:
    from sawbench.storage.reader import read_recording

    return read_recording(path)


def _fitted_stroke(trial: AnalysedTrial) -> dict[str, Floats] | None:
    """One stroke of the fitted model; None where there is nothing to fit."""
    from sawbench.analysis import fit_trial
    from sawbench.model_cycles import fitted_cycle

    if trial.processed.status != "cutting":
        return None
    fit, _ = fit_trial(trial)
    return fitted_cycle(trial, fit) if fit.status == "ok" else None
